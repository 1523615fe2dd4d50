// Shows how the service reads a table of samples, before its fit.
import { fill, find, make, request, template } from "./app.js";
import { chosen, showForm } from "./options.js";
import { tableRow } from "./components.js";
import { warningsOf } from "./said.js";

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
  button.hidden = !fit;
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
  const plane = `${Math.round(100 * table.in_plane_of_incidence)} % of the samples lie in the plane of incidence.`;
  fill(box, { about: `${table.n_rows} rows, ${table.n_samples} samples. ${light} ${plane}` });
  find(box, ".warnings").replaceChildren(...warningsOf(table.warnings));
  const ranges = Object.entries(table.ranges);
  const names = ranges.map(([name], i) => `${name.replace("_deg", "")} in ${i < 3 ? "degrees" : "1/sr"}`);
  const ends = ["Smallest", "Largest"].map((word, i) => tableRow([word, ...ranges.map(([, range]) => short(range[i]))]));
  const first = table.first.map((values, i) => tableRow([`Sample ${i + 1}`, ...values.map(short)]));
  find(box, ".samples").replaceChildren(tableRow(["", ...names], true), ...ends, ...first);
}
