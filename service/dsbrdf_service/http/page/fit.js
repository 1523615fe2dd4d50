// Shows one fit (its progress, its failure or its result with downloads), or two fits side by side under one light.
import { act, answerTo, dateOf, fill, find, follow, json, madeOf, make, nameOf, openapi, Problem, progressOf, removeFit, request, root, save, say, setTitle, share, showPicture, template, whenOpened, whenSeen } from "./app.js";
import { fitStored } from "./options.js";
import { place, showComponents, showSide, showSpheres, storedOf, subjectOf } from "./result.js";
import { colourOf } from "./shader.js";
import { running } from "./sphere.js";

const FAULTS = {
  input: "The measurement or the options do not allow a fit.",
  compute: "The computation failed or met a limit of the service.",
  system: "The service could not finish this fit.",
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
  fill(main, { name, about: fit.started ? `Fitted ${dateOf(fit.created)}. ${stored ? "" : "Its measurement is not stored here, so only the fit is shown."}` : "A measured material that comes with dsbrdf." }, { measurement: `measurements/${fit.measurement}` });
  showSide(find(main, ".side"), fit);
  showComponents(find(main, ".parts"), [fit]);
  for (const name of ["rename", "delete"]) find(main, `[data-act=${name}]`).hidden = !fit.started;
  find(main, "a[data-link=measurement]").hidden = find(main, "#figures").hidden = !stored;
  const dark = matchMedia("(prefers-color-scheme: dark)").matches;
  for (const image of find(main, "#figures").querySelectorAll("img")) whenOpened(image, () => showPicture(image, `v1/fits/${fit.id}/figures/${image.id}.svg?dark=${dark}`));
}

/** Gives the buttons their actions before the fit has arrived, so that no click is lost. @param {HTMLElement} main @param {string} path @param {Promise<Fit>} asked */
function showActions(main, path, asked) {
  act(main, "share", share);
  act(main, "delete", async () => removeFit(await asked, main));
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
  const lists = await Promise.all(["v1/fits?limit=200&status=succeeded", "v1/materials"].map((path) => json(path)));
  /** @type {Fit[]} */
  const others = lists.flatMap(({ items }) => items).filter(({ id }) => id !== fit.id);
  const [dialog, choice] = [find(document, "#compare-with", HTMLDialogElement), find(document, "#other-fit", HTMLSelectElement)];
  fill(dialog, { name: nameOf(fit) });
  choice.replaceChildren(...others.map((other) => make("option", { value: other.id }, `${nameOf(other)}, ${madeOf(other)}`)));
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
  act(main, "delete", () => removeFit(fit, main));
  act(main, "repeat", async () => {
    await fitStored(fit.name, fit.measurement, fit.options);
    location.reload();
  });
  const words = progressOf(STATES.running);
  for await (const { status, progress, error } of follow(fit)) {
    const unfinished = status === "accepted" || status === "running";
    bar.hidden = find(main, "[data-act=cancel]").hidden = !unfinished;
    find(main, "[data-act=delete]").hidden = unfinished;
    find(main, "[data-act=repeat]").hidden = unfinished || error?.origin === "input"; // An equal request would fail again.
    bar.value = progress;
    fault.hidden = !error;
    fault.textContent = error?.message ?? "";
    const note = unfinished ? "The result appears here when the fit is done. You may leave this page: the fit continues." : "";
    fill(main, { state: status === "running" ? words(progress) : STATES[status] ?? "", note: error ? FAULTS[error.origin] : note }, { measurement: `measurements/${fit.measurement}` });
    if (status === "succeeded") await show(main, fit.id);
  }
}

const COLOURS = Array.from({ length: 256 }, (_, level) => colourOf(level / 255).map((value) => 255 * value));

/** Shows two fits side by side, under one light. @param {HTMLElement} main */
export async function compare(main) {
  const ids = new URLSearchParams(location.search).getAll("fit");
  if (ids.length !== 2) throw new Problem(`Two fits can be compared at a time, but this address names ${ids.length}. Tick two fits in the list.`, "Nothing to compare");
  /** @type {Fit[]} */
  const fits = await Promise.all(ids.map((id) => json(`v1/fits/${id}`)));
  const unfinished = fits.find((fit) => fit.status !== "succeeded");
  if (unfinished) throw new Problem(`The fit of ${nameOf(unfinished)} is ${unfinished.status}: there is nothing to compare yet.`, "Nothing to compare");
  const names = fits.map(nameOf).join(" and ");
  setTitle(names);
  main.replaceChildren(template("compare", { names }));
  const stored = await Promise.all(fits.map(storedOf));
  const figures = fits.map((fit) => {
    const made = find(template("compared", { name: nameOf(fit), about: madeOf(fit) }, { fit: `fits/${fit.id}` }), "section");
    const side = make("section", { className: "panel", ariaLabel: `Result of ${nameOf(fit)}` });
    find(main, ".spheres").append(made);
    find(main, ".sides").append(side);
    showSide(side, fit);
    return place(made);
  });
  showComponents(find(main, ".both"), fits);
  const subjects = fits.map((fit, i) => subjectOf(fit, stored[i]));
  await showSpheres(main, figures, subjects);
  find(main, "#between").hidden = running.length < 2;
  if (running.length === 2) showDifference(running);
}

/** Computes the difference of two displayed spheres, and its peak signal-to-noise ratio. @param {import("./sphere.js").Sphere[]} spheres */
function showDifference([first, second]) {
  const canvas = find(document, "#between canvas", HTMLCanvasElement);
  const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d", { willReadFrequently: true }));
  first.onpaint = second.onpaint = () => {
    const size = first.canvas.width;
    if (second.canvas.width !== size) return;
    canvas.width = canvas.height = size;
    context.drawImage(first.canvas, 0, 0);
    context.globalCompositeOperation = "difference";
    context.drawImage(second.canvas, 0, 0);
    context.globalCompositeOperation = "source-over";
    const picture = context.getImageData(0, 0, size, size);
    const { data } = picture;
    const seen = data.filter((_, i) => i % 4 < 3 && data[i - (i % 4) + 3] === 255);
    const sum = seen.reduce((total, value) => total + value * value, 0);
    const text = sum ? `${(10 * Math.log10((255 * 255 * seen.length) / sum)).toFixed(1)}\u00a0dB` : "no difference";
    find(document, "#likeness").textContent = `Difference of the two spheres above: ${text}${sum ? " peak signal-to-noise ratio" : ""}.`;
    for (let i = 0; i < data.length; i += 4) data.set(COLOURS[Math.max(data[i], data[i + 1], data[i + 2])], i);
    context.putImageData(picture, 0, 0);
  };
  first.onpaint();
}

// Common programs come first; formats without an entry are listed last.
const PROGRAMS = /** @type {Record<string, string>} */ ({
  bsdf: "Mitsuba 3", materialx: "Blender, Arnold, Maya", glsl: "three.js and other shaders", brdf: "BRDF Explorer", python: "NumPy, PyTorch, JAX",
  "bsdf-spectral": "pbrt-v4, spectral Mitsuba", merl: "Programs that read MERL files", components: "A spreadsheet: components", csv: "A spreadsheet: lobes", json: "dsbrdf itself, Mitsuba's plugin",
});

const SLOW = ["materialx"]; // The service needs up to minutes for these files.

/** Fills the list of downloads from the formats that the API has. @param {HTMLElement} list @param {string} path of the fit */
async function showDownloads(list, path) {
  /** @type {any[]} */
  const known = (await openapi()).paths["/v1/fits/{fit_id}/export"].get.parameters;
  const described = (/** @type {string} */ name) => String(known.find((one) => one.name === name)?.schema.description);
  const purposes = new Map([...described("format").matchAll(/`([\w-]+)`: (.*?)(?=; `|\.$)/g)].map(([, format, purpose]) => [format, purpose]));
  const formats = [...new Set([...Object.keys(PROGRAMS), ...purposes.keys()])].filter((format) => purposes.has(format));
  list.replaceChildren(...formats.map((format) => {
    const program = PROGRAMS[format] ?? format;
    const hasExample = described("example").includes(`\`${format}\``);
    const about = make("span", {}, make("strong", {}, program), make("small", {}, purposes.get(format) ?? ""));
    return make("li", {}, about, button(format, `${path}/export?format=${format}`), ...(hasExample ? [button("example scene", `${path}/export?format=${format}&example=true`, ` for ${program}`)] : []));
  }));
}

/** Makes a button that downloads a file; a slow file is prepared when the page is idle. @param {string} text @param {string} path @param {string} [more] additional words for screen readers */
function button(text, path, more = "") {
  const [name, made] = [make("span", {}, text), make("button", { className: "button", type: "button" })];
  made.append(name, make("span", { className: "sr" }, more));
  /** @type {Promise<Response> | null} */
  let prepared = null;
  const ask = () => (prepared ??= answerTo(path).catch((error) => {
    prepared = null;
    throw error;
  }));
  if (SLOW.includes(text)) requestIdleCallback(() => ask().catch(() => undefined));
  made.onclick = async () => {
    made.disabled = true;
    const preparing = setTimeout(() => { name.textContent = "Preparing…"; }, 300);
    try {
      await save((await ask()).clone());
    } finally {
      clearTimeout(preparing);
      name.textContent = text;
      made.disabled = false;
    }
  };
  return made;
}
