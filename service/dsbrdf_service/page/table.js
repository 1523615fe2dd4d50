// What the service understands of a table of samples, before it is fitted.
import { fill, find, make, request, template } from "./app.js";
import { chosen, showForm } from "./options.js";
import { showWarnings } from "./said.js";

/** A row whose first cell is its head, or a row of heads. @param {(string | number)[]} cells @param {boolean} [heads] */
const row = (cells, heads = false) => make("tr", {}, ...cells.map((cell, i) => {
  const isHead = cell !== "" && (heads || i === 0);
  return make(isHead ? "th" : "td", isHead ? { scope: heads ? "col" : "row" } : {}, String(cell));
}));

/** @param {number} value */
const short = (value) => Number(value.toPrecision(4));

/**
 * Shows a table in a box, again whenever an option of it changes, and lets it be fitted once it is understood.
 * @param {HTMLElement} box @param {File} file @param {HTMLElement} options the form
 * @param {{fit?: () => unknown, understood?: () => unknown}} calls
 */
export async function showTable(box, file, options, { fit, understood }) {
  await showForm(options);
  box.replaceChildren(template("understood", { name: file.name }));
  const [button, fault] = [find(box, "[data-act=fit]", HTMLButtonElement), find(box, ".fault")];
  button.hidden = !fit;
  button.onclick = fit ?? null;
  const show = async () => {
    button.disabled = true;
    fill(box, { about: "The table is being read…" });
    const query = new URLSearchParams(chosen(options, ".of-table"));
    try {
      const headers = { "Content-Type": "text/plain" };
      describe(box, await (await request(`v1/tables?${query}`, { method: "POST", headers, body: file })).json());
      button.disabled = false;
      understood?.();
    } catch (error) {
      fill(box, { about: "" });
      fault.textContent = /** @type {Error} */ (error).message;
      /** @type {HTMLDetailsElement} */ (options.closest("details")).open = true;
    }
    fault.hidden = !button.disabled;
    find(box, ".understood").hidden = button.disabled;
  };
  options.onchange = show;
  await show();
}

/** @param {HTMLElement} box @param {Table} table */
function describe(box, table) {
  const light = table.angles_of_incidence ? `The light comes at ${table.angles_of_incidence.join("°, ")}°.` : "";
  const plane = `${Math.round(100 * table.in_plane_of_incidence)} % of the samples lie in the plane of incidence.`;
  fill(box, { about: `${table.n_rows} rows, ${table.n_samples} samples. ${light} ${plane}` });
  showWarnings(find(box, ".warnings"), table.warnings);
  const columns = table.columns.map(({ name, read_as, unit }) => [name, read_as ?? "not read", unit || "none"]);
  find(box, ".columns").replaceChildren(row(["Column", "Read as", "Unit"], true), ...columns.map((cells) => row(cells)));
  const ranges = Object.entries(table.ranges);
  const names = ranges.map(([name], i) => `${name.replace("phi_out - phi_in", "phi_out − phi_in")} in ${i < 3 ? "degrees" : "1/sr"}`);
  const ends = ["Smallest", "Largest"].map((word, i) => row([word, ...ranges.map(([, range]) => short(range[i]))]));
  const first = table.first.map((values, i) => row([`Sample ${i + 1}`, ...values.map(short)]));
  find(box, ".samples").replaceChildren(row(["", ...names], true), ...ends, ...first);
}
