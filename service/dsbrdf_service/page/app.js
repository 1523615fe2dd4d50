// What every view needs: requests with the key, pictures, elements; and the view that the address names.

/** The address of the service, which may be below a prefix. */
export const root = new URL("..", import.meta.url);
const STORED = `key of ${root.href}`;
const MOST_TRIES = 5;

/** What the service refuses, in its words; of status 0 if there is no answer. */
export class Problem extends Error {
  /** @param {string} detail @param {string} [title] @param {number} [status] */
  constructor(detail, title = "The service does not answer", status = 0) {
    super(detail);
    this.title = title;
    this.status = status;
  }
}

/**
 * Asks the service, with the key if there is one; asks for a key where one is needed, waits where it is told to.
 * @param {string} path @param {RequestInit} [options] @returns {Promise<Response>}
 */
export async function request(path, options = {}) {
  for (let tries = 1; ; tries += 1) {
    const key = sessionStorage.getItem(STORED);
    const answer = await send(path, options, key);
    if (answer.status === 401) await signedIn(key);
    else if (answer.status === 429 && tries < MOST_TRIES) await pause(1000 * Number(answer.headers.get("Retry-After") ?? 1));
    else if (answer.ok) return answer;
    else throw await problemOf(answer);
  }
}

/** @param {string} path @param {RequestInit} options @param {string | null} key */
async function send(path, options, key) {
  const headers = new Headers(options.headers);
  if (key) headers.set("Authorization", `Bearer ${key}`);
  try {
    return await fetch(new URL(path, root), { ...options, headers, credentials: "omit" });
  } catch (error) {
    if (options.signal?.aborted) throw error;
    throw new Problem("The service cannot be reached. Look at the connection, then try again.");
  }
}

/** @param {Response} answer */
async function problemOf(answer) {
  const said = await answer.json().catch(() => ({}));
  return new Problem(said.detail ?? `The service answered ${answer.status}.`, said.title ?? "Something is wrong", answer.status);
}

/** @param {string} path @returns {Promise<any>} */
export async function json(path) {
  return (await request(path, { headers: { Accept: "application/json" } })).json();
}

/** @param {string} path @param {string} method @param {unknown} [content] */
export function sendJson(path, method, content) {
  return request(path, { method, headers: { "Content-Type": "application/json", Prefer: "respond-async" }, body: JSON.stringify(content) });
}

/** The headers that a request of another kind needs. @returns {Record<string, string>} */
export function keyHeader() {
  const key = sessionStorage.getItem(STORED);
  return key ? { Authorization: `Bearer ${key}` } : {};
}

/** @type {Promise<any> | null} */
let described = null;
/** The OpenAPI document. @returns {Promise<any>} */
export function openapi() {
  described ??= json("openapi.json");
  return described;
}

/** @param {number} milliseconds */
export const pause = (milliseconds) => new Promise((resolve) => { setTimeout(resolve, milliseconds); });

/** @type {Promise<void> | null} */
let asking = null;
/** Waits until there is another key than the one that was refused. @param {string | null} refused */
function signedIn(refused) {
  if (sessionStorage.getItem(STORED) !== refused) return Promise.resolve();
  asking ??= askForKey().finally(() => { asking = null; });
  return asking;
}

async function askForKey() {
  const dialog = find(document, "#sign-in", HTMLDialogElement);
  const [form, fault, input] = [find(dialog, "form"), find(dialog, ".fault"), find(dialog, "input", HTMLInputElement)];
  dialog.addEventListener("cancel", (event) => event.preventDefault());
  dialog.showModal();
  await new Promise((resolve) => {
    form.onsubmit = async (event) => {
      event.preventDefault();
      const key = input.value.trim();
      const answer = await send("v1/fits?limit=1", {}, key).catch((error) => error);
      if (answer.ok) {
        sessionStorage.setItem(STORED, key);
        return resolve(undefined);
      }
      fault.hidden = false;
      fault.textContent = answer.status === 401 || answer instanceof TypeError
        ? "This is no valid key. It may have been revoked, or a character is missing."
        : answer instanceof Error ? answer.message : (await problemOf(answer)).message;
      return undefined;
    };
  });
  Object.assign(input, { value: "" });
  fault.hidden = true;
  dialog.close();
  showSignOut();
}

function showSignOut() {
  const button = find(document, "#sign-out", HTMLButtonElement);
  button.hidden = !sessionStorage.getItem(STORED);
  button.onclick = () => {
    sessionStorage.removeItem(STORED);
    location.assign(root);
  };
}

/**
 * The element of a selector, which must be there.
 * @template {Element} [T=HTMLElement]
 * @param {ParentNode} parent @param {string} selector @param {abstract new () => T} [kind] @returns {T}
 */
export function find(parent, selector, kind) {
  const found = parent.querySelector(selector);
  if (!(found instanceof (kind ?? HTMLElement))) throw new Error(`There is no ${selector} here.`);
  return /** @type {T} */ (found);
}

/**
 * A new element with properties, or attributes where it has no such property.
 * @template {keyof HTMLElementTagNameMap} K
 * @param {K} name @param {Record<string, unknown>} [given] @param {(Node | string)[]} content @returns {HTMLElementTagNameMap[K]}
 */
export function make(name, given = {}, ...content) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(given)) {
    if (key in made) Object.assign(made, { [key]: value });
    else made.setAttribute(key, String(value));
  }
  made.append(...content);
  return made;
}

/** A copy of a template, with links that hold here. @param {string} id @param {Record<string, string>} [texts] */
export function template(id, texts = {}) {
  const copy = /** @type {DocumentFragment} */ (find(document, `template#${id}`, HTMLTemplateElement).content.cloneNode(true));
  fill(copy, texts);
  return copy;
}

/** Writes texts to the elements that have their names as `data-text`. @param {ParentNode} part @param {Record<string, string>} texts */
export function fill(part, texts) {
  for (const [name, text] of Object.entries(texts)) for (const place of part.querySelectorAll(`[data-text="${name}"]`)) place.textContent = text;
}

/** Gives links their addresses below the service. @param {ParentNode} part @param {Record<string, string>} paths */
export function link(part, paths) {
  for (const [name, path] of Object.entries(paths)) {
    for (const anchor of part.querySelectorAll(`a[data-link="${name}"]`)) anchor.setAttribute("href", new URL(path, root).href);
  }
}

/** Calls once, when an element is about to be seen. @param {Element} element @param {() => void} call */
export function whenSeen(element, call) {
  const observer = new IntersectionObserver((entries) => {
    if (!entries.some((entry) => entry.isIntersecting)) return;
    observer.disconnect();
    call();
  });
  observer.observe(element);
}

/** Fills a folded box when it is opened first, or says why it cannot. @param {HTMLElement} box @param {() => Promise<void>} show */
export function whenOpened(box, show) {
  const details = /** @type {HTMLDetailsElement} */ (box.closest("details"));
  details.addEventListener("toggle", () => {
    if (details.open && !box.childElementCount) show().catch((error) => { box.textContent = error.message; });
  });
}

/** Shows a picture of the service. @param {HTMLImageElement} image @param {string} path */
export async function showPicture(image, path) {
  const address = URL.createObjectURL(await (await request(path)).blob());
  image.src = address;
  await image.decode().catch(() => undefined);
}

/** Saves a file of the service under its name. @param {string} path */
export async function download(path) {
  const answer = await request(path);
  const given = answer.headers.get("Content-Disposition") ?? "";
  const name = decodeURIComponent(/filename\*=UTF-8''([^;]+)/.exec(given)?.[1] ?? /filename="([^"]+)"/.exec(given)?.[1] ?? "download");
  const address = URL.createObjectURL(await answer.blob());
  make("a", { href: address, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(address), 60_000);
}

/** Copies the address with the view, and says so. @param {ParentNode} part */
export async function share(part) {
  await pause(250); // the view has been written into the address then
  const copied = await navigator.clipboard?.writeText(location.href).then(() => true, () => false);
  fill(part, { done: copied ? "The link is copied; it shows this view." : `The link is the address of this page: ${location.href}` });
}

/** @param {{name: string | null, measurement: string}} fit */
export const nameOf = (fit) => fit.name ?? `${fit.measurement.slice(0, 12)}…`;
/** @param {string} created */
export const dateOf = (created) => `${created.slice(0, 16).replace("T", " ")} UTC`;

/** Shows what is wrong, in place of a view. @param {unknown} error */
function showProblem(error) {
  const { title, message } = error instanceof Problem ? error : { title: "Something is wrong with this page", message: String(error) };
  const shown = template("problem", { title, detail: message });
  find(shown, "[data-act=again]").onclick = () => location.reload();
  find(document, "main").replaceChildren(shown);
}

/** Shows the view that the address names. */
export async function open() {
  const main = find(document, "main");
  const [name, id = ""] = location.pathname.slice(root.pathname.length).split("/");
  const view = { "": "list", fits: "fit", measurements: "measurement", compare: "compare" }[name];
  try {
    if (!view) throw new Problem(`There is nothing at ${location.pathname}.`, "There is no such page", 404);
    const module = await import(`./${view}.js`);
    await module.show(main, id);
  } catch (error) {
    showProblem(error);
  } finally {
    main.removeAttribute("aria-busy");
  }
}

showSignOut();
open();
