// The page of one fit: its progress, why it failed, or the result.
import { act, dateOf, fill, find, follow, json, make, nameOf, remove, request, say, sendJson, setTitle, share, showPicture, template, whenOpened, whenSeen } from "./app.js";
import { keepInAddress } from "./address.js";
import { startSpheres } from "./light.js";
import { componentTable, followPlots, place, placePlots, showDownloads, showMetrics, showOptions, showWarnings, subjectOf, verdict, words } from "./said.js";
import { Sphere } from "./sphere.js";

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
  const figure = place(find(main, "#seen"));
  find(main, "#seen").append(template("sphere-controls"));
  placePlots(find(main, "#plots"));
  const picture = find(figure, ".fallback", HTMLImageElement);
  const drawn = showPicture(picture, `${path}/figures/sphere.png`).then(() => { picture.hidden = find(figure, "canvas").dataset.rough !== undefined; }, () => undefined);
  /** @type {Fit} */
  const fit = await asked;
  if (fit.status !== "succeeded") return watch(main, fit);
  const stored = await json(`v1/measurements/${fit.measurement}`).catch((error) => (error.status === 404 ? null : Promise.reject(error)));
  showResult(main, fit, stored);
  const subject = subjectOf(fit, stored);
  const sphere = new Sphere(figure, subject, shader);
  keepInAddress();
  await startSpheres([sphere], async () => { await drawn; picture.hidden = false; });
  followPlots(find(main, "#plots"), [subject]); // not before: what is below has its place now
  whenSeen(find(main, ".downloads"), () => showDownloads(find(main, ".downloads"), path));
  return showPictures(main, path, subject, Boolean(stored));
}

/** @param {HTMLElement} main @param {Fit} fit @param {Measurement | null} stored */
function showResult(main, fit, stored) {
  const name = nameOf(fit);
  setTitle(name);
  const lobes = fit.model.amplitude[0][0].length;
  const rings = fit.model.center[0][0].filter(Boolean).length;
  const model = `The model has ${lobes} ${lobes === 1 ? "lobe" : "lobes"}${rings ? ` (${rings} ${rings === 1 ? "ring" : "rings"})` : ""}.`;
  const about = `${fit.components.map(({ label }) => words(label)).join(", ") || "no light"} · ${dateOf(fit.created)}`;
  fill(main, { name, model, about, verdict: verdict(fit) }, { compare: `.#with=${fit.id}`, measurement: `measurements/${fit.measurement}` });
  showWarnings(find(main, "#warnings"), fit.warnings);
  find(main, "#components").replaceChildren(componentTable(fit));
  showMetrics(find(main, ".metrics"), fit);
  showOptions(find(main, "#options"), fit);
  find(main, "a[data-link=measurement]").hidden = find(main, "#figures").hidden = !stored;
  for (const image of /** @type {NodeListOf<HTMLImageElement>} */ (main.querySelectorAll("img[data-figure]"))) {
    whenOpened(image, () => showPicture(image, `v1/fits/${fit.id}/figures/${image.dataset.figure}.svg`));
  }
  find(main, "#lobes").hidden = !stored?.valid_nodes;
  act(main, "share", share);
  act(main, "delete", () => remove(`v1/fits/${fit.id}?only=delete`, `Delete this fit of ${name}? Its measurement stays.`));
  act(main, "rename", async () => {
    const wanted = prompt("The fit's new name", find(main, "h1").textContent ?? "")?.trim();
    if (!wanted) return;
    await sendJson(`v1/fits/${fit.id}`, "PATCH", { name: wanted });
    fill(main, { name: wanted });
    setTitle(wanted);
    say("The fit is renamed.");
  });
}

/** Shows one picture of spheres side by side. @param {HTMLElement} main @param {string} path @param {Subject} subject @param {boolean} stored */
async function showPictures(main, path, { measured, parts }, stored) {
  const names = [...(measured ? ["measured", "fitted", "difference × 4"] : ["fitted"]), ...parts.map(({ label }) => words(label))];
  find(main, "#pictures figcaption").replaceChildren(...names.map((name) => make("span", {}, name)));
  find(main, "#pictures").style.maxWidth = `${8 * names.length}rem`;
  const alone = stored ? "The measurement is a table of samples: the plots below show them." : "The measurement is not stored any more: the fit is shown alone.";
  fill(main, { pictures: measured ? "Three lights, one exposure. A black difference is a perfect fit." : alone });
  await showPicture(find(main, "#pictures img", HTMLImageElement), `${path}/figures/spheres.png`);
}

/** Follows a fit to its end, or says how it ended. @param {HTMLElement} main @param {Fit} fit */
async function watch(main, fit) {
  const path = `v1/fits/${fit.id}`;
  setTitle(`${nameOf(fit)}: ${fit.status}`);
  main.replaceChildren(template("unfinished", { name: fit.name ?? `Fit of ${nameOf(fit)}` }));
  main.removeAttribute("aria-busy");
  const [bar, fault] = [find(main, "progress", HTMLProgressElement), find(main, ".fault")];
  act(main, "cancel", () => request(`${path}?only=cancel`, { method: "DELETE" }));
  for await (const { status, progress, error } of follow(fit)) {
    const unfinished = status === "accepted" || status === "running";
    bar.hidden = find(main, "[data-act=cancel]").hidden = !unfinished;
    bar.value = progress;
    fault.hidden = !error;
    fault.textContent = error?.message ?? "";
    const note = unfinished ? "The result appears here when the fit is done. You may leave: the fit goes on." : "";
    fill(main, { state: STATES[status] ?? "", note: error ? FAULTS[error.origin] : note });
    if (status === "succeeded") await show(main, fit.id);
  }
}
