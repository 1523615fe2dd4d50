// Shows tables of the components of one fit, or of two fits side by side, and of the surfaces of these components.
import { fill, find, make, nameOf, openapi, template, whenOpened, words } from "./app.js";
import { LABELS } from "./sphere.js";

const [two, three] = [2, 3].map((digits) => (/** @type {number} */ value) => String(Number(value.toPrecision(digits))));

// Rows of the table of components, then columns of the table of surfaces: property, title, format of a value.
/** @type {[string, string, (value: number) => string][]} */
const OF_COMPONENTS = [
  ["light_share", "light", (value) => `${Math.round(100 * value)} %`],
  ["color", "colour", (value) => value.toFixed(2)],
  ["albedo", "albedo", (value) => value.toFixed(3)],
  ["half_width_deg", "half width in °", three],
  ["height", "height in 1/sr", two],
];
/** @type {[string, string, (value: number) => string][]} */
const OF_SURFACES = [["alpha", "alpha", three], ["tail_exponent", "tail", three], ["f0", "F0", two], ["f70", "F70", two]];

/** Makes a table row whose first cell, or every cell with `heads`, is a header. @param {(Node | string | number)[]} cells @param {boolean} [heads] */
export const tableRow = (cells, heads = false) => make("tr", {}, ...cells.map((cell, i) => {
  const isHead = cell !== "" && (heads || i === 0);
  return make(isHead ? "th" : "td", isHead ? { scope: heads ? "col" : "row" } : {}, cell instanceof Node ? cell : String(cell));
}));

/** Shows a number with its range below; if there are several numbers, a tooltip shows the range of each. @param {number | null} value @param {Interval | null | undefined} range @param {number} several @param {(value: number) => string} write */
function numberCell(value, range, several, write) {
  if (value === null) return "–";
  const text = range ? `${write(range[0])} to ${write(range[1])}` : "";
  return make("span", { title: text && `${text} with a probability of 90 %` }, write(value), ...(text && several === 1 ? [make("small", {}, text)] : []));
}

/** Shows the values of a property with their ranges. @param {Record<string, any> | undefined} owner a component or a surface, if there is one @param {string} property @param {(value: number) => string} write */
function cellOf(owner, property, write) {
  const values = [owner?.[property] ?? null].flat();
  const ranges = [owner?.ranges?.[property]].flat(values.length > 1 ? 1 : 0);
  const swatch = property === "color" && owner ? [make("span", { className: "swatch", style: `background: color(srgb-linear ${owner.color.join(" ")})` })] : [];
  return make("span", {}, ...swatch, ...values.flatMap((value, i) => [...(i ? [" "] : []), numberCell(value, ranges[i], values.length, write)]));
}

/** Fills a box with the components of a fit, or of two side by side. @param {HTMLElement} box @param {Fit[]} fits */
export function showComponents(box, fits) {
  box.append(template("components"));
  const shown = LABELS.flatMap((label) => fits.map((fit) => ({ label, fit, part: fit.components.find((one) => one.label === label) })))
    .filter(({ label }) => fits.some(({ components }) => components.some((one) => one.label === label)));
  const headOf = (/** @type {typeof shown[0]} */ { label, fit }) => {
    const name = make("span", { className: `name c-part-${LABELS.indexOf(label)}` }, words(label));
    return make("span", {}, name, ...(fits.length > 1 ? [make("small", {}, nameOf(fit))] : []));
  };
  const [components, surfaces] = [find(box, ".components"), find(box, ".surfaces")];
  const rows = OF_COMPONENTS.map(([property, title, write]) => [title, ...shown.map(({ part }) => cellOf(part && { ...part, height: part.lobe.height[0] }, property, write))]);
  if (shown.length) components.append(tableRow(["", ...shown.map(headOf)], true), ...rows.map((cells) => tableRow(cells)));
  else components.append(tableRow(["There are no components: the fit is black."]));
  const all = shown.flatMap((one) => (one.part?.surfaces ?? []).map((surface) => ({ ...surface, ranges: { alpha: surface.alpha_range, f0: surface.f0_range, f70: surface.f70_range } })).map((surface) => tableRow([headOf(one), ...OF_SURFACES.map(([property, , write]) => cellOf(surface, property, write))])));
  surfaces.append(tableRow(["surface", ...OF_SURFACES.map(([, title]) => title)], true), ...all);
  find(box, ".of-surfaces").hidden = !all.length;
  fill(box, { which: fits.map(nameOf).join(" and ") });
  const remarks = fits.flatMap(({ components: parts, warnings }) => parts.flatMap((part) => part.remarks).filter((remark) => !warnings.includes(remark)));
  find(box, ".remarks").append(...[...new Set(remarks)].map((remark) => make("p", { className: "note" }, remark)));
  const meanings = find(box, ".meanings");
  whenOpened(meanings, async () => {
    const { ComponentDocument, ComponentLobe, SurfaceDocument } = (await openapi()).components.schemas;
    const described = { ...ComponentDocument.properties, ...ComponentLobe.properties, ...SurfaceDocument.properties };
    meanings.replaceChildren(...[...OF_COMPONENTS, ...OF_SURFACES].map(([property, title]) => row([title], "", described[property].description)));
  });
}

/** @param {(string | HTMLElement)[]} title @param {string} value @param {string} meaning */
export function row(title, value, meaning) {
  return make("div", {}, make("dt", {}, make("span", {}, ...title), make("strong", {}, value)), make("dd", {}, meaning));
}
