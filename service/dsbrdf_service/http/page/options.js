// Builds the form of all options of the API, with a plain title and the API's description, common options first; and
// shows how the service reads a table of samples with them, before its fit.
import { fill, find, json, make, openapi, optionsOf, request, sentenceOf, template, TITLES, titleOf, valueOf } from "./app.js";
import { tableRow, warningsOf } from "./result.js";

const COMMON = ["columns", "scale", "missing", "n_lobes", "weighting", "robust"]; // The other options are behind "More".

/** Fills a box with the form: first the options of a table of samples, except for a measurement on a grid, then the options of the fit. @param {HTMLElement} box @param {boolean} [onGrid] */
export async function showForm(box, onGrid = false) {
  if (box.childElementCount) return;
  const document = await openapi();
  for (const isTable of onGrid ? [false] : [true, false]) {
    box.append(make("h3", {}, isTable ? "A table of samples" : "The fit"));
    const described = isTable ? tableOptionsOf(document) : optionsOf(document);
    const rows = [...new Set([...Object.keys(TITLES), ...Object.keys(described)])].filter((name) => name in described).map((name) => {
      const field = fieldOf(name, described[name]);
      const sentence = make("span", { className: "note", id: `about-${name}` }, sentenceOf(described[name].description));
      Object.assign(field, { id: `option-${name}` }).setAttribute("aria-describedby", sentence.id);
      field.classList.toggle("of-table", isTable);
      return make("div", { "data-common": COMMON.includes(name) }, make("label", { htmlFor: field.id }, titleOf(name)), field, sentence);
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
  return make("select", { name, "data-usual": usual }, ...choices.flat().map((word) => make("option", { value: word, selected: word === usual }, valueOf(word))));
}

/** Returns the options that differ from their defaults, as text. @param {HTMLElement} box @param {string} [which] a selector @returns {[string, string][]} */
export function chosen(box, which = "[name]") {
  const fields = /** @type {NodeListOf<HTMLInputElement>} */ (box.querySelectorAll(which));
  return [...fields].filter(({ value, dataset }) => value.trim() && value.trim() !== dataset.usual).map(({ name, value }) => [name, value.trim()]);
}

/** Fits a stored measurement with the chosen options. @param {string | null} name @param {string} measurement @param {Record<string, unknown>} options @returns {Promise<Fit>} */
export const fitStored = (name, measurement, options) => json(`v1/fits?${new URLSearchParams(name ? { name } : {})}`, "POST", { measurement, options });

/** Parses texts of options. @param {[string, string][]} options */
export const typedOptions = (options) => Object.fromEntries(options.map(([key, text]) => [key, typed(text)]));

/** Parses a text into a JSON value. @param {string} text @returns {unknown} */
function typed(text) {
  if (text.includes(",")) return text.split(",").map(typed);
  if (text === "none") return null;
  if (text === "true" || text === "false") return text === "true";
  return Number.isNaN(Number(text)) ? text : Number(text);
}

const MEANINGS = ["theta_in", "phi_in", "theta_out", "phi_out", "theta_half", "theta_diff", "phi_diff", "value", "red", "green", "blue", "wavelength", "weight"];
const TABLE_HEAD_BYTES = 65_536; // The names of columns are searched in this part of a file.

const short = (/** @type {number} */ value) => Number(value.toPrecision(4));

/** Shows a table in a box, updates it when an option changes, and enables its fit if it is readable.
 * @param {HTMLElement} box @param {File} file @param {HTMLElement} options the form
 * @param {{fit?: () => unknown, understood?: () => unknown}} calls */
export async function showTable(box, file, options, { fit, understood }) {
  await showForm(options);
  box.replaceChildren(template("understood", { name: file.name }));
  const [button, fault] = [find(box, "[data-act=fit]", HTMLButtonElement), find(box, ".fault")];
  find(box, ".always").hidden = !fit;
  button.onclick = fit ?? null;
  const show = async () => {
    button.disabled = fault.hidden = true;
    fill(box, { about: "Reading the table…" });
    const query = new URLSearchParams(chosen(options, ".of-table"));
    try {
      const headers = { "Content-Type": "text/plain" };
      /** @type {Table} */
      const table = await (await request(`v1/tables?${query}`, { method: "POST", headers, body: file })).json();
      showColumns(box, options, table.columns, "not read");
      describe(box, table);
      button.disabled = false;
      understood?.();
    } catch (error) {
      fill(box, { about: "" });
      fault.textContent = /** @type {Error} */ (error).message;
      showColumns(box, options, await namesIn(file), "read by its name");
    }
    fault.hidden = !button.disabled;
    find(box, ".understood").hidden = button.disabled;
  };
  options.onchange = show;
  await show();
}

/** Returns the columns of an unreadable table, from the first line with several names. @param {File} file @returns {Promise<Table["columns"]>} */
async function namesIn(file) {
  const lines = (await file.slice(0, TABLE_HEAD_BYTES).text()).split(/\r?\n/).map((line) => line.split(/[,;\t]/).map((cell) => cell.trim()));
  const names = lines.find((cells) => cells.length > 1 && cells.every((cell) => cell && Number.isNaN(Number(cell)))) ?? [];
  return names.map((name) => ({ name, read_as: null, unit: "" }));
}

/** Shows the meaning of each column, which the user can change. @param {HTMLElement} box @param {HTMLElement} options @param {Table["columns"]} columns @param {string} otherwise words for a column without a choice */
function showColumns(box, options, columns, otherwise) {
  const field = /** @type {HTMLInputElement | null} */ (options.querySelector("[name=columns]")); // A stored table has no such field.
  const given = Object.fromEntries((field?.value ?? "").split(",").map((pair) => pair.split("=").reverse()));
  const rows = columns.map(({ name, read_as, unit }) => {
    const meaning = read_as ?? given[name] ?? "";
    if (!field) return tableRow([name, meaning || otherwise, unit || "–"]);
    const words = [...new Set(["", ...MEANINGS, meaning])];
    const choice = make("select", { ariaLabel: `Read ${name} as` }, ...words.map((word) => make("option", { value: word, selected: word === meaning }, word || otherwise)));
    choice.onchange = () => {
      const others = Object.entries(given).filter(([column, word]) => word && column !== name && word !== choice.value);
      field.value = [...others, ...(choice.value ? [[name, choice.value]] : [])].map(([column, word]) => `${word}=${column}`).join(",");
      field.dispatchEvent(new Event("change", { bubbles: true }));
    };
    return tableRow([name, choice, unit || "–"]);
  });
  find(box, ".columns").replaceChildren(...(rows.length ? [tableRow(["Column", "Read as", "Unit"], true), ...rows] : []));
}

/** @param {HTMLElement} box @param {Table} table */
function describe(box, table) {
  const light = table.angles_of_incidence_deg ? `The angles of incidence are ${table.angles_of_incidence_deg.join("°, ")}°.` : "";
  const plane = `${Math.round(100 * table.in_plane_of_incidence)}% of the samples lie in the plane of incidence.`;
  fill(box, { about: `${table.n_rows} rows, ${table.n_samples} samples. ${light} ${plane}` });
  find(box, ".warnings").replaceChildren(...warningsOf(table.warnings));
  const ranges = Object.entries(table.ranges);
  const names = ranges.map(([name], i) => `${name.replace("_deg", "")} in ${i < 3 ? "degrees" : "1/sr"}`);
  const ends = ["Smallest", "Largest"].map((word, i) => tableRow([word, ...ranges.map(([, range]) => short(range[i]))]));
  const first = table.first.map((values, i) => tableRow([`Sample ${i + 1}`, ...values.map(short)]));
  find(box, ".samples").replaceChildren(tableRow(["", ...names], true), ...ends, ...first);
}
