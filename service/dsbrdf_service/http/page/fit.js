// The page of one fit: its progress, why it failed, or the result.
import { act, dateOf, fill, find, follow, json, nameOf, removeFit, request, say, setTitle, share, showPicture, template, whenOpened, whenSeen, words } from "./app.js";
import { place, showDownloads, showSide, showSpheres, storedOf, subjectOf } from "./said.js";

const FAULTS = {
  input: "The measurement or the options do not allow a fit.",
  compute: "The computation failed or met a limit of the service.",
  system: "The process of the fit was lost. Fit the measurement again.",
};
const STATES = /** @type {Record<string, string>} */ ({ accepted: "Waiting for its turn", running: "Fitting", cancelled: "This fit was cancelled.", failed: "This fit failed." });

/** @param {HTMLElement} main @param {string} id */
export async function show(main, id) {
  const path = `v1/fits/${id}`;
  const asked = json(path);
  const shader = request(`${path}/export?format=glsl`).then((answer) => answer.text(), () => undefined); // asked for again where it is needed
  main.replaceChildren(template("fit", { name: "A fit" }));
  const figure = place(main, path);
  /** @type {Fit} */
  const fit = await asked;
  if (fit.status !== "succeeded") return watch(main, fit);
  const stored = await storedOf(fit);
  showResult(main, fit, stored);
  await showSpheres(main, [figure], [subjectOf(fit, stored)], shader);
  return whenSeen(find(main, ".downloads"), () => showDownloads(find(main, ".downloads"), path));
}

/** @param {HTMLElement} main @param {Fit} fit @param {Measurement | null} stored */
function showResult(main, fit, stored) {
  const name = nameOf(fit);
  setTitle(name);
  const alone = stored ? "The measurement is a table of samples: the plots below show them." : "The measurement is not stored any more: the fit is shown alone.";
  const about = `${fit.components.map(({ label }) => words(label)).join(", ") || "no light"} · ${dateOf(fit.created)}. ${stored?.valid_nodes ? "" : alone}`;
  fill(main, { name, about }, { compare: `.#with=${fit.id}`, measurement: `measurements/${fit.measurement}` });
  showSide(find(main, ".side"), fit);
  find(main, "a[data-link=measurement]").hidden = find(main, "#figures").hidden = !stored;
  const dark = matchMedia("(prefers-color-scheme: dark)").matches;
  for (const image of find(main, "#figures").querySelectorAll("img")) whenOpened(image, () => showPicture(image, `v1/fits/${fit.id}/figures/${image.id}.svg?dark=${dark}`));
  if (!stored?.valid_nodes) find(main, "#lobes").closest("figure")?.remove(); // they are those of a grid
  act(main, "share", share);
  act(main, "delete", () => removeFit(fit));
  act(main, "rename", async () => {
    const wanted = prompt("The fit's new name", find(main, "h1").textContent ?? "")?.trim();
    if (!wanted) return;
    await json(`v1/fits/${fit.id}`, "PATCH", { name: wanted });
    fill(main, { name: wanted });
    setTitle(wanted);
    say("The fit is renamed.");
  });
}

/** Follows a fit to its end, or says how it ended. @param {HTMLElement} main @param {Fit} fit */
async function watch(main, fit) {
  const path = `v1/fits/${fit.id}`;
  setTitle(`${nameOf(fit)}: ${fit.status}`);
  main.replaceChildren(template("unfinished", { name: fit.name ?? `Fit of ${nameOf(fit)}` }));
  main.removeAttribute("aria-busy");
  const [bar, fault] = [find(main, "progress", HTMLProgressElement), find(main, ".fault")];
  act(main, "cancel", () => request(`${path}?only=cancel`, { method: "DELETE" }));
  act(main, "delete", () => removeFit(fit));
  for await (const { status, progress, error } of follow(fit)) {
    const unfinished = status === "accepted" || status === "running";
    bar.hidden = find(main, "[data-act=cancel]").hidden = !unfinished;
    find(main, "[data-act=delete]").hidden = unfinished;
    bar.value = progress;
    fault.hidden = !error;
    fault.textContent = error?.message ?? "";
    const note = unfinished ? "The result appears here when the fit is done. You may leave: the fit goes on." : "";
    fill(main, { state: STATES[status] ?? "", note: error ? FAULTS[error.origin] : note }, { measurement: `measurements/${fit.measurement}` });
    if (status === "succeeded") await show(main, fit.id);
  }
}
