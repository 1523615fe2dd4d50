// Builds the form of all options of the API, with a plain title and the API's description; common options come first.
import { make, openapi, optionsOf, json, sentenceOf, words } from "./app.js";

// Titles of common options; the other options are behind "More".
const COMMON = /** @type {Record<string, string>} */ ({ columns: "Meaning of columns", scale: "Multiply all values by", missing: "Numbers that mean “no value”", n_lobes: "Number of lobes", weighting: "Weights of the samples", robust: "Give outliers less weight" });
const OTHERS = /** @type {Record<string, string>} */ ({
  cosine: "Cosine contained in the values", phi: "Meaning of phi", ring_lobes: "Number of ring lobes", horizon_cutoff_deg: "Horizon cutoff",
  variation: "Variation with theta_diff", lobe: "Family of the lobes", method: "Method", knots_deg: "Knots", mask: "Mask of the paper", em_iterations: "Iterations of the paper's method",
});
const VALUES = /** @type {Record<string, string>} */ ({ true: "yes", false: "no", auto: "automatic", none: "not set" });

/** Fills a box with the form: first the options of a table of samples, except for a measurement on a grid, then the options of the fit. @param {HTMLElement} box @param {boolean} [onGrid] */
export async function showForm(box, onGrid = false) {
  if (box.childElementCount) return;
  const document = await openapi();
  for (const isTable of onGrid ? [false] : [true, false]) {
    box.append(make("h3", {}, isTable ? "A table of samples" : "The fit"));
    const described = isTable ? tableOptionsOf(document) : optionsOf(document);
    const rows = [...new Set([...Object.keys(COMMON), ...Object.keys(OTHERS), ...Object.keys(described)])].filter((name) => name in described).map((name) => {
      const field = fieldOf(name, described[name]);
      const sentence = make("span", { className: "note", id: `about-${name}` }, make("code", {}, name), ` ${sentenceOf(described[name].description)}`);
      Object.assign(field, { id: `option-${name}` }).setAttribute("aria-describedby", sentence.id);
      field.classList.toggle("of-table", isTable);
      return make("div", { "data-common": name in COMMON }, make("label", { htmlFor: field.id }, COMMON[name] ?? OTHERS[name] ?? words(name)), field, sentence);
    });
    const [common, others] = [true, false].map((isCommon) => rows.filter(({ dataset }) => dataset.common === String(isCommon)));
    box.append(...common, make("details", {}, make("summary", {}, isTable ? "More for tables" : "More for fits"), make("div", { className: "options" }, ...others)));
  }
}

/** Returns the options of a table, which are query parameters, with their defaults. @param {any} document */
function tableOptionsOf(document) {
  const declared = document.paths["/v1/tables"].post.parameters.filter((/** @type {any} */ one) => one.in === "query");
  return Object.fromEntries(declared.map((/** @type {any} */ { name, description, schema }) => {
    const [sentence, usual = ""] = description.split(/ Default: `(.*)`\.$/);
    return [name, { ...schema, description: sentence, default: usual }];
  }));
}

/** Makes a select for a schema with few values, and otherwise a text field. @param {string} name @param {any} schema */
function fieldOf(name, schema) {
  const usual = String(schema.default ?? "none");
  /** @type {string[][]} */
  const choices = (schema.anyOf ?? [schema]).map((/** @type {any} */ { enum: all, type, minimum, maximum }) => {
    if (type === "integer" && maximum < 20) return Array.from({ length: maximum - minimum + 1 }, (_, i) => String(minimum + i));
    return all ?? { boolean: ["false", "true"], null: ["none"] }[/** @type {string} */ (type)];
  });
  if (!choices.every(Boolean)) return make("input", { name, value: usual, "data-usual": usual, autocomplete: "off" });
  return make("select", { name, "data-usual": usual }, ...choices.flat().map((word) => make("option", { value: word, selected: word === usual }, VALUES[word] ?? word)));
}

/** Returns the options that differ from their defaults, as text. @param {HTMLElement} box @param {string} [which] a selector @returns {[string, string][]} */
export function chosen(box, which = "[name]") {
  const fields = /** @type {NodeListOf<HTMLInputElement>} */ (box.querySelectorAll(which));
  return [...fields].filter(({ value, dataset }) => value.trim() && value.trim() !== dataset.usual).map(({ name, value }) => [name, value.trim()]);
}

/** Fits a stored measurement with the chosen options. @param {string | null} name @param {string} measurement @param {[string, string][]} options @returns {Promise<Fit>} */
export function fitStored(name, measurement, options) {
  const typedOptions = Object.fromEntries(options.map(([key, text]) => [key, typed(text)]));
  return json(`v1/fits?${new URLSearchParams(name ? { name } : {})}`, "POST", { measurement, options: typedOptions });
}

/** Parses a text into a JSON value. @param {string} text @returns {unknown} */
function typed(text) {
  if (text.includes(",")) return text.split(",").map(typed);
  if (text === "none") return null;
  if (text === "true" || text === "false") return text === "true";
  return Number.isNaN(Number(text)) ? text : Number(text);
}
