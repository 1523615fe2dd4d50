// What the service understands of a table of samples, before it is fitted.
import { fill, find, make, request, template } from "./app.js";
import { chosen, showForm } from "./options.js";
import { tableRow, warningsOf } from "./said.js";

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
    button.disabled = fault.hidden = true;
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
  find(box, ".warnings").replaceChildren(...warningsOf(table.warnings));
  const columns = table.columns.map(({ name, read_as, unit }) => [name, read_as ?? "not read", unit || "none"]);
  find(box, ".columns").replaceChildren(tableRow(["Column", "Read as", "Unit"], true), ...columns.map((cells) => tableRow(cells)));
  const ranges = Object.entries(table.ranges);
  const names = ranges.map(([name], i) => `${name.replace("phi_out - phi_in", "phi_out − phi_in")} in ${i < 3 ? "degrees" : "1/sr"}`);
  const ends = ["Smallest", "Largest"].map((word, i) => tableRow([word, ...ranges.map(([, range]) => short(range[i]))]));
  const first = table.first.map((values, i) => tableRow([`Sample ${i + 1}`, ...values.map(short)]));
  find(box, ".samples").replaceChildren(tableRow(["", ...names], true), ...ends, ...first);
}
