// Shows the list of all fits and the area where files are dropped, and sends the files.
import { act, breakable, fill, find, follow, json, nameOf, progressOf, removeFit, request, root, say, showPicture, sizeOf, stateOf, template, titleOf, valueOf, whenOpened, whenSeen } from "./app.js";
import { chosen, fitStored, showForm, showTable, typedOptions } from "./options.js";
import { cosines } from "./plots.js";

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
  await showAtlas(find(main, "#atlas", HTMLDetailsElement), isNew);
}

/** Shows the materials that come with the service. @param {HTMLDetailsElement} box @param {boolean} isOpen */
async function showAtlas(box, isOpen) {
  /** @type {Fit[]} */
  const fits = (await json("v1/materials")).items;
  find(box, ".cards").append(...fits.map((fit) => {
    const made = card(fit, 0, [], "sphere.png?size=112&lighting=environment");
    for (const part of made.querySelectorAll(".menu, .pick")) part.remove();
    return made;
  }));
  box.hidden = false;
  box.open = isOpen;
}

/** @param {Fit} fit @param {number} place @param {Fit[]} same fits of its name @param {string} [picture] */
function card(fit, place, same, picture = "thumbnail.png") {
  const differing = Object.entries(fit.options).filter(([name, value]) => same.some((other) => String(other.options[name]) !== String(value)));
  const options = differing.map(([name, value]) => `${titleOf(name)}: ${valueOf(value)}`).join(", ");
  const item = find(template("card", { name: ` ${nameOf(fit)}`, options }, { fit: `fits/${fit.id}` }), "li");
  find(item, ".card-name").append(...breakable(nameOf(fit)));
  Object.assign(item.dataset, { name: nameOf(fit), newest: place });
  find(item, "input", HTMLInputElement).value = fit.id;
  item.draggable = true;
  item.ondragstart = ({ dataTransfer }) => dataTransfer?.setData(DRAGGED, fit.id);
  item.ondragover = (event) => { if (event.dataTransfer?.types.includes(DRAGGED)) event.preventDefault(); };
  item.ondrop = ({ dataTransfer }) => {
    const dragged = dataTransfer?.getData(DRAGGED);
    if (dragged && dragged !== fit.id) openComparison([dragged, fit.id]);
  };
  act(item, "delete", () => removeFit(fit, item, () => item.remove()));
  update(item, fit, picture);
  return item;
}

/** Shows the state of a fit until it has ended, then its picture. @param {HTMLElement} item @param {Fit} fit @param {string} picture */
async function update(item, fit, picture) {
  for await (const now of follow(fit)) {
    const { id, status, metrics } = now;
    fill(item, { state: stateOf(now) });
    item.dataset.likeness = (1000 - (metrics?.psnr ?? 0)).toFixed(6); // Sorting puts the best fit first.
    for (const part of item.querySelectorAll(".pick")) part.toggleAttribute("hidden", status !== "succeeded");
    for (const part of item.querySelectorAll(".menu")) part.toggleAttribute("hidden", status === "accepted" || status === "running");
    const image = find(item, "img", HTMLImageElement);
    if (status === "succeeded") whenSeen(image, () => showPicture(image, `v1/fits/${id}/figures/${picture}`).catch(() => undefined));
  }
}

/** @param {HTMLElement} main */
function takeFiles(main) {
  const [form, chosen, options] = [find(main, "#upload"), find(main, "#file", HTMLInputElement), find(main, ".options")];
  /** @param {File[]} files */
  const take = async (files) => {
    if (files.length && !find(main, ".drop-main").hidden) await takeOrShow(main, files);
  };
  whenOpened(options, () => showForm(options));
  chosen.onchange = () => take([...(chosen.files ?? [])]);
  find(main, "#example").onclick = () => sendAll(main, [examplePaint()], options);
  for (const kind of ["dragover", "dragleave", "drop"]) {
    addEventListener(kind, async (event) => {
      const { relatedTarget, dataTransfer } = /** @type {DragEvent} */ (event);
      if (!dataTransfer?.types.includes("Files")) return;
      event.preventDefault();
      form.classList.toggle("over", kind === "dragover" || (kind === "dragleave" && relatedTarget !== null)); // The pointer may have moved to another part of the form.
      if (kind === "drop") await take([...dataTransfer.files]);
    });
  }
}

/** Filters the list by name while the user types, starting with the name in the address. @param {HTMLElement} main @param {HTMLElement[]} cards @param {string} name */
function search(main, cards, name) {
  const field = find(main, "#search", HTMLInputElement);
  const isPart = !find(main, "#older").hidden || location.search.includes("cursor=");
  const filter = () => {
    const wanted = field.value.trim();
    for (const item of cards) item.hidden = !String(item.dataset.name).toLowerCase().includes(wanted.toLowerCase());
    const next = isPart ? { part: " on this page", next: "Search all fits for this name" } : { part: "", next: "Show all" };
    fill(main, { wanted, ...next }, { next: isPart ? `./?${new URLSearchParams({ name: wanted })}` : "./" });
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
  button.onclick = () => openComparison(ticked().map((box) => box.value));
}

/** @param {string[]} fits */
const openComparison = (fits) => location.assign(new URL(`compare?${new URLSearchParams(fits.map((fit) => ["fit", fit]))}`, root));

const DRAGGED = "text/x-fit";
const TABLE = /\.(csv|tsv|txt|astm|xlsx|ods|xls)$/i;
/** @type {AbortController | null} */
let sending = null;
addEventListener("beforeunload", (event) => sending && event.preventDefault());

/** Shows a single table, and sends all other files. @param {HTMLElement} main @param {File[]} files */
async function takeOrShow(main, files) {
  const [box, options] = [find(main, "#table"), find(main, ".options")];
  say("");
  box.replaceChildren();
  const send = () => sendAll(main, files, options);
  if (files.length > 1 || !TABLE.test(files[0].name)) return send();
  return showTable(box, files[0], options, { fit: send });
}

/** Shows the progress of a file, or the drop area again. @param {HTMLElement} main @param {string} text */
function tell(main, text) {
  find(main, ".drop-main").hidden = Boolean(text);
  find(main, "#sending").hidden = !text;
  find(main, "#sending-title").textContent = text;
}

/** Sends files in turn, then opens the fit, or the list for several files; a faulty file does not stop the others, but the user can. @param {HTMLElement} main @param {File[]} files @param {HTMLElement} options the form */
async function sendAll(main, files, options) {
  const fits = [];
  const faults = [];
  for (const file of files) {
    const { signal } = sending = new AbortController();
    find(main, "#cancel-upload").onclick = () => sending?.abort();
    try {
      fits.push((await submit(main, file, options, signal)).id);
    } catch (error) {
      const { message } = /** @type {Error} */ (error);
      faults.push(`${file.name}: ${message}`);
      if (signal.aborted) break;
    }
  }
  sending = null;
  if (!faults.length) return location.assign(new URL(files.length > 1 ? "." : `fits/${fits[0]}`, root));
  tell(main, "");
  find(main, "#file", HTMLInputElement).value = "";
  return say([...faults, ...(fits.length ? [`Sent: ${fits.length} of ${files.length}; reload the page to see ${fits.length > 1 ? "them" : "it"}.`] : [])].join("\n"), true);
}

/** @param {HTMLElement} main @param {File} file @param {HTMLElement} options the form @param {AbortSignal} signal @returns {Promise<Fit>} */
async function submit(main, file, options, signal) {
  tell(main, `Reading ${file.name}`);
  const bar = find(main, "progress", HTMLProgressElement);
  bar.removeAttribute("value");
  await file.slice(0, 1).arrayBuffer().catch(() => { throw new Error("The browser cannot read it. Choose files; a folder cannot be sent."); });
  const measurement = await sha256(file);
  const name = file.name.replace(/(?<=.)\.\w+$/, "").replace(/[\p{C}\p{Z}/\\]+/gu, " ").trim().slice(0, 100).trim() || "measurement"; // The service accepts any such name.
  const known = measurement && await fitStored(name, measurement, typedOptions(chosen(options, "[name]:not(.of-table)"))).catch((error) => {
    if (error.status !== 404) throw error;
  });
  if (known) return known;
  const words = progressOf(`Sending ${file.name}, ${sizeOf(file)}`);
  tell(main, words(0));
  const query = new URLSearchParams([["name", name], ...chosen(options)]);
  const headers = { "Content-Type": "application/octet-stream", Prefer: "respond-async" };
  return (await request(`v1/fits?${query}`, { method: "POST", headers, body: file, signal }, uploading((done) => {
    bar.value = done;
    tell(main, done < 1 ? words(done) : `Checking ${file.name}`);
  }))).json();
}

/** Sends a request as fetch does, but with the progress of the upload. @param {(done: number) => void} onProgress @returns {typeof fetch} */
const uploading = (onProgress) => (address, { method = "POST", headers, body, signal } = {}) => new Promise((resolve, reject) => {
  const sent = new XMLHttpRequest();
  sent.open(method, String(address));
  for (const [name, value] of Object.entries(headers ?? {})) sent.setRequestHeader(name, value);
  sent.upload.onprogress = ({ loaded, total }) => onProgress(loaded / total);
  sent.onload = () => resolve(new Response(sent.responseText, { status: sent.status, headers: { "Retry-After": sent.getResponseHeader("Retry-After") ?? "1" } }));
  sent.onerror = sent.onabort = reject;
  if (signal?.aborted) return reject(); // The user cancelled while the file was hashed.
  signal?.addEventListener("abort", () => sent.abort());
  sent.send(/** @type {File} */ (body));
});

/** @param {File} file */
async function sha256(file) {
  if (!globalThis.crypto?.subtle) return null; // Browsers hash only on https and localhost.
  const content = await file.arrayBuffer().catch(() => null); // Browsers do not read 2 GB at once.
  if (!content) return null;
  const digest = new Uint8Array(await crypto.subtle.digest("SHA-256", content));
  return Array.from(digest, (byte) => byte.toString(16).padStart(2, "0")).join("");
}

const [ALPHA, F0, COLOUR] = [0.15, 0.045, [0.08, 0.16, 0.42]];

/** Returns the value of the highlight [1/sr]. @param {number[]} point half and difference angles [degrees] */
function highlight(point) {
  const [half, diff] = point.map((degrees) => Math.cos((degrees * Math.PI) / 180));
  const distribution = ALPHA ** 2 / (Math.PI * (half ** 2 * (ALPHA ** 2 - 1) + 1) ** 2);
  const [inward, outward] = cosines(point).map((cosine) => cosine + Math.sqrt(ALPHA ** 2 + (1 - ALPHA ** 2) * cosine ** 2)); // cosines with masking and shadowing
  return (distribution * (F0 + (1 - F0) * (1 - diff) ** 5)) / (inward * outward);
}

/** Makes the table as a file. */
function examplePaint() {
  const halves = Array.from({ length: 27 }, (_, step) => step ** 2 / 8);
  const points = halves.flatMap((half) => [0, 10, 20, 30, 40, 50, 60, 65, 70, 75].flatMap((diff) => [15, 45, 75, 105, 135, 165].map((phi) => [half, diff, phi])));
  const rows = points.filter((point) => Math.min(...cosines(point)) >= 0.1).map((point) => [...point, ...COLOUR.map((albedo) => albedo / Math.PI + highlight(point))].join());
  return new File([["theta_half,theta_diff,phi_diff,red,green,blue", ...rows].join("\n")], "example paint.csv", { type: "text/csv" });
}
