// Two fits side by side, under one light.
import { dateOf, fill, find, json, link, nameOf, Problem, showPicture, template } from "./app.js";
import { keepInAddress } from "./address.js";
import { prepare, startSpheres } from "./light.js";
import { componentTable, followPlots, place, placePlots, showMetrics, showWarnings, verdict } from "./said.js";
import { Sphere } from "./sphere.js";

/** @typedef {import("./types").Fit} Fit */

/** @param {HTMLElement} main */
export async function show(main) {
  const ids = new URLSearchParams(location.search).getAll("fit");
  if (ids.length !== 2) throw new Problem(`Two fits are compared at a time; tick two in the list, not ${ids.length}.`, "Nothing to compare", 422);
  main.replaceChildren(template("compare", { names: "Two fits" }));
  find(main, "#seen").prepend(template("sphere-controls"));
  placePlots(find(main, "#plots"), true);
  prepare();
  /** @type {Fit[]} */
  const fits = await Promise.all(ids.map((id) => json(`v1/fits/${id}`)));
  const unfinished = fits.find((fit) => fit.status !== "succeeded");
  if (unfinished) throw new Problem(`The fit of ${nameOf(unfinished)} is ${unfinished.status}: there is nothing to compare yet.`, "Nothing to compare", 409);
  const names = fits.map(nameOf).join(" and ");
  document.title = `${names} – dsbrdf`;
  fill(main, { names });
  const stored = await Promise.all(fits.map((fit) => json(`v1/measurements/${fit.measurement}`).catch(() => null)));
  const spheres = fits.map((fit, i) => {
    const subject = { name: nameOf(fit), fit: fit.id, measured: stored[i]?.valid_nodes ? fit.measurement : null, samples: stored[i]?.valid_nodes === 0 ? `v1/fits/${fit.id}/samples.npy` : null, labels: fit.components.map(({ label }) => label) };
    return new Sphere(side(find(main, ".two"), fit), subject);
  });
  keepInAddress();
  followPlots(find(main, "#plots"), spheres.map(({ subject }) => subject));
  const all = await startSpheres(spheres, async ({ figure, subject }) => {
    const image = find(figure, ".fallback", HTMLImageElement);
    image.hidden = false;
    await showPicture(image, `v1/fits/${subject.fit}/figures/sphere.png?size=256`);
  });
  if (all) compare(spheres[0], spheres[1]);
  else find(main, "#between").hidden = true;
}

/** @param {HTMLElement} box @param {Fit} fit */
function side(box, fit) {
  const made = find(template("side", { name: nameOf(fit), about: dateOf(fit.created), verdict: verdict(fit) }), "section");
  made.setAttribute("aria-label", nameOf(fit));
  link(made, { fit: `fits/${fit.id}` });
  showWarnings(find(made, ".warnings"), fit.warnings);
  showMetrics(find(made, ".metrics"), fit);
  find(made, ".components-place").append(componentTable(fit, nameOf(fit)));
  box.append(made);
  return place(find(made, ".place"), template("sphere"));
}

/** Difference of what two spheres show, four times, and its peak signal-to-noise ratio over their pixels. @param {Sphere} first @param {Sphere} second */
function compare(first, second) {
  const canvas = find(document, "#between canvas", HTMLCanvasElement);
  const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d", { willReadFrequently: true }));
  const draw = () => {
    const size = first.canvas.width;
    if (second.canvas.width !== size) return;
    canvas.width = canvas.height = size;
    context.drawImage(first.canvas, 0, 0);
    context.globalCompositeOperation = "difference";
    context.drawImage(second.canvas, 0, 0);
    const { data } = context.getImageData(0, 0, size, size);
    let [sum, count] = [0, 0];
    for (let i = 0; i < data.length; i += 4) {
      if (data[i + 3] < 255) continue;
      for (const value of data.subarray(i, i + 3)) sum += value * value;
      count += 3;
    }
    const text = sum ? `${(10 * Math.log10((255 * 255 * count) / sum)).toFixed(1)} dB` : "no difference";
    find(document, "#likeness").textContent = `As shown above: ${text} (peak signal-to-noise ratio).`;
    context.globalCompositeOperation = "lighter";
    for (const _ of [1, 2]) context.drawImage(canvas, 0, 0);
  };
  first.onpaint = second.onpaint = draw;
  draw();
}
