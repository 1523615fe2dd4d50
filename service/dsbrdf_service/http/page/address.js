// Keeps the state of a view in its address, after #: each field whose value differs from its default.

const fields = () => /** @type {HTMLInputElement[]} */ ([...document.querySelectorAll("main :is(input, select)[name]")]).filter((field) => !field.closest(".options, dialog"));

/** Sets the fields from the address. */
export function readAddress() {
  const given = new URLSearchParams(location.hash.slice(1));
  for (const field of fields()) {
    const value = given.get(field.name);
    if (value === null) continue;
    if (field.type === "checkbox") field.checked = value === "1";
    else if (!(field instanceof HTMLSelectElement) || field.querySelector(`[value=${CSS.escape(value)}]`)) field.value = value;
  }
}

function write() {
  const changed = new URLSearchParams();
  for (const field of fields()) {
    const usual = field instanceof HTMLSelectElement ? field.options[0].value : field.defaultValue;
    if (field.type === "checkbox" && field.checked !== field.defaultChecked) changed.set(field.name, String(Number(field.checked)));
    else if (field.type !== "checkbox" && field.value !== usual) changed.set(field.name, field.value);
  }
  const hash = changed.size ? `#${changed.toString().replaceAll("%2C", ",")}` : "";
  history.replaceState(null, "", location.pathname + location.search + hash);
}

let later = 0;
for (const kind of ["input", "change"]) {
  document.addEventListener(kind, () => {
    clearTimeout(later);
    later = setTimeout(write, 200); // Browsers refuse more than a few changes a second.
  });
}
