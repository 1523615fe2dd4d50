// What is said of a fit beside its sphere: components, metrics, options.
import { find, make, openapi, template, whenOpened, whenSeen } from "./app.js";
import { LABELS } from "./sphere.js";

/** @typedef {import("./types").Fit} Fit */
/** @typedef {import("./types").Component} Component */
/** @typedef {import("./types").Range} Range */

/** @param {number} share */
const percent = (share) => `${Number((100 * share).toPrecision(3))} %`;
/** @param {number} value */
const three = (value) => String(Number(value.toPrecision(3)));

// Name, title, how the value is written, what it means; the most telling first.
/** @type {[string, string, (value: number) => string, string][]} */
const METRICS = [
  ["psnr", "picture", (value) => `${value.toFixed(1)} dB`, "Peak signal-to-noise ratio of spheres of fit and measurement under three lights."],
  ["relative_rms", "values", percent, "Root mean square error of the values, relative to their size."],
  ["albedo_error", "albedo", percent, "Mean error of the albedo: of all the light that is reflected."],
  ["symmetric_floor", "reciprocal floor", percent, "Error of the values of the best reciprocal model."],
  ["floor", "bivariate floor", percent, "Error of the values of the best model that ignores φ_diff."],
  ["excess", "values / floor", (value) => value.toFixed(3), "Below 1, the fit gains from its dependence on φ_diff."],
  ["male", "logarithm", (value) => value.toFixed(4), "Mean absolute logarithmic error, which counts dark parts as well."],
  ["ssim", "structure", (value) => value.toFixed(4), "Structural similarity of the two spheres; 1 is equal."],
];

// Name, what it means, its values and their ranges.
/** @type {[string, string, (part: Component) => (number | null)[], (part: Component) => (Range | null | undefined)[], (value: number) => string][]} */
const NUMBERS = [
  ["light", "Its share of all light at normal incidence.", (part) => [part.light_share], ({ ranges }) => [ranges.light_share], (value) => `${Math.round(100 * value)} %`],
  ["colour", "Red, green and blue of the albedo, over the largest.", (part) => part.color, ({ ranges }) => ranges.color, (value) => value.toFixed(2)],
  ["albedo", "Share of light at normal incidence that it reflects.", (part) => part.albedo, ({ ranges }) => ranges.albedo, (value) => value.toFixed(3)],
  ["alpha", "Roughness of its surface, that of GGX.", (part) => [part.alpha], ({ ranges }) => [ranges.alpha], three],
  ["half width", "θ_half at which slopes of its surface are half as frequent as at 0.", (part) => [part.half_width_deg], ({ ranges }) => [ranges.half_width_deg], (value) => `${three(value)}°`],
  ["kappa", "How fast its tail falls: 2 as GGX, a smaller number more slowly, a large one as Beckmann's distribution.", (part) => [part.kappa], () => [], three],
  ["F0", "Reflectance of its surface at normal incidence.", (part) => part.f0 ?? [null], ({ ranges }) => ranges.f0 ?? [], three],
  ["height in 1/sr", "Value in the middle of its layers, at normal incidence.", (part) => part.lobe.height[0], () => [], three],
];

/** What a screen shows of a linear colour. @param {number} value */
const encoded = (value) => Math.round(255 * (value <= 0.0031308 ? 12.92 * value : 1.055 * value ** (1 / 2.4) - 0.055));

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

/** The table of the components, with what its numbers mean. @param {Fit} fit @param {string} name */
export function componentTable({ components }, name) {
  if (!components.length) return make("p", { className: "note" }, "There are none: the fit reflects no light.");
  const heads = components.map(({ label }) => make("th", { scope: "col", className: `c-part-${LABELS.indexOf(label)}` }, make("span", { className: "name" }, label.replace("_", " "))));
  const rows = NUMBERS.map(([title, , valuesOf, rangesOf, write]) => make("tr", {}, make("th", { scope: "row" }, title), ...components.map((part) => {
    const ranges = rangesOf(part);
    const values = valuesOf(part).map((value, i) => {
      const [low, high] = (value === null ? null : ranges[i]) ?? [];
      const text = value === null ? "–" : write(value);
      return make("span", { title: low === undefined ? "" : `${write(low)} to ${write(Number(high))} with 90 % probability` }, text, ...rangeText(low, high, ranges.length, write));
    });
    return make("td", {}, ...(title === "colour" ? [swatch(part.color)] : []), ...values.flatMap((value) => [value, " "]));
  })));
  const table = make("table", { className: "components" }, make("thead", {}, make("tr", {}, make("td"), ...heads)), make("tbody", {}, ...rows));
  const region = make("div", { className: "scroll", tabIndex: 0, role: "region", "aria-label": `Components of ${name}` }, table);
  const meanings = NUMBERS.map(([title, meaning]) => row([title], "", meaning));
  const remarks = components.flatMap((part) => (part.remarks ?? []).map((remark) => make("p", { className: "note" }, remark)));
  return make("div", {}, region, ...remarks, make("details", {}, make("summary", {}, "What the numbers mean"), make("p", { className: "note" },
    "The components add up to the fit: each has a share of its values. alpha, kappa and F0 are those of a component's brightest layer. "
    + "In brackets, and under the pointer, is where a number lies with 90 % probability."), make("dl", { className: "metrics" }, ...meanings)));
}

/** A range beside a single number; those of colours are under the pointer. @param {number | undefined} low @param {number | undefined} high @param {number} count @param {(value: number) => string} write */
function rangeText(low, high, count, write) {
  return low === undefined || high === undefined || count > 1 ? [] : [make("small", {}, ` (${write(low)} to ${write(high)})`)];
}

/** @param {number[]} color */
function swatch(color) {
  const made = make("span", { className: "swatch", "aria-hidden": "true" });
  made.style.background = `rgb(${color.map(encoded).join()})`;
  return made;
}

/** Fills a list with the options of a fit when it is opened. @param {HTMLElement} list @param {Fit} fit */
export function showOptions(list, { options }) {
  whenOpened(list, async () => {
    const document = await openapi();
    /** @type {any[]} */
    const known = document.paths["/v1/fits"].post.parameters;
    list.replaceChildren(...Object.entries(options).map(([name, value]) => row(
      [make("code", {}, name)], String(value ?? "none"), known.find((one) => one.name === name)?.description ?? "",
    )));
  });
}

/** Shows sentences that matter before a fit is used. @param {HTMLElement} box @param {string[]} sentences */
export function showWarnings(box, sentences) {
  box.replaceChildren(...sentences.map((sentence) => make("p", { className: "warning" }, sentence)));
}

/** Fills the list of downloads from the formats that the API has. @param {HTMLElement} list @param {(format: string) => Promise<void>} get */
export async function showDownloads(list, get) {
  const document = await openapi();
  /** @type {any[]} */
  const known = document.paths["/v1/fits/{fit_id}/export"].get.parameters;
  const { schema } = known.find((one) => one.name === "format");
  const purposes = Object.fromEntries(String(schema.description).replace(/\.$/, "").split("; ").map((part) => part.split("`: ")).map(([name, text]) => [name.slice(1), text]));
  list.replaceChildren(...schema.enum.map((/** @type {string} */ format) => {
    const button = make("button", { className: "button", type: "button" }, format);
    const purpose = make("span", { className: "note" }, purposes[format] ?? "");
    button.onclick = async () => {
      button.disabled = true;
      purpose.textContent = "It is being made…";
      purpose.textContent = await get(format).then(() => purposes[format], (error) => error.message);
      button.disabled = false;
    };
    return make("li", {}, button, purpose);
  }));
}

/** Puts the plots into a box, before the address is read. @param {HTMLElement} box @param {boolean} both whether it is for two fits */
export function placePlots(box, both) {
  box.append(template("profiles"), ...(both ? [] : [template("polar")]));
  box.querySelectorAll(".controls").forEach((controls, i) => {
    find(controls, ".wide").after(template("plot-controls"));
    if (i) for (const input of controls.querySelectorAll("input[type=radio]")) input.setAttribute("name", `polar-${input.getAttribute("name")}`);
  });
  if (!both) return;
  const [all, red] = box.querySelectorAll("input[name=channel]");
  /** @type {HTMLElement} */ (all.closest("label")).remove();
  Object.assign(red, { defaultChecked: true, checked: true });
}

/** Draws the plots in a box when it is about to be seen. @param {HTMLElement} box @param {import("./types").Subject[]} subjects */
export function followPlots(box, subjects) {
  for (const input of /** @type {NodeListOf<HTMLInputElement>} */ (box.querySelectorAll("input[type=range]"))) {
    find(/** @type {Element} */ (input.closest("label")), "output").textContent = `${input.value}°`;
  }
  whenSeen(box, async () => (await import("./plots.js")).startPlots(box, subjects));
}

/** A sphere's place in a view, from its template. @param {HTMLElement} box @param {DocumentFragment} copy */
export function place(box, copy) {
  const figure = find(copy, "figure");
  box.prepend(figure);
  return figure;
}
