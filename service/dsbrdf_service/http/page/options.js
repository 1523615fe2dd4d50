// The form of all options that the API has, with a sentence for each, as its document describes them.
import { make, openapi, optionsOf, json, sentenceOf } from "./app.js";

/** Fills a box with the form: the options of a table of samples first, then those of the fit; a grid has no table. @param {HTMLElement} box @param {boolean} [onGrid] */
export async function showForm(box, onGrid = false) {
  if (box.childElementCount) return;
  const document = await openapi();
  for (const isTable of onGrid ? [false] : [true, false]) {
    box.append(make("h3", {}, isTable ? "How a table of samples is read" : "How it is fitted"));
    for (const [name, schema] of Object.entries(isTable ? tableOptionsOf(document) : optionsOf(document))) {
      const field = fieldOf(name, schema);
      const sentence = make("span", { className: "note", id: `about-${name}` }, sentenceOf(schema.description));
      Object.assign(field, { id: `option-${name}` }).setAttribute("aria-describedby", sentence.id);
      field.classList.toggle("of-table", isTable);
      box.append(make("div", {}, make("label", { htmlFor: field.id }, make("code", {}, name)), field, sentence));
    }
  }
}

/** The options of a table, which are parameters of a query, with their defaults. @param {any} document */
function tableOptionsOf(document) {
  const declared = document.paths["/v1/tables"].post.parameters.filter((/** @type {any} */ one) => one.in === "query");
  return Object.fromEntries(declared.map((/** @type {any} */ { name, description, schema }) => {
    const [sentence, usual = ""] = description.split(/ Default: `(.*)`\.$/);
    return [name, { ...schema, description: sentence, default: usual }];
  }));
}

/** A field for the values of a schema: a list where they are few. @param {string} name @param {any} schema */
function fieldOf(name, schema) {
  const usual = String(schema.default ?? "none");
  /** @type {string[][]} */
  const words = (schema.anyOf ?? [schema]).map((/** @type {any} */ { enum: all, type, minimum, maximum }) => {
    if (type === "integer" && maximum < 20) return Array.from({ length: maximum - minimum + 1 }, (_, i) => String(minimum + i));
    return all ?? { boolean: ["false", "true"], null: ["none"] }[/** @type {string} */ (type)];
  });
  if (!words.every(Boolean)) return make("input", { name, value: usual, "data-usual": usual, autocomplete: "off" });
  return make("select", { name, "data-usual": usual }, ...words.flat().map((word) => make("option", { selected: word === usual }, word)));
}

/** The options that were chosen, as text. @param {HTMLElement} box @param {string} [which] a selector @returns {[string, string][]} */
export function chosen(box, which = "[name]") {
  const fields = /** @type {NodeListOf<HTMLInputElement>} */ (box.querySelectorAll(which));
  return [...fields].filter(({ value, dataset }) => value.trim() && value.trim() !== dataset.usual).map(({ name, value }) => [name, value.trim()]);
}

/** Fits a measurement that the service has, with the options that were chosen. @param {string | null} name @param {string} measurement @param {[string, string][]} options @returns {Promise<Fit>} */
export function fitStored(name, measurement, options) {
  const typedOptions = Object.fromEntries(options.map(([key, text]) => [key, typed(text)]));
  return json(`v1/fits?${new URLSearchParams(name ? { name } : {})}`, "POST", { measurement, options: typedOptions });
}

/** The value of a text in JSON's types. @param {string} text @returns {unknown} */
function typed(text) {
  if (text.includes(",")) return text.split(",").map(typed);
  if (text === "none") return null;
  if (text === "true" || text === "false") return text === "true";
  return Number.isNaN(Number(text)) ? text : Number(text);
}
