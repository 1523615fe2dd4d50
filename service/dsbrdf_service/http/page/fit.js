// Shows one fit: its progress, its failure or its result.
import { act, dateOf, fill, find, follow, json, make, nameOf, progressOf, removeFit, request, root, say, setTitle, share, showPicture, template, whenOpened, whenSeen } from "./app.js";
import { showComponents } from "./components.js";
import { showDownloads } from "./downloads.js";
import { place, showSide, showSpheres, storedOf, subjectOf } from "./said.js";

const FAULTS = {
  input: "The measurement or the options do not allow a fit.",
  compute: "The computation failed or met a limit of the service.",
  system: "The process of the fit ended unexpectedly. Fit the measurement again.",
};
const STATES = /** @type {Record<string, string>} */ ({ accepted: "Waiting for its turn", running: "Fitting", cancelled: "This fit was cancelled.", failed: "This fit failed." });

/** @param {HTMLElement} main @param {string} id */
export async function show(main, id) {
  const path = `v1/fits/${id}`;
  const asked = json(path);
  const shader = request(`${path}/export?format=glsl`).then((answer) => answer.text(), () => undefined); // If this request fails, the first use of the shader repeats it.
  main.replaceChildren(template("fit", { name: "A fit" }));
  showActions(main, path, asked);
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
  fill(main, { name, about: `Fitted ${dateOf(fit.created)}. ${stored ? "" : "Its measurement was deleted, so only the fit is shown."}` }, { measurement: `measurements/${fit.measurement}` });
  showSide(find(main, ".side"), fit);
  showComponents(find(main, ".side"), [fit]);
  find(main, "a[data-link=measurement]").hidden = find(main, "#figures").hidden = !stored;
  const dark = matchMedia("(prefers-color-scheme: dark)").matches;
  for (const image of find(main, "#figures").querySelectorAll("img")) whenOpened(image, () => showPicture(image, `v1/fits/${fit.id}/figures/${image.id}.svg?dark=${dark}`));
  if (!stored?.valid_nodes) find(main, "#lobes").closest("figure")?.remove(); // Only a gridded measurement has a figure of lobes.
}

/** Gives the buttons their actions before the fit has arrived, so that no click is lost. @param {HTMLElement} main @param {string} path @param {Promise<Fit>} asked */
function showActions(main, path, asked) {
  act(main, "share", share);
  act(main, "delete", async () => removeFit(await asked));
  act(main, "compare", async () => compareWith(await asked));
  act(main, "rename", async () => {
    const wanted = prompt("New name of the fit", find(main, "h1").textContent ?? "")?.trim();
    if (!wanted) return;
    await json(path, "PATCH", { name: wanted });
    fill(main, { name: wanted });
    setTitle(wanted);
    say("The fit has its new name.");
  });
}

/** Lets the user choose a second fit, and opens the comparison. @param {Fit} fit */
async function compareWith(fit) {
  /** @type {Fit[]} */
  const others = (await json("v1/fits?limit=200&status=succeeded")).items.filter((/** @type {Fit} */ { id }) => id !== fit.id);
  if (!others.length) return say("There is no other fit to compare with. Fit a second material first.");
  const [dialog, choice] = [find(document, "#compare-with", HTMLDialogElement), find(document, "#other-fit", HTMLSelectElement)];
  fill(dialog, { name: nameOf(fit) });
  choice.replaceChildren(...others.map((other) => make("option", { value: other.id }, `${nameOf(other)}, ${dateOf(other.created)}`)));
  dialog.onclose = () => dialog.returnValue === "compare" && location.assign(new URL(`compare?fit=${fit.id}&fit=${choice.value}`, root));
  dialog.showModal();
}

/** Shows the progress of a fit until its end, then its result or its failure. @param {HTMLElement} main @param {Fit} fit */
async function watch(main, fit) {
  const path = `v1/fits/${fit.id}`;
  setTitle(`${nameOf(fit)}: ${fit.status}`);
  main.replaceChildren(template("unfinished", { name: fit.name ?? `Fit of ${nameOf(fit)}` }));
  main.removeAttribute("aria-busy");
  const [bar, fault] = [find(main, "progress", HTMLProgressElement), find(main, ".fault")];
  act(main, "cancel", () => request(`${path}?only=cancel`, { method: "DELETE" }));
  act(main, "delete", () => removeFit(fit));
  const words = progressOf(STATES.running);
  for await (const { status, progress, error } of follow(fit)) {
    const unfinished = status === "accepted" || status === "running";
    bar.hidden = find(main, "[data-act=cancel]").hidden = !unfinished;
    find(main, "[data-act=delete]").hidden = unfinished;
    bar.value = progress;
    fault.hidden = !error;
    fault.textContent = error?.message ?? "";
    const note = unfinished ? "The result appears here when the fit is done. You may leave this page: the fit continues." : "";
    fill(main, { state: status === "running" ? words(progress) : STATES[status] ?? "", note: error ? FAULTS[error.origin] : note }, { measurement: `measurements/${fit.measurement}` });
    if (status === "succeeded") await show(main, fit.id);
  }
}
