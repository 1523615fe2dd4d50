// What is said of a fit beside its sphere: components, metrics, options, downloads; and where its plots are.
import { download, fill, find, make, nameOf, openapi, sentenceOf, template, whenOpened, whenSeen } from "./app.js";
import { LABELS } from "./sphere.js";

/** @param {number} share */
const percent = (share) => `${Number((100 * share).toPrecision(3))} %`;
/** @param {number} value */
const three = (value) => String(Number(value.toPrecision(3)));
/** @param {string} label */
export const words = (label) => label.replace("_", " ");

// Name, title, how the value is written, what it means; the most telling first.
/** @type {[string, string, (value: number) => string, string][]} */
const METRICS = [
  ["psnr", "picture", (value) => `${value.toFixed(1)} dB`, "Peak signal-to-noise ratio of spheres of fit and measurement under three lights."],
  ["relative_rms", "values", percent, "Root mean square error of the values, relative to their size."],
  ["relative_rms_left_out", "values left out", percent, "The same at samples that the fit did not see."],
  ["albedo_error", "albedo", percent, "Mean error of the albedo: of all the light that is reflected."],
  ["symmetric_floor", "reciprocal floor", percent, "The error that the best reciprocal model would have."],
  ["floor", "bivariate floor", percent, "The error that the best model without φ_diff would have."],
  ["excess", "values / floor", (value) => value.toFixed(3), "Error of the values over the bivariate floor: below 1, the fit gains from φ_diff."],
  ["male", "logarithm", (value) => value.toFixed(4), "Mean absolute logarithmic error, which counts dark parts as well."],
  ["ssim", "structure", (value) => value.toFixed(4), "Structural similarity of the two spheres; 1 is equal."],
];

// Name, what it means, its values and their ranges.
/** @type {[string, string, (part: Component) => (number | null)[], (part: Component) => (Interval | null)[], (value: number) => string][]} */
const NUMBERS = [
  ["light", "Its share of all light at normal incidence.", (part) => [part.light_share], ({ ranges }) => [ranges.light_share], (value) => `${Math.round(100 * value)} %`],
  ["colour", "Red, green and blue of the albedo, over the largest.", (part) => part.color, ({ ranges }) => ranges.color, (value) => value.toFixed(2)],
  ["albedo", "Share of light at normal incidence that it reflects.", (part) => part.albedo, ({ ranges }) => ranges.albedo, (value) => value.toFixed(3)],
  ["alpha", "Roughness of its surface, that of GGX.", (part) => [part.alpha], ({ ranges }) => [ranges.alpha], three],
  ["half width", "The θ_half at which slopes of its surface are half as frequent as at θ_half = 0.", (part) => [part.half_width_deg], ({ ranges }) => [ranges.half_width_deg], (value) => `${three(value)}°`],
  ["kappa", "How fast its tail falls: 2 is GGX, a smaller number falls more slowly, a large one is Beckmann's distribution.", (part) => [part.kappa], () => [], three],
  ["F0", "Reflectance of its surface at normal incidence.", (part) => part.f0 ?? [null], ({ ranges }) => ranges.f0 ?? [], three],
  ["height in 1/sr", "Its value at θ_half = 0, at normal incidence.", (part) => part.lobe.height[0], () => [], three],
];
const RANGES = "The components add up to the fit: each has a share of its values. alpha, kappa and F0 are those of a component's brightest layer. "
  + "With a probability of 90 %, a number lies in the range in brackets; hold the pointer over a colour to see its range.";

/** @param {(string | HTMLElement)[]} title @param {string} value @param {string} meaning */
function row(title, value, meaning) {
  return make("div", {}, make("dt", {}, make("span", {}, ...title), make("strong", {}, value)), make("dd", {}, meaning));
}

/** Fills a list with the metrics of a fit. @param {HTMLElement} list @param {Fit} fit */
export function showMetrics(list, { metrics }) {
  const known = METRICS.flatMap(([name, title, write, meaning]) => {
    const value = metrics?.[name] ?? null;
    return value === null ? [] : [row([`${title} `, make("code", {}, name)], write(value), meaning)];
  });
  list.replaceChildren(...(known.length ? known : [row(["This fit has no metrics."], "", "")]));
}

/** The quality of a fit in words. @param {Fit} fit */
export function verdict({ likeness, metrics }) {
  const error = metrics?.relative_rms_left_out;
  if (!likeness && error) return `${percent(error)} off at samples that the fit did not see`;
  return likeness ? likeness[0].toUpperCase() + likeness.slice(1) : "How good it is";
}

/** The table of the components, with what its numbers mean. @param {Fit} fit */
export function componentTable(fit) {
  const { components } = fit;
  if (!components.length) return make("p", { className: "note" }, "There are none: the fit reflects no light.");
  const made = find(template("components"), "div");
  const heads = components.map(({ label }) => make("th", { scope: "col", className: `c-part-${LABELS.indexOf(label)}` }, make("span", { className: "name" }, words(label))));
  const rows = NUMBERS.map(([title, , valuesOf, rangesOf, write]) => make("tr", {}, make("th", { scope: "row" }, title), ...components.map((part) => {
    const cells = valuesOf(part).map((value, i) => numberCell(value, rangesOf(part), i, write));
    return make("td", {}, ...(title === "colour" ? [swatch(part.color)] : []), ...cells.flatMap((cell) => [cell, " "]));
  })));
  find(made, ".scroll").setAttribute("aria-label", `Components of ${nameOf(fit)}`);
  find(made, "table").append(make("thead", {}, make("tr", {}, make("td"), ...heads)), make("tbody", {}, ...rows));
  find(made, ".metrics").append(...NUMBERS.map(([title, meaning]) => row([title], "", meaning)));
  const remarks = components.flatMap((part) => part.remarks ?? []).map((remark) => make("p", { className: "note" }, remark));
  find(made, ".scroll").after(...remarks);
  fill(made, { ranges: RANGES });
  return made;
}

/** A number with its range: beside it, or under the pointer where there are several. @param {number | null} value @param {(Interval | null)[]} ranges @param {number} i @param {(value: number) => string} write */
function numberCell(value, ranges, i, write) {
  const range = value === null ? null : ranges[i];
  const text = range ? `${write(range[0])} to ${write(range[1])}` : "";
  const beside = range && ranges.length === 1 ? [make("small", {}, ` (${text})`)] : [];
  return make("span", { title: text && `${text} with a probability of 90 %` }, value === null ? "–" : write(value), ...beside);
}

/** A square of a linear colour, as a screen shows it. @param {number[]} color */
function swatch(color) {
  const made = make("span", { className: "swatch", "aria-hidden": "true" });
  const encoded = color.map((value) => Math.round(255 * (value <= 0.0031308 ? 12.92 * value : 1.055 * value ** (1 / 2.4) - 0.055)));
  made.style.background = `rgb(${encoded.join()})`;
  return made;
}

/** Fills a list with the options of a fit when it is opened. @param {HTMLElement} list @param {Fit} fit */
export function showOptions(list, { options }) {
  whenOpened(list, async () => {
    const described = (await openapi()).components.schemas.FitRequest.properties.options.properties;
    list.replaceChildren(...Object.entries(options).map(([name, value]) => row([make("code", {}, name)], String(value ?? "none"), sentenceOf(described[name].description))));
  });
}

/** Shows sentences that matter before a fit is used. @param {HTMLElement} box @param {string[]} sentences */
export function showWarnings(box, sentences) {
  box.replaceChildren(...sentences.map((sentence) => make("p", { className: "warning" }, sentence)));
}

/** Fills the list of downloads from the formats that the API has. @param {HTMLElement} list @param {string} path of the fit */
export async function showDownloads(list, path) {
  /** @type {any[]} */
  const known = (await openapi()).paths["/v1/fits/{fit_id}/export"].get.parameters;
  const { schema } = known.find((one) => one.name === "format");
  const purposes = [...String(schema.description).matchAll(/`([\w-]+)`: (.*?)(?=; `|\.$)/g)];
  list.replaceChildren(...purposes.map(([, format, purpose]) => {
    const button = make("button", { className: "button", type: "button" }, format);
    const about = make("span", { className: "note" }, purpose);
    button.onclick = async () => {
      button.disabled = true;
      about.textContent = "It is being made…";
      await download(`${path}/export?format=${format}`).finally(() => {
        button.disabled = false;
        about.textContent = purpose;
      });
    };
    return make("li", {}, button, about);
  }));
}

/** What a sphere and the plots show of a fit. @param {Fit} fit @param {Measurement | null} stored @returns {Subject} */
export function subjectOf(fit, stored) {
  const onGrid = Boolean(stored?.valid_nodes);
  return { name: nameOf(fit), fit: fit.id, measured: onGrid ? fit.measurement : null, samples: stored && !onGrid ? `v1/fits/${fit.id}/samples.npy?` : null, parts: fit.components };
}

// Of each plot its id, the name of its slider in the address, and what begins the names of its choices there.
const PLOTS = [
  { id: "profiles", slider: "theta-diff", lead: "", title: "Profiles", axis: "θ_diff", last: "89", step: "1", first: "0", line: "Mean over φ_diff, plotted over θ_half." },
  { id: "plane", slider: "theta-in", lead: "polar-", title: "Plane of incidence", axis: "θ_in", last: "85", step: "5", first: "45", line: "The light comes from the dashed line." },
];

/** Puts the plots into a box, before the address is read. @param {HTMLElement} box @param {boolean} [both] whether it is for two fits */
export function placePlots(box, both = false) {
  for (const { id, slider, lead, title, axis, last, step, first, line } of both ? PLOTS.slice(0, 1) : PLOTS) {
    const panel = find(template("plot", { title, axis, line }), "section");
    panel.id = id;
    for (const radio of panel.querySelectorAll("input")) radio.name = lead + radio.name;
    Object.assign(find(panel, "input[type=range]", HTMLInputElement), { name: slider, max: last, step, defaultValue: first, ariaLabel: `${slider.replace("-", "_")} in degrees` });
    find(panel, ".range").hidden = id === "plane";
    find(panel, "[value=all]").closest("label")?.toggleAttribute("hidden", both);
    if (both) find(panel, "[value='0']", HTMLInputElement).defaultChecked = true;
    box.append(panel);
  }
}

/** Draws the plots in a box when it is about to be seen. @param {HTMLElement} box @param {Subject[]} subjects */
export function followPlots(box, subjects) {
  for (const label of box.querySelectorAll(".wide")) find(label, "output").textContent = `${find(label, "input", HTMLInputElement).value}°`;
  whenSeen(box, async () => (await import("./plots.js")).startPlots(box, subjects));
}

/** A sphere's place in a view. @param {HTMLElement} box */
export function place(box) {
  box.prepend(template("sphere"));
  return find(box, "figure");
}
