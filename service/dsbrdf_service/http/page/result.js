// Describes a fit: verdict, limits, metrics and options beside its sphere, and tables of components and surfaces; and
// inserts spheres with their controls and plots into views.
import { breakable, find, json, LABELS, make, nameOf, openapi, optionsOf, sentenceOf, showPicture, stateOf, template, titleOf, valueOf, whenOpened, words } from "./app.js";
import { showPlots } from "./plots.js";
import { Sphere, startSpheres } from "./sphere.js";

const percent = (/** @type {number} */ share) => `${Number((100 * share).toPrecision(3))}%`;
// Name, format and meaning of each metric, the most important first.
/** @type {[string, (value: number) => string, string][]} */
const METRICS = [
  ["psnr", (value) => `${value.toFixed(1)} dB`, "Peak signal-to-noise ratio between spheres of the fit and of the measurement, under three lights."],
  ["relative_rms", percent, "Root mean square error of the values, relative to their root mean square."],
  ["relative_rms_left_out", percent, "relative_rms at samples that the fit did not use."],
  ["relative_rms_expected", percent, "Estimated upper bound of relative_rms over all directions; one table in ten exceeds it."],
  ["albedo_error", percent, "Mean relative error of the total reflected light."],
  ["symmetric_floor", percent, "Smallest relative_rms of any reciprocal isotropic model."],
  ["floor", percent, "Smallest relative_rms of any model that ignores phi_diff."],
  ["excess", (value) => value.toFixed(3), "relative_rms divided by floor; below 1, the fit is better than any model that ignores phi_diff."],
  ["male", (value) => value.toFixed(4), "Mean absolute logarithmic error, in which dark values count as much as bright values."],
  ["ssim", (value) => value.toFixed(4), "Structural similarity of these two spheres; 1 means equal."],
];

/** Makes a paragraph of each warning. @param {string[]} sentences */
export const warningsOf = (sentences) => sentences.map((sentence) => make("p", { className: "warning" }, sentence));

/** Returns the measurement of a fit, or null if it was deleted or the fit comes with the service. @param {Fit} fit @returns {Promise<Measurement | null>} */
export const storedOf = async ({ measurement, started }) => (started ? json(`v1/measurements/${measurement}`).catch((error) => (error.status === 404 ? null : Promise.reject(error))) : null);

/** Returns the subject of spheres and plots for a fit. @param {Fit} fit @param {Measurement | null} stored @returns {Subject} */
export function subjectOf(fit, stored) {
  const onGrid = Boolean(stored?.valid_nodes);
  return { name: nameOf(fit), fit: fit.id, measured: onGrid ? fit.measurement : null, samples: stored && !onGrid ? `v1/measurements/${fit.measurement}/samples.npy?` : null, parts: fit.components };
}

/** Inserts a sphere into a view; until it is drawn, it shows the picture of a fit or a measurement. @param {HTMLElement} part @param {string} [path] */
export function place(part, path) {
  find(part, ".place").prepend(template("sphere"));
  if (path) showPicture(find(part, ".fallback", HTMLImageElement), `${path}/figures/sphere.png?lighting=environment&size=32`).catch(() => undefined);
  return find(part, "figure.sphere");
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
  const metrics = known.map(([name, write, meaning]) => row(name, write(Number(fit.metrics?.[name])), meaning));
  find(box, ".metrics").append(...(known.length ? metrics : [row("This fit has no metrics.", "", "")]));
  const limits = [...new Set([...fit.warnings, ...fit.components.flatMap(({ remarks }) => remarks)])].map((sentence) => make("li", {}, sentence));
  find(box, ".limits").hidden = !limits.length;
  find(box, ".limits details").hidden = limits.length < 2;
  find(box, ".limits summary").textContent = `${limits.length - 1} more`;
  const [first, others] = box.querySelectorAll(".limits ol");
  first.append(...limits.slice(0, 1));
  others.append(...limits.slice(1));
  const next = fit.measure_next ?? [];
  find(box, ".next").hidden = !next.length;
  find(box, ".directions").append(tableRow(["θ_in", "θ_out", "φ"], true), ...next.map((one) => tableRow([one.theta_in_deg, one.theta_out_deg, one.phi_deg].map((angle) => `${Math.round(angle)}°`))));
  const options = find(box, ".fitted-by");
  whenOpened(options, async () => {
    const described = optionsOf(await openapi());
    options.replaceChildren(...Object.entries(fit.options).map(([name, value]) => row(titleOf(name), valueOf(value), sentenceOf(described[name].description))));
  });
}

// The numbers of a cell have equally many decimals, with two or three significant digits in the largest number.
const [two, three] = [2, 3].map((digits) => (/** @type {number} */ value, /** @type {number} */ largest) => value.toFixed(Math.max(digits - 1 - Math.floor(Math.log10(largest || 1)), 0)));
const thousandths = (/** @type {number} */ value) => value.toFixed(3);

// Rows of the table of components, then columns of the table of surfaces: property, title, format of a value.
/** @type {[string, string, Format][]} */
const OF_COMPONENTS = [
  ["light_share", "light", (value) => `${Math.round(100 * value)}%`],
  ["color", "colour", (value) => value.toFixed(2)],
  ["albedo", "albedo", thousandths],
  ["half_width_deg", "half width in °", three],
  ["height", "height in 1/sr", two],
];
/** @type {[string, string, Format][]} */
const OF_SURFACES = [["alpha", "alpha", three], ["tail_exponent", "tail", (value) => value.toFixed(2)], ["f0", "F0", thousandths], ["f70", "F70", thousandths]];

/** Makes a table row whose first cell, or every cell with `heads`, is a header. @param {(Node | string | number)[]} cells @param {boolean} [heads] */
export const tableRow = (cells, heads = false) => make("tr", {}, ...cells.map((cell, i) => {
  const isHead = cell !== "" && (heads || i === 0);
  return make(isHead ? "th" : "td", isHead ? { scope: heads ? "col" : "row" } : {}, cell instanceof Node ? cell : String(cell));
}));

/** Shows the values of a property; the range of a single value is below it, the ranges of several are tooltips. @param {Record<string, any> | undefined} owner a component or a surface, if there is one @param {string} property @param {Format} write */
function cellOf(owner, property, write) {
  /** @type {(number | null)[]} */
  const values = [owner?.[property] ?? null].flat();
  /** @type {(Interval | null | undefined)[]} */
  const ranges = [owner?.ranges?.[property]].flat(values.length > 1 ? 1 : 0);
  const largest = Math.max(...values.map(Number), ...(values.length > 1 ? [] : ranges.flatMap((range) => range ?? [])));
  const cells = values.map((value, i) => {
    if (value === null) return "–";
    const text = ranges[i] ? `${write(ranges[i][0], largest)} to ${write(ranges[i][1], largest)}` : "";
    return make("span", { title: text && `${text} with a probability of 90%` }, write(value, largest), ...(text && values.length === 1 ? [make("small", {}, text)] : []));
  });
  const swatch = property === "color" && owner ? [make("span", { className: "swatch", style: `background: color(srgb-linear ${owner.color.join(" ")})` })] : [];
  return make("span", {}, ...swatch, ...cells.flatMap((cell, i) => (i ? [" ", cell] : [cell])));
}

/** Fills a box with the components of a fit, or of two side by side. @param {HTMLElement} box @param {Fit[]} fits */
export function showComponents(box, fits) {
  box.append(template("components"));
  const shown = LABELS.flatMap((label) => fits.map((fit) => ({ label, fit, part: fit.components.find((one) => one.label === label) })))
    .filter(({ label }) => fits.some(({ components }) => components.some((one) => one.label === label)));
  const headOf = (/** @type {typeof shown[0]} */ { label, fit }, text = words(label)) => {
    const name = make("span", { className: `name c-part-${LABELS.indexOf(label)}` }, text);
    return make("span", {}, name, ...(fits.length > 1 ? [make("small", {}, nameOf(fit))] : []));
  };
  const [components, surfaces] = [find(box, ".components"), find(box, ".surfaces")];
  const rows = OF_COMPONENTS.map(([property, title, write]) => [title, ...shown.map(({ part }) => cellOf(part && { ...part, height: part.lobe.height[0] }, property, write))]);
  if (shown.length) components.append(tableRow(["", ...shown.map((one) => headOf(one))], true), ...rows.map((cells) => tableRow(cells)));
  else components.append(tableRow(["There are no components: the fit is black."]));
  const all = shown.flatMap((one) => (one.part?.surfaces ?? []).map((surface, i) => {
    const known = { ...surface, ranges: { alpha: surface.alpha_range, f0: surface.f0_range, f70: surface.f70_range } };
    return tableRow([headOf(one, `${one.label.replace("specular_", "")} ${i + 1}`), ...OF_SURFACES.map(([property, , write]) => cellOf(known, property, write))]);
  }));
  surfaces.append(tableRow(["surface", ...OF_SURFACES.map(([, title]) => title)], true), ...all);
  find(box, ".of-surfaces").hidden = !all.length;
  const meanings = find(box, ".meanings");
  whenOpened(meanings, async () => {
    const { ComponentDocument, ComponentLobe, SurfaceDocument } = (await openapi()).components.schemas;
    const described = { ...ComponentDocument.properties, ...ComponentLobe.properties, ...SurfaceDocument.properties };
    meanings.replaceChildren(...[...OF_COMPONENTS, ...OF_SURFACES].map(([property, title]) => row(title, "", described[property].description)));
  });
}

/** @param {string} title @param {string} value @param {string} meaning */
function row(title, value, meaning) {
  return make("div", {}, make("dt", {}, make("span", {}, ...breakable(title)), make("strong", {}, value)), make("dd", {}, meaning));
}
