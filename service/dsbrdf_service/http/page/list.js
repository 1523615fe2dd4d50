// Shows the list of all fits, and the area where files are dropped.
import { act, fill, find, follow, make, nameOf, removeFit, request, root, showPicture, stateOf, template, whenOpened, whenSeen } from "./app.js";

/** @param {HTMLElement} main */
export async function show(main) {
  main.replaceChildren(template("list"));
  takeFiles(main);
  const answer = await request(`v1/fits${location.search}`);
  /** @type {Fit[]} */
  const fits = (await answer.json()).items;
  const name = new URLSearchParams(location.search).get("name") ?? "";
  const isNew = !fits.length && !name;
  fill(main, { heading: isNew ? "Fit your first material" : "Your materials" });
  find(main, "#fits").hidden = isNew;
  find(main, "#example").hidden = !isNew;
  find(main, "#upload").classList.toggle("small", !isNew);
  const cards = fits.map((fit, place) => card(fit, place, fits.filter((other) => other.name === fit.name)));
  find(main, ".cards").append(...cards);
  const [, older] = /(\?[^>]*)>; rel="next"/.exec(answer.headers.get("Link") ?? "") ?? [];
  find(main, "#older").hidden = !older;
  fill(main, {}, { older: `./${older}` });
  search(main, cards, name);
  const order = find(main, "#sort", HTMLSelectElement);
  order.onchange = () => {
    const textOf = (/** @type {HTMLElement} */ { dataset }) => dataset[order.value] ?? "";
    find(main, ".cards").append(...cards.filter((item) => item.isConnected).sort((a, b) => textOf(a).localeCompare(textOf(b), "en", { numeric: true })));
  };
  compare(main, cards);
}

/** @param {Fit} fit @param {number} place @param {Fit[]} same fits of its name */
function card(fit, place, same) {
  const differing = Object.entries(fit.options).filter(([name, value]) => same.some((other) => String(other.options[name]) !== String(value)));
  const options = differing.map(([name, value]) => `${name} = ${value ?? "none"}`).join(", ");
  const item = find(template("card", { name: ` ${nameOf(fit)}`, options }, { fit: `fits/${fit.id}` }), "li");
  find(item, ".card-name").append(...nameOf(fit).split(/(?<=_)/).flatMap((part) => [part, make("wbr")]));
  Object.assign(item.dataset, { name: nameOf(fit), newest: place });
  find(item, "input", HTMLInputElement).value = fit.id;
  act(item, "delete", () => removeFit(fit, () => item.remove()));
  update(item, fit);
  return item;
}

/** Shows the state of a fit until it has ended, then its picture. @param {HTMLElement} item @param {Fit} fit */
async function update(item, fit) {
  for await (const now of follow(fit)) {
    const { id, status, metrics } = now;
    fill(item, { state: stateOf(now) });
    item.dataset.likeness = (1000 - (metrics?.psnr ?? 0)).toFixed(6); // Sorting puts the best fit first.
    find(item, ".pick").hidden = status !== "succeeded";
    find(item, "[data-act=delete]").hidden = status === "accepted" || status === "running";
    const image = find(item, "img", HTMLImageElement);
    if (status === "succeeded") whenSeen(image, () => showPicture(image, `v1/fits/${id}/figures/thumbnail.png`).catch(() => undefined));
  }
}

/** @param {HTMLElement} main */
function takeFiles(main) {
  const [form, chosen, options] = [find(main, "#upload"), find(main, "#file", HTMLInputElement), find(main, ".options")];
  /** @param {File[]} files */
  const take = async (files) => {
    if (files.length && !find(main, ".drop-main").hidden) await (await import("./upload.js")).take(main, files);
  };
  whenOpened(options, async () => (await import("./options.js")).showForm(options));
  chosen.onchange = () => take([...(chosen.files ?? [])]);
  find(main, "#example").onclick = async () => {
    const [{ sendAll }, { examplePaint }] = await Promise.all([import("./upload.js"), import("./example.js")]);
    await sendAll(main, [examplePaint()], options);
  };
  for (const kind of ["dragover", "dragleave", "drop"]) {
    addEventListener(kind, async (event) => {
      const { relatedTarget, dataTransfer } = /** @type {DragEvent} */ (event);
      event.preventDefault();
      form.classList.toggle("over", kind === "dragover" || (kind === "dragleave" && relatedTarget !== null)); // The pointer may have moved to another part of the form.
      if (kind === "drop") await take([...(dataTransfer?.files ?? [])]);
    });
  }
}

/** Filters the list by name while the user types, starting with the name in the address. @param {HTMLElement} main @param {HTMLElement[]} cards @param {string} name */
function search(main, cards, name) {
  const field = find(main, "#search", HTMLInputElement);
  const filter = () => {
    const wanted = field.value.trim();
    for (const item of cards) item.hidden = !String(item.dataset.name).toLowerCase().includes(wanted.toLowerCase());
    fill(main, { wanted });
    find(main, "#no-match").hidden = !wanted || cards.some((item) => !item.hidden);
  };
  field.value = name;
  field.oninput = filter;
  filter();
}

/** Lets the user select two fits for comparison. @param {HTMLElement} main @param {HTMLElement[]} cards */
function compare(main, cards) {
  const boxes = cards.map((item) => find(item, "input", HTMLInputElement));
  const button = find(main, "#compare-button", HTMLButtonElement);
  const ticked = () => boxes.filter((box) => box.checked);
  const change = () => {
    button.disabled = ticked().length !== 2;
    button.textContent = ["Tick two to compare", "Tick one more to compare", "Compare the two"][ticked().length];
    for (const box of boxes) box.disabled = ticked().length === 2 && !box.checked;
  };
  for (const box of boxes) box.onchange = change;
  change();
  button.onclick = () => location.assign(new URL(`compare?${new URLSearchParams(ticked().map((box) => ["fit", box.value]))}`, root));
}
