// The list of all fits, and where files are dropped.
import { fill, find, json, link, nameOf, pause, request, root, showPicture, template, whenOpened, whenSeen } from "./app.js";

/** @typedef {import("./types").Fit} Fit */
const WORDS = /** @type {Record<string, string>} */ ({ accepted: "waiting", failed: "failed", cancelled: "cancelled" });

/** @param {HTMLElement} main */
export async function show(main) {
  const query = new URLSearchParams(location.search);
  if (!query.get("name")) query.delete("name");
  main.replaceChildren(template("list", { heading: "Your materials" }));
  takeFiles(main);
  const answer = await request(`v1/fits?${query}`);
  /** @type {Fit[]} */
  const fits = (await answer.json()).items;
  const name = query.get("name") ?? "";
  fill(main, { heading: fits.length || name ? "Your materials" : "Fit your first material" });
  find(main, "#fits").hidden = !fits.length && !name;
  const example = find(main, "#example");
  example.hidden = Boolean(fits.length || name);
  example.onclick = async () => (await import("./upload.js")).submitAll([(await import("./example.js")).examplePaint()]);
  const cards = fits.map((fit) => card(fit, fits));
  find(main, ".cards").append(...cards);
  const next = new URL(/<([^>]+)>; rel="next"/.exec(answer.headers.get("Link") ?? "")?.[1] ?? "", location.href).searchParams.get("cursor");
  const older = find(main, "#older", HTMLAnchorElement);
  older.hidden = !next;
  older.href = new URL(`?${new URLSearchParams({ ...(name && { name }), cursor: next ?? "" })}`, root).href;
  search(main, cards, name);
  sort(main, cards);
  compare(main, cards);
}

/** @param {Fit} fit @param {Fit[]} all */
function card(fit, all) {
  const made = template("card", { name: ` ${nameOf(fit)}` });
  const item = find(made, "li");
  link(made, { fit: `fits/${fit.id}` });
  find(item, ".card-name").append(...nameOf(fit).split(/(?<=_)/).flatMap((part) => [part, document.createElement("wbr")]));
  fill(item, { options: differing(fit, all.filter((other) => other.name === fit.name)) });
  Object.assign(item.dataset, { name: nameOf(fit), psnr: fit.metrics?.psnr ?? -1 });
  const box = find(item, "input", HTMLInputElement);
  box.value = fit.id;
  find(item, ".delete").onclick = () => remove(item, fit);
  update(item, fit);
  return item;
}

/** Shows the state of a fit, and its picture once there is one. @param {HTMLElement} item @param {Fit} fit */
async function update(item, fit) {
  const unfinished = fit.status === "accepted" || fit.status === "running";
  const running = `fitting, ${Math.round(100 * fit.progress)} %`;
  fill(item, { state: fit.likeness ?? (fit.status === "running" ? running : WORDS[fit.status] ?? "fitted") });
  item.dataset.psnr = String(fit.metrics?.psnr ?? -1);
  find(item, ".pick").hidden = fit.status !== "succeeded";
  find(item, ".delete").hidden = unfinished;
  const image = find(item, "img", HTMLImageElement);
  if (fit.status === "succeeded") whenSeen(image, () => { showPicture(image, `v1/fits/${fit.id}/figures/thumbnail.png`).catch(() => undefined); });
  if (!unfinished) return;
  await pause(1500);
  if (item.isConnected) update(item, await json(`v1/fits/${fit.id}?wait=5`).catch(() => fit));
}

/** The options in which fits of one name differ, in words. @param {Fit} fit @param {Fit[]} same */
function differing(fit, same) {
  const names = Object.keys(fit.options).filter((name) => same.some((other) => String(other.options[name]) !== String(fit.options[name])));
  return names.map((name) => `${name} = ${fit.options[name] ?? "none"}`).join(", ");
}

/** @param {HTMLElement} item @param {Fit} fit */
async function remove(item, fit) {
  if (!confirm(`Delete this fit of ${nameOf(fit)}? Its measurement stays.`)) return;
  try {
    await request(`v1/fits/${fit.id}?only=delete`, { method: "DELETE" });
    item.remove();
  } catch (error) {
    const fault = find(document, "#upload-fault"); // of no module that would have to be fetched: there may be no connection
    fault.hidden = false;
    fault.textContent = /** @type {Error} */ (error).message;
  }
}

/** @param {HTMLElement} main */
function takeFiles(main) {
  const [form, file] = [find(main, "#upload"), find(main, "#file", HTMLInputElement)];
  /** @param {FileList | undefined} files */
  const take = async (files) => {
    const chosen = [...(files ?? [])];
    if (chosen.length && !find(main, ".drop-main").hidden) (await import("./upload.js")).submitAll(chosen);
  };
  const options = find(main, ".options");
  whenOpened(options, async () => (await import("./options.js")).showForm(options));
  form.addEventListener("submit", (event) => event.preventDefault());
  file.addEventListener("change", () => take(file.files ?? undefined));
  let depth = 0;
  addEventListener("dragenter", (event) => { event.preventDefault(); depth += 1; form.classList.add("over"); });
  addEventListener("dragleave", () => { depth -= 1; if (depth <= 0) form.classList.remove("over"); });
  addEventListener("dragover", (event) => event.preventDefault());
  addEventListener("drop", (event) => {
    event.preventDefault();
    depth = 0;
    form.classList.remove("over");
    take(event.dataTransfer?.files);
  });
}

/** Filters the list by name while one types. @param {HTMLElement} main @param {HTMLElement[]} cards @param {string} name */
function search(main, cards, name) {
  const [field, none] = [find(main, "#search", HTMLInputElement), find(main, "#no-match")];
  const filter = () => {
    const wanted = field.value.trim().toLowerCase();
    for (const item of cards) item.hidden = !String(item.dataset.name).toLowerCase().includes(wanted);
    find(main, "#wanted").textContent = field.value.trim();
    none.hidden = cards.some((item) => !item.hidden);
  };
  field.value = name;
  if (name) filter();
  field.addEventListener("input", filter);
  find(main, ".search").addEventListener("submit", (event) => {
    event.preventDefault();
    location.assign(new URL(field.value ? `?${new URLSearchParams({ name: field.value })}` : ".", root));
  });
}

/** @param {HTMLElement} main @param {HTMLElement[]} cards */
function sort(main, cards) {
  const orders = /** @type {Record<string, (a: HTMLElement, b: HTMLElement) => number>} */ ({
    newest: () => 0,
    name: (a, b) => String(a.dataset.name).localeCompare(String(b.dataset.name)),
    likeness: (a, b) => Number(b.dataset.psnr) - Number(a.dataset.psnr),
  });
  const order = find(main, "#sort", HTMLSelectElement);
  order.addEventListener("change", () => find(main, ".cards").append(...[...cards].sort(orders[order.value]).filter((item) => item.isConnected)));
}

/** Lets two fits be ticked for comparison; `?with=` has ticked one. @param {HTMLElement} main @param {HTMLElement[]} cards */
function compare(main, cards) {
  const boxes = cards.map((item) => find(item, "input", HTMLInputElement));
  const button = find(main, "#compare-button", HTMLButtonElement);
  const ticked = () => boxes.filter((box) => box.checked);
  const change = () => {
    button.disabled = ticked().length !== 2;
    for (const box of boxes) box.disabled = ticked().length === 2 && !box.checked;
  };
  for (const box of boxes) {
    box.checked = location.hash === `#with=${box.value}`;
    box.addEventListener("change", change);
  }
  change();
  button.addEventListener("click", () => location.assign(new URL(`compare?${new URLSearchParams(ticked().map((box) => ["fit", box.value]))}`, root)));
}
