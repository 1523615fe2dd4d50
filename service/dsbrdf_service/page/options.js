// The form of all options that the API has, with a sentence for each, as its document describes them.
import { make, openapi } from "./app.js";

/** Fills a box with the form. @param {HTMLElement} box */
export async function showForm(box) {
  const document = await openapi();
  /** @type {any[]} */
  const given = document.paths["/v1/fits"].post.parameters;
  const options = given.filter((one) => one.in === "query" && one.name !== "name");
  const described = document.components.schemas.FitRequest.properties.options.properties;
  box.replaceChildren(...options.map(({ name, description, schema }) => {
    const field = fieldOf(name, schema, String(described[name].default ?? "none"));
    const sentence = make("span", { className: "note", id: `about-${name}` }, description);
    field.id = `option-${name}`;
    field.setAttribute("aria-describedby", sentence.id);
    return make("div", {}, make("label", { htmlFor: field.id }, make("code", {}, name)), field, sentence);
  }));
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
    const choices = words.map((word) => make("option", { selected: word === usual }, word));
    return make("select", { name, "data-usual": usual }, ...choices);
  }
  const size = range.maximum === undefined ? "" : range.type === "array" ? "such as 0,30,60,80" : `up to ${range.maximum}`;
  return make("input", { name, value: usual, "data-usual": usual, placeholder: [...words, size].filter(Boolean).join(", or "), autocomplete: "off" });
}

/** The options that were chosen, as text. @param {HTMLElement} box @returns {[string, string][]} */
export function chosen(box) {
  const fields = /** @type {NodeListOf<HTMLInputElement>} */ (box.querySelectorAll("[name]"));
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
