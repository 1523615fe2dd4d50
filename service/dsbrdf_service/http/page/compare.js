// Compares two fits side by side, under one light.
import { dateOf, fill, find, json, nameOf, Problem, setTitle, template } from "./app.js";
import { showComponents } from "./components.js";
import { place, showSide, showSpheres, storedOf, subjectOf } from "./said.js";
import { colourOf } from "./shader.js";
import { running } from "./sphere.js";

const COLOURS = Array.from({ length: 256 }, (_, level) => colourOf(level / 255).map((value) => 255 * value));

/** @param {HTMLElement} main */
export async function show(main) {
  const ids = new URLSearchParams(location.search).getAll("fit");
  if (ids.length !== 2) throw new Problem(`Two fits can be compared at a time, but this address names ${ids.length}. Tick two fits in the list.`, "Nothing to compare");
  main.replaceChildren(template("compare", { names: "Two fits" }));
  /** @type {Fit[]} */
  const fits = await Promise.all(ids.map((id) => json(`v1/fits/${id}`)));
  const unfinished = fits.find((fit) => fit.status !== "succeeded");
  if (unfinished) throw new Problem(`The fit of ${nameOf(unfinished)} is ${unfinished.status}: there is nothing to compare yet.`, "Nothing to compare");
  const names = fits.map(nameOf).join(" and ");
  setTitle(names);
  fill(main, { names });
  const stored = await Promise.all(fits.map(storedOf));
  const figures = fits.map((fit) => {
    const made = find(template("compared", { name: nameOf(fit), about: dateOf(fit.created) }, { fit: `fits/${fit.id}` }), "section");
    find(main, ".two").append(made);
    showSide(find(made, ".side"), fit);
    return place(made);
  });
  showComponents(find(main, ".both"), fits);
  const subjects = fits.map((fit, i) => subjectOf(fit, stored[i]));
  await showSpheres(main, figures, subjects);
  find(main, "#between").hidden = running.length < 2;
  if (running.length === 2) compare(running);
}

/** Computes the difference of two displayed spheres, and its peak signal-to-noise ratio. @param {import("./sphere.js").Sphere[]} spheres */
function compare([first, second]) {
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
    const text = sum ? `${(10 * Math.log10((255 * 255 * seen.length) / sum)).toFixed(1)} dB` : "no difference";
    find(document, "#likeness").textContent = `Difference of the two spheres above: ${text}${sum ? " peak signal-to-noise ratio" : ""}.`;
    for (let i = 0; i < data.length; i += 4) data.set(COLOURS[Math.max(data[i], data[i + 1], data[i + 2])], i);
    context.putImageData(picture, 0, 0);
  };
  first.onpaint();
}
