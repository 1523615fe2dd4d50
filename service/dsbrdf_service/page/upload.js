// Sends files: first the SHA-256 of a file, the file itself only if the service does not have it.
import { find, keyHeader, Problem, request, root } from "./app.js";
import { chosen, inJson } from "./options.js";

const SUFFIXES = /\.(binary|bsdf|csv|tsv|txt|astm|xlsx)$/i;
/** @type {XMLHttpRequest | null} */
let sending = null;
addEventListener("beforeunload", (event) => sending && event.preventDefault());

/** @param {string} text @param {number} [share] */
function show(text, share) {
  find(document, ".drop-main").hidden = true;
  find(document, "#sending").hidden = false;
  find(document, "#sending-title").textContent = text;
  const bar = find(document, "#sending-bar", HTMLProgressElement);
  if (share === undefined) bar.removeAttribute("value");
  else bar.value = share;
}

/** @param {string} text */
export function fail(text) {
  find(document, ".drop-main").hidden = false;
  find(document, "#sending").hidden = true;
  const fault = find(document, "#upload-fault");
  fault.hidden = false;
  fault.textContent = text;
  find(document, "#file", HTMLInputElement).value = "";
}

/** @param {File} file */
async function sha256(file) {
  if (!globalThis.crypto?.subtle) return null; // browsers hash on https and localhost only
  const digest = new Uint8Array(await crypto.subtle.digest("SHA-256", await file.arrayBuffer()));
  return Array.from(digest, (byte) => byte.toString(16).padStart(2, "0")).join("");
}

/**
 * Sends a body, with a word about its progress, which `fetch` does not give.
 * @param {string} path @param {Record<string, string>} headers @param {File | string} body
 * @param {(event: ProgressEvent) => void} [onprogress] @returns {Promise<string>} the id of the fit
 */
function send(path, headers, body, onprogress) {
  return new Promise((resolve, reject) => {
    const upload = new XMLHttpRequest();
    const end = (/** @type {string} */ text) => () => { sending = null; reject(new Problem(text)); };
    upload.open("POST", new URL(path, root));
    upload.responseType = "json";
    sending = upload;
    for (const [name, value] of Object.entries({ ...headers, ...keyHeader(), Prefer: "respond-async" })) upload.setRequestHeader(name, value);
    upload.upload.onprogress = onprogress ?? null;
    upload.onabort = end("The upload was cancelled.");
    upload.onerror = end("The service cannot be reached, or it broke the upload off.");
    upload.onload = () => {
      sending = null;
      if (upload.status < 300) resolve(upload.response.id);
      else reject(new Problem(upload.response?.detail ?? `The service answered ${upload.status}.`));
    };
    upload.send(body);
  });
}

/** Whether the service has a file; asks for a key where one is needed. @param {string} hash */
async function isKnown(hash) {
  try {
    return (await request(`v1/measurements/${hash}`, { method: "HEAD" })).ok;
  } catch (error) {
    if (error instanceof Problem && error.status === 404) return false;
    throw error;
  }
}

/** @param {File} file @param {[string, string][]} options @returns {Promise<string>} the id of its fit */
async function submit(file, options) {
  show(`Reading ${file.name}`);
  const hash = await sha256(file);
  if (hash && await isKnown(hash)) {
    show("The service has this file");
    const name = new URLSearchParams({ name: file.name.replace(SUFFIXES, "") || file.name });
    return send(`v1/fits?${name}`, { "Content-Type": "application/json" }, JSON.stringify({ measurement: hash, options: inJson(options) }));
  }
  show(`Sending ${file.name}`, 0);
  const query = new URLSearchParams([["name", file.name.replace(/\.binary$/, "") || file.name], ...options]);
  return send(`v1/fits?${query}`, { "Content-Type": "application/octet-stream" }, file, (event) => {
    if (event.loaded < event.total) show(`Sending ${file.name}`, event.loaded / event.total);
    else show("Checking the file");
  });
}

/**
 * Sends files one after the other and leads to the fit, or to the list of several; one with a fault holds up no other.
 * @param {File[]} files
 */
export async function submitAll(files) {
  const options = chosen(find(document, ".options"));
  find(document, "#upload-fault").hidden = true;
  find(document, "#cancel-upload").onclick = () => sending?.abort();
  const fits = [];
  const faults = [];
  for (const file of files) {
    try {
      fits.push(await submit(file, options));
    } catch (error) {
      const { message } = /** @type {Error} */ (error);
      faults.push(files.length > 1 ? `${file.name}: ${message}` : message);
    }
  }
  if (faults.length) fail([...faults, ...(fits.length ? [`Sent: ${fits.length} of ${files.length}.`] : [])].join(" "));
  else location.assign(files.length > 1 ? root : new URL(`fits/${fits[0]}`, root));
}
