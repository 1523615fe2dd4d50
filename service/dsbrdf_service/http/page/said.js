// Describes a fit beside its sphere (verdict, warnings, metrics, options), and inserts spheres and plots into views.
import { find, json, make, nameOf, openapi, optionsOf, sentenceOf, showPicture, stateOf, template, whenOpened, whenSeen } from "./app.js";
import { readAddress } from "./address.js";
import { row, tableRow } from "./components.js";
import { startSpheres } from "./light.js";
import { Sphere } from "./sphere.js";

const percent = (/** @type {number} */ share) => `${Number((100 * share).toPrecision(3))} %`;
// Name, title, format and meaning of each metric, the most important first.
/** @type {[string, string, (value: number) => string, string][]} */
const METRICS = [
  ["psnr", "picture", (value) => `${value.toFixed(1)} dB`, "Peak signal-to-noise ratio between spheres of the fit and of the measurement, under three lights."],
  ["relative_rms", "values", percent, "Root mean square error of the values, relative to their root mean square."],
  ["relative_rms_left_out", "held-out values", percent, "Relative root mean square error at samples that the fit did not use."],
  ["relative_rms_expected", "all directions", percent, "Estimated upper bound of the error over all directions; the error of one table in ten is larger."],
  ["albedo_error", "albedo", percent, "Mean relative error of the total reflected light."],
  ["symmetric_floor", "reciprocal floor", percent, "Smallest error of any model that obeys reciprocity."],
  ["floor", "bivariate floor", percent, "Smallest error of any model that ignores φ_diff."],
  ["excess", "values / floor", (value) => value.toFixed(3), "Error of the values divided by the bivariate floor; below 1, the fit is better than any model that ignores φ_diff."],
  ["male", "logarithm", (value) => value.toFixed(4), "Mean absolute logarithmic error, in which dark values count as much as bright values."],
  ["ssim", "structure", (value) => value.toFixed(4), "Structural similarity of these two spheres; 1 means equal."],
];

/** Makes a paragraph of each warning. @param {string[]} sentences */
export const warningsOf = (sentences) => sentences.map((sentence) => make("p", { className: "warning" }, sentence));

/** Returns the measurement of a fit, or null if it was deleted. @param {Fit} fit @returns {Promise<Measurement | null>} */
export const storedOf = ({ measurement }) => json(`v1/measurements/${measurement}`).catch((error) => (error.status === 404 ? null : Promise.reject(error)));

/** Returns the subject of spheres and plots for a fit. @param {Fit} fit @param {Measurement | null} stored @returns {Subject} */
export function subjectOf(fit, stored) {
  const onGrid = Boolean(stored?.valid_nodes);
  return { name: nameOf(fit), fit: fit.id, measured: onGrid ? fit.measurement : null, samples: stored && !onGrid ? `v1/measurements/${fit.measurement}/samples.npy?` : null, parts: fit.components };
}

/** Inserts a sphere into a view; until it is drawn, it shows the picture of a fit or a measurement. @param {HTMLElement} part @param {string} [path] */
export function place(part, path) {
  find(part, ".place").prepend(template("sphere"));
  if (path) showPicture(find(part, ".fallback", HTMLImageElement), `${path}/figures/sphere.png`).catch(() => undefined);
  return find(part, "figure.sphere");
}

/** @type {Plot[]} */
export const PLOTS = [{
  id: "profiles", name: "theta-diff", lead: "", title: "Profiles", axis: "θ_diff", line: "Values over θ_half, averaged over φ_diff.",
  slider: { max: 89, step: 1, defaultValue: 0 }, along: "half", start: 0, about: "over theta_half at theta_diff",
}, {
  id: "plane", name: "theta-in", lead: "polar-", title: "Plane of incidence", axis: "θ_in", line: "The dashed line is the direction of the light.",
  slider: { max: 85, step: 5, defaultValue: 45 }, along: "out", start: -90, about: "in the plane of incidence for light at",
}];

/** Inserts plots into a view with the choices in the address, and draws them when they are scrolled into view. @param {HTMLElement} main @param {Subject[]} subjects one, or two with one plot */
export function showPlots(main, subjects) {
  const box = find(main, "#plots");
  box.replaceChildren();
  for (const { id, name, lead, title, axis, line, slider } of PLOTS.slice(0, 3 - subjects.length)) {
    const panel = find(template("plot", { title, axis, line }), "section");
    panel.id = id;
    Object.assign(find(panel, "input", HTMLInputElement), { ...slider, name, ariaLabel: `${name.replace("-", "_")} in degrees` });
    for (const choice of panel.querySelectorAll("select")) choice.name = lead + choice.name;
    find(panel, ".range").hidden = id === "plane";
    if (subjects.length > 1) find(panel, "[value=all]", HTMLOptionElement).remove(); // A plot of two fits shows one channel.
    box.append(panel);
  }
  readAddress();
  whenSeen(box, async () => (await import("./plots.js")).startPlots(box, subjects));
}

/** Shows spheres under a common light, and their plots. @param {HTMLElement} main @param {HTMLElement[]} figures @param {Subject[]} subjects @param {Promise<string | undefined>} [source] GLSL of the fit, already requested */
export async function showSpheres(main, figures, subjects, source) {
  find(main, "#seen").append(template("sphere-controls"));
  const spheres = figures.map((figure, i) => new Sphere(figure, subjects[i], source)); // The address also has the state of the checkboxes of the spheres.
  showPlots(main, subjects);
  await startSpheres(spheres);
}

/** Describes a fit in the box beside its sphere. @param {HTMLElement} box @param {Fit} fit */
export function showSide(box, fit) {
  box.append(template("side", { verdict: stateOf(fit) }));
  const known = METRICS.filter(([name]) => typeof fit.metrics?.[name] === "number");
  const metrics = known.map(([name, title, write, meaning]) => row([`${title} `, make("code", {}, name)], write(Number(fit.metrics?.[name])), meaning));
  find(box, ".metrics").append(...(known.length ? metrics : [row(["This fit has no metrics."], "", "")]));
  find(box, ".warnings").append(...warningsOf(fit.warnings));
  const next = fit.measure_next ?? [];
  find(box, ".next").hidden = !next.length;
  find(box, ".directions").append(tableRow(["θ_in", "θ_out", "φ"], true), ...next.map((one) => tableRow([one.theta_in_deg, one.theta_out_deg, one.phi_deg].map((angle) => `${Math.round(angle)}°`))));
  const options = find(box, ".fitted-by");
  whenOpened(options, async () => {
    const described = optionsOf(await openapi());
    options.replaceChildren(...Object.entries(fit.options).map(([name, value]) => row([make("code", {}, name)], String(value ?? "none"), sentenceOf(described[name].description))));
  });
}
