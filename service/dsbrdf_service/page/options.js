// The form of all options that the API has, with a sentence for each, as its document describes them.
import { make, openapi, sentenceOf } from "./app.js";

/** The query parameters of a path, without the name. @param {any} document @param {string} path @returns {any[]} */
const parametersOf = (document, path) => document.paths[path].post.parameters.filter((/** @type {any} */ one) => one.in === "query" && one.name !== "name");

/** Fills a box with the form: the options of a table of samples first, then those of the fit; a grid has no table. @param {HTMLElement} box @param {boolean} [onGrid] */
export async function showForm(box, onGrid = false) {
  if (box.childElementCount) return;
  const document = await openapi();
  const ofTables = new Set(parametersOf(document, "/v1/tables").map(({ name }) => name));
  const described = document.components.schemas.FitRequest.properties.options.properties;
  for (const [title, isTable] of /** @type {[string, boolean][]} */ ([["How a table of samples is read", true], ["How it is fitted", false]])) {
    if (isTable && onGrid) continue;
    box.append(make("h3", {}, title));
    for (const { name, description, schema } of parametersOf(document, "/v1/fits").filter((one) => ofTables.has(one.name) === isTable)) {
      const field = fieldOf(name, schema, String(described[name].default ?? "none"));
      const sentence = make("span", { className: "note", id: `about-${name}` }, sentenceOf(description));
      Object.assign(field, { id: `option-${name}` }).setAttribute("aria-describedby", sentence.id);
      field.classList.toggle("of-table", isTable);
      box.append(make("div", {}, make("label", { htmlFor: field.id }, make("code", {}, name)), field, sentence));
    }
  }
}

/** A field for a value; `usual` is what counts where nothing is chosen. @param {string} name @param {any} schema @param {string} usual */
function fieldOf(name, schema, usual) {
  const kinds = [schema, ...(schema.anyOf ?? [])];
  const words = kinds.flatMap((kind) => kind.enum ?? []).map(String);
  if (schema.type === "boolean") words.push("false", "true");
  const range = kinds.find((kind) => ["integer", "number", "array"].includes(kind.type));
  if (range?.type === "integer" && range.maximum - range.minimum < 20) {
    for (let number = range.minimum; number <= range.maximum; number += 1) words.push(String(number));
  }
  if (words.length && (!range || words.length > 2)) {
    return make("select", { name, "data-usual": usual }, ...words.map((word) => make("option", { selected: word === usual }, word)));
  }
  const example = { knots_deg: "such as 0,30,60,80", columns: "such as theta_in=AOI", missing: "such as -999" }[name];
  return make("input", { name, value: usual, "data-usual": usual, placeholder: example ?? words.join(), autocomplete: "off" });
}

/** The options that were chosen, as text. @param {HTMLElement} box @param {string} [which] a selector @returns {[string, string][]} */
export function chosen(box, which = "[name]") {
  const fields = /** @type {NodeListOf<HTMLInputElement>} */ (box.querySelectorAll(which));
  return [...fields].filter(({ value, dataset }) => value.trim() && value.trim() !== dataset.usual).map(({ name, value }) => [name, value.trim()]);
}

/** The same in JSON's types. @param {[string, string][]} options */
export function inJson(options) {
  /** @param {string} text @returns {unknown} */
  const typed = (text) => {
    if (text.includes(",")) return text.split(",").map(typed);
    if (text === "none") return null;
    if (text === "true" || text === "false") return text === "true";
    return Number.isNaN(Number(text)) ? text : Number(text);
  };
  return Object.fromEntries(options.map(([name, text]) => [name, typed(text)]));
}
