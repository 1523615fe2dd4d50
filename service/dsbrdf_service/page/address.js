// What a view shows stands in its address, after #: each field that is not as the view has it at first.

/** @typedef {HTMLInputElement} Field */

const fields = () => /** @type {Field[]} */ ([...document.querySelectorAll("main input[name]")]).filter((field) => !field.closest(".options"));

function read() {
  const given = new URLSearchParams(location.hash.slice(1));
  /** @param {Field} field */
  const known = (field) => given.has(field.name) && (field.type !== "radio" || fields().some(({ name, value }) => name === field.name && value === given.get(name)));
  for (const field of fields()) {
    const value = known(field) ? given.get(field.name) : null;
    if (field.type === "radio") field.checked = value === null ? field.defaultChecked : value === field.value;
    else if (field.type === "checkbox") field.checked = value === null ? field.defaultChecked : value === "1";
    else field.value = value ?? field.defaultValue;
  }
}

function write() {
  const changed = new URLSearchParams();
  for (const field of fields()) {
    const ticked = field.type === "radio" || field.type === "checkbox";
    if (ticked ? field.checked === field.defaultChecked : field.value === field.defaultValue) continue;
    if (field.type !== "radio" || field.checked) changed.set(field.name, field.type === "checkbox" ? String(Number(field.checked)) : field.value);
  }
  const hash = changed.size ? `#${changed.toString().replaceAll("%2C", ",")}` : "";
  history.replaceState(null, "", location.pathname + location.search + hash);
}

let later = 0;
function soon() {
  clearTimeout(later);
  later = setTimeout(write, 200); // browsers refuse more than a few changes a second
}

/** Sets the fields as the address says, and keeps the address as the fields are. */
export function keepInAddress() {
  read();
  for (const kind of ["input", "change"]) document.addEventListener(kind, soon);
}
