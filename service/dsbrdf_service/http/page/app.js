// Functions of all views: requests with the key, pictures, elements; and the choice of the view by the address.

/** The address of the service, which may be below a prefix. */
export const root = new URL("..", import.meta.url);
const STORED = `key of ${root.href}`;
const LIGHT = `light of ${root.href}`;
const MAX_TRIES = 5;
const UNDO_MS = 8000; // A deletion can be taken back during this time.
const UNREACHABLE = "The service cannot be reached. Check the connection, then try again.";

/** An error with the words of the service; the status is 0 if there is no answer. */
export class Problem extends Error {
  /** @param {string} detail @param {string} [title] @param {number} [status] */
  constructor(detail, title = "The service does not answer", status = 0) {
    super(detail.replace(/; GET [^;]*\.$/, ".").replace(/--(\w+)( (?=\S*=))?/g, (_, option, space) => `“${titleOf(option)}”${space ? ": " : ""}`)); // The remedy is for programs, or has the words of the command line.
    this.title = title;
    this.status = status;
  }
}

let pending = 0; // While this number of requests is not 0, the page shows a bar at its top.

/** Sends a request with the key, if any; asks the user for a missing key, and retries when the service says so.
 * @param {string} path @param {RequestInit & {headers?: Record<string, string>}} [options] @param {typeof fetch} [send] @returns {Promise<Response>} */
export function request(path, options = {}, send = fetch) {
  document.body.classList.toggle("busy", Boolean(pending += 1));
  return answerTo(path, options, send).finally(() => document.body.classList.toggle("busy", Boolean(pending -= 1)));
}

/** Does the same without a sign on the page. @param {string} path @param {RequestInit & {headers?: Record<string, string>}} [options] @param {typeof fetch} [send] @returns {Promise<Response>} */
export async function answerTo(path, options = {}, send = fetch) {
  for (let tries = 1; ; tries += 1) {
    const key = sessionStorage.getItem(STORED);
    const headers = { ...options.headers, ...(key && { Authorization: `Bearer ${encodeURI(key)}` }) };
    const answer = await send(new URL(path, root), { ...options, headers, credentials: "omit" }).catch(() => {
      throw new Problem(options.signal?.aborted ? "The upload was cancelled." : UNREACHABLE);
    });
    if (answer.ok) return answer;
    if (answer.status === 401) await signedIn(key);
    else if (answer.status === 429 && tries < MAX_TRIES) await pause(1000 * Number(answer.headers.get("Retry-After") ?? 1));
    else {
      const { detail = `The service answered ${answer.status}.`, title } = await answer.json().catch(() => ({}));
      throw new Problem(detail, answer.status === 404 ? "Nothing is stored here" : title ?? "Something is wrong", answer.status);
    }
  }
}

/** Sends JSON, if any, and returns the JSON of the answer. @param {string} path @param {string} [method] @param {unknown} [content] @returns {Promise<any>} */
export async function json(path, method = "GET", content) {
  const headers = { Accept: "application/json", ...(content !== undefined && { "Content-Type": "application/json", Prefer: "respond-async" }) };
  return (await request(path, { method, headers, body: JSON.stringify(content) })).json();
}

/** Returns the array of an answer in memory order; float16 as bits. @param {string} path @param {RequestInit & {headers?: Record<string, string>}} [options] @returns {Promise<any>} */
export async function askArray(path, options) {
  const file = await (await request(path, options)).arrayBuffer();
  const [low, high] = new Uint8Array(file, 8, 2);
  const start = 10 + low + 256 * high;
  const type = /'descr': '<f(\d)'/.exec(new TextDecoder("latin1").decode(file.slice(10, start)))?.[1];
  return type === "2" ? new Uint16Array(file, start) : new Float32Array(file, start);
}

/** The OpenAPI document. @returns {Promise<any>} */
export const openapi = () => json("openapi.json");
/** The schema of each option of a fit. @param {any} document @returns {Record<string, any>} */
export const optionsOf = (document) => document.components.schemas.FitRequest.properties.options.properties;
/** Replaces API words in a description by words of the form. @param {string} description */
export const sentenceOf = (description) => description.replaceAll("`", "").replaceAll("None", "none").replaceAll('"auto"', `"${VALUES.auto}"`);

/** Titles of options in forms and lists, in this order. */
export const TITLES = /** @type {Record<string, string>} */ ({
  columns: "Meaning of columns", constants: "Angles equal in all rows", scale: "Multiply all values by", missing: "Numbers that mean “no value”", n_lobes: "Number of lobes", weighting: "Weights of the samples", robust: "Give outliers less weight",
  cosine: "Cosine contained in the values", phi: "Meaning of phi", ring_lobes: "Number of ring lobes", horizon_cutoff_deg: "Horizon cutoff",
  variation: "Variation with theta_diff", lobe: "Family of the lobes", method: "Method", knots_deg: "Knots", mask: "Mask of the paper", em_iterations: "Iterations of the paper's method",
});
const VALUES = /** @type {Record<string, string>} */ ({ true: "yes", false: "no", auto: "automatic", none: "not set", null: "not set" });
export const titleOf = (/** @type {string} */ option) => TITLES[option] ?? words(option);
export const valueOf = (/** @type {unknown} */ value) => VALUES[String(value)] ?? String(value);

export const pause = (/** @type {number} */ milliseconds) => new Promise((resolve) => { setTimeout(resolve, milliseconds); });

/** @type {Promise<void> | null} */
let asking = null;
/** Waits until the refused key is replaced. @param {string | null} refused */
async function signedIn(refused) {
  if (sessionStorage.getItem(STORED) !== refused) return;
  const dialog = find(document, "#sign-in", HTMLDialogElement);
  const input = find(dialog, "input", HTMLInputElement);
  find(dialog, ".fault").hidden = !refused;
  asking ??= new Promise((resolve) => {
    dialog.showModal();
    dialog.onclose = () => {
      sessionStorage.setItem(STORED, input.value.trim());
      input.value = "";
      asking = null;
      resolve();
    };
  });
  await asking;
  find(document, "#sign-out").hidden = !sessionStorage.getItem(STORED);
}

/** Returns the element of a selector; throws if it is missing.
 * @template {Element} [T=HTMLElement]
 * @param {ParentNode} parent @param {string} selector @param {abstract new () => T} [kind] @returns {T} */
export function find(parent, selector, kind) {
  const found = parent.querySelector(selector);
  if (!(found instanceof (kind ?? HTMLElement))) throw new Error(`There is no ${selector} here.`);
  return /** @type {T} */ (found);
}

/** Makes an element with properties; names that are not properties become attributes.
 * @template {keyof HTMLElementTagNameMap} K
 * @param {K} name @param {Record<string, unknown>} [given] @param {(Node | string)[]} content @returns {HTMLElementTagNameMap[K]} */
export function make(name, given = {}, ...content) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(given)) {
    if (key in made) Object.assign(made, { [key]: value });
    else made.setAttribute(key, String(value));
  }
  made.append(...content);
  return made;
}

/** Copies the first element of a template. @param {string} id @param {Record<string, string>} [texts] @param {Record<string, string>} [paths] */
export function template(id, texts = {}, paths = {}) {
  const copy = /** @type {DocumentFragment} */ (find(document, `template#${id}`, HTMLTemplateElement).content.cloneNode(true));
  fill(copy, texts, paths);
  return copy;
}

/** Writes texts to elements with `data-text`, and addresses to elements with `data-link`. @param {ParentNode} part @param {Record<string, string>} texts @param {Record<string, string>} [paths] */
export function fill(part, texts, paths = {}) {
  for (const [name, text] of Object.entries(texts)) for (const place of part.querySelectorAll(`[data-text="${name}"]`)) place.textContent = text;
  for (const [name, path] of Object.entries(paths)) for (const place of part.querySelectorAll(`[data-link="${name}"]`)) place.setAttribute("href", new URL(path, root).href);
}

/** Sets the action of a button or form of a view. @param {ParentNode} part @param {string} name @param {() => unknown} call */
export function act(part, name, call) {
  find(part, `[data-act=${name}]`).onclick = call;
}

/** Shows a message of success or failure until it is read. @param {string} text @param {boolean} [wrong] @param {{undo?: () => unknown, close?: () => unknown}} [calls] */
export function say(text, wrong = false, { undo, close = () => say("") } = {}) {
  const said = find(document, "#said");
  said.className = wrong ? "fault" : "panel";
  said.hidden = !text;
  find(said, "span").textContent = text;
  find(said, "[data-act=undo]").hidden = !undo;
  act(said, "undo", undo ?? (() => undefined));
  act(said, "close", close);
}

/** Calls a function once, when an element is about to become visible. @param {Element} element @param {() => unknown} call */
export function whenSeen(element, call) {
  new IntersectionObserver(async (entries, observer) => {
    if (!entries.some((entry) => entry.isIntersecting)) return;
    observer.disconnect();
    await call();
  }).observe(element);
}

/** Calls a function whenever the details element around a part is opened. @param {HTMLElement} part of the box @param {() => Promise<unknown>} show */
export function whenOpened(part, show) {
  const details = /** @type {HTMLDetailsElement} */ (part.closest("details"));
  details.addEventListener("toggle", () => details.open && show());
}

/** Shows a picture of the service. @param {HTMLImageElement} image @param {string} path */
export async function showPicture(image, path) {
  image.dataset.path = path;
  const picture = await (await request(path)).blob();
  if (image.dataset.path !== path) return; // If another picture was requested meanwhile, this one is not shown.
  image.src = URL.createObjectURL(picture);
  await image.decode().catch(() => undefined);
}

/** Saves a file of the service under its name. @param {Response} answer */
export async function save(answer) {
  const [, name] = /filename\*?=(?:UTF-8''|")([^;"]+)/.exec(answer.headers.get("Content-Disposition") ?? "") ?? [];
  const address = URL.createObjectURL(await answer.blob());
  make("a", { href: address, download: decodeURIComponent(name) }).click();
  setTimeout(() => URL.revokeObjectURL(address), 60_000);
}

/** Copies the address of the view. */
export async function share() {
  await pause(250); // By then the address contains the state of the view.
  const copied = await navigator.clipboard?.writeText(location.href).then(() => true, () => false);
  say(copied ? "The link to this view is copied." : `The browser did not allow copying. The link is the address of this page: ${location.href}`);
}

/** The deletion that can be taken back. @type {(() => Promise<void>) | null} */
let undoable = null;

/** Hides what is to be deleted, and deletes it after some seconds unless the user takes this back; the next deletion, or
 * leaving the page, deletes it at once. @param {string} path @param {string} words @param {HTMLElement} shown @param {() => unknown} [then] */
export function remove(path, words, shown, then = () => location.assign(root)) {
  const hide = (/** @type {boolean} */ gone) => { shown.classList.toggle("gone", shown.inert = gone); };
  const stop = () => {
    clearTimeout(timer);
    removeEventListener("pagehide", finish);
    undoable = null;
    say("");
  };
  const finish = async () => {
    stop();
    await request(path, { method: "DELETE", keepalive: true }).then(then, (error) => {
      if (error.status === 404) return then(); // Another tab has deleted it.
      hide(false);
      throw error;
    });
  };
  undoable?.();
  undoable = finish;
  const timer = setTimeout(finish, UNDO_MS);
  addEventListener("pagehide", finish);
  hide(true);
  say(words, false, { close: finish, undo: () => { stop(); hide(false); } });
}

/** Returns a function that describes progress in per cent and the remaining time. @param {string} lead @returns {(done: number) => string} */
export function progressOf(lead) {
  let [first, begun] = [NaN, 0];
  return (done) => {
    if (Number.isNaN(first)) [first, begun] = [done, performance.now()];
    const left = Math.ceil(((performance.now() - begun) * (1 - done)) / (done - first) / 1000);
    return `${lead}: ${Math.floor(100 * done)}%${done > first + 0.02 && done < 1 ? `, about ${left} s left` : ""}`;
  };
}

/** @param {Fit} fit @param {HTMLElement} shown @param {() => unknown} [then] */
export const removeFit = (fit, shown, then) => remove(`v1/fits/${fit.id}?only=delete`, `The fit of ${nameOf(fit)} is deleted. Its measurement is kept.`, shown, then);

/** Yields the states of a fit until it has ended. @param {Fit} fit @returns {AsyncGenerator<Fit>} */
export async function* follow(fit) {
  for (let [now, lost] = [fit, false]; ;) {
    yield now;
    if (now.status !== "accepted" && now.status !== "running") return;
    await pause(500);
    const next = await json(`v1/fits/${fit.id}?wait=1`).catch((error) => {
      if (error.status && error.status !== 503) throw error; // The fit was deleted.
    });
    if (lost === Boolean(next)) say(next ? "" : "The service cannot be reached. This page waits for it.", lost = !next);
    now = next ?? now;
  }
}

/** Lets a name break after each underscore. @param {string} name */
export const breakable = (name) => name.split(/(?<=_)/).flatMap((part) => [part, make("wbr")]);
export const nameOf = (/** @type {{name: string | null, measurement: string}} */ fit) => fit.name ?? `${fit.measurement.slice(0, 8)}\u2060…`; // The ellipsis stays on the line of the name.
const STATES = /** @type {Record<string, string>} */ ({ accepted: "waiting", running: "fitting", failed: "failed", cancelled: "cancelled", succeeded: "fitted" });
/** Describes the state of a fit in one or two words. @param {Fit} fit */
export function stateOf({ status, progress, likeness, metrics }) {
  const error = 100 * (metrics?.relative_rms_expected ?? 0); // Only fits of tables have this error.
  const text = likeness ?? (error ? `error probably below ${error < 10 ? error.toPrecision(2) : Math.round(error)}%` : `${STATES[status]}${status === "running" ? `, ${Math.floor(100 * progress)}%` : ""}`);
  return text.replaceAll(" dB", "\u00a0dB");
}
const threeDigits = new Intl.NumberFormat("en", { maximumSignificantDigits: 3, useGrouping: false });
export const sizeOf = (/** @type {{size: number}} */ { size }) => (size < 999_500 ? `${threeDigits.format(size / 1e3)} kB` : `${threeDigits.format(size / 1e6)} MB`);
/** Labels of components, in the order of the weights in GLSL. */
export const LABELS = ["specular_spike", "specular_lobe", "diffuse"];
export const words = (/** @type {string} */ label) => label.replace("_", " ");
export const dateOf = (/** @type {string} */ created) => `${created.slice(0, 16).replace("T", " ")} UTC`;
/** Tells when a fit was made. @param {Fit} fit */
export const madeOf = ({ started, created }) => (started ? dateOf(created) : "comes with dsbrdf");
export const setTitle = (/** @type {string} */ name) => { document.title = `${name} – dsbrdf`; };

const fields = () => /** @type {HTMLInputElement[]} */ ([...document.querySelectorAll("main :is(input, select)[name]")]).filter((field) => !field.closest(".options, dialog"));

/** Sets the fields from the address. */
export function readAddress() {
  const given = new URLSearchParams(location.hash.slice(1) || sessionStorage.getItem(LIGHT) || ""); // The light stays between fits.
  for (const field of fields()) {
    const value = given.get(field.name);
    if (value === null) continue;
    if (field.type === "checkbox") field.checked = value === "1";
    else if (!(field instanceof HTMLSelectElement) || field.querySelector(`[value=${CSS.escape(value)}]`)) field.value = value;
  }
  write();
}

function write() {
  const changed = new URLSearchParams();
  for (const field of fields()) {
    const usual = field instanceof HTMLSelectElement ? field.options[0].value : field.defaultValue;
    if (field.type === "checkbox" && field.checked !== field.defaultChecked) changed.set(field.name, String(Number(field.checked)));
    else if (field.type !== "checkbox" && field.value !== usual) changed.set(field.name, field.value);
  }
  if (document.querySelector("#controls")) sessionStorage.setItem(LIGHT, String(new URLSearchParams([...changed].filter(([name]) => ["lighting", "highlight", "exposure"].includes(name)))));
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

/** Shows the view of the address, or an error in its place. */
export async function open() {
  const main = find(document, "main");
  const [name, id = ""] = location.pathname.slice(root.pathname.length).split("/");
  const [module, view] = { "": ["list", "show"], fits: ["fit", "show"], measurements: ["measurement", "show"], compare: ["fit", "compare"] }[name] ?? [];
  try {
    // All modules of these views are fetched in parallel.
    if (name) for (const part of ["result", "plots", "sphere", "shader"]) document.head.append(make("link", { rel: "modulepreload", href: new URL(`page/${part}.js`, root) }));
    if (!module || !view) throw new Problem(`The service has no page at ${location.pathname}. Start from the list of fits.`, "This page does not exist", 404);
    await (await import(`./${module}.js`))[view](main, id);
  } catch (error) {
    const { title, message } = error instanceof Problem ? error : { title: "Something is wrong with this page", message: String(error) };
    main.replaceChildren(template("problem", { title, detail: message }));
    act(main, "again", () => location.reload());
  } finally {
    main.removeAttribute("aria-busy");
  }
}

addEventListener("click", ({ target }) => { // A choice, or a click elsewhere, closes a menu.
  for (const menu of document.querySelectorAll("details.menu[open]")) if (!(target instanceof Element && menu.contains(target) && target.closest("summary"))) menu.removeAttribute("open");
});
addEventListener("unhandledrejection", (event) => {
  const lost = String(event.reason).includes("dynamically imported module"); // A module of the page could not be fetched.
  if (lost || event.reason instanceof Problem) event.preventDefault();
  say(lost ? UNREACHABLE : event.reason.message, true);
});
find(document, "#sign-out").hidden = !sessionStorage.getItem(STORED);
find(document, "#sign-out").onclick = () => {
  sessionStorage.clear();
  location.assign(root);
};
open();
