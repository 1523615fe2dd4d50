// Sends files: first the SHA-256 of a file, the file itself only if the service does not have it. A table is shown before.
import { find, keyHeader, Problem, problemOf, request, root, say, sendJson } from "./app.js";
import { chosen, inJson } from "./options.js";

const TABLE = /\.(csv|tsv|txt|astm|xlsx)$/i;
/** @type {XMLHttpRequest | null} */
let sending = null;
addEventListener("beforeunload", (event) => sending && event.preventDefault());

/** Shows a table that is chosen alone; sends everything else. @param {HTMLElement} main @param {File[]} files */
export async function take(main, files) {
  const [box, options] = [find(main, "#table"), find(main, ".options")];
  say("");
  box.replaceChildren();
  const send = () => sendAll(main, files, chosen(options));
  if (files.length > 1 || !TABLE.test(files[0].name)) return send();
  const { showTable } = await import("./table.js");
  return showTable(box, files[0], options, { fit: send });
}

/** Shows how far an upload is, or that there is none. @param {HTMLElement} main @param {string} text @param {number} [share] */
function tell(main, text, share) {
  find(main, ".drop-main").hidden = Boolean(text);
  find(main, "#sending").hidden = !text;
  find(main, "#sending-title").textContent = text;
  const bar = find(main, "#sending-bar", HTMLProgressElement);
  if (share === undefined) bar.removeAttribute("value");
  else bar.value = share;
}

/** Sends files one after the other and leads to the fit, or to the list of several; one with a fault holds up no other. @param {HTMLElement} main @param {File[]} files @param {[string, string][]} options */
export async function sendAll(main, files, options) {
  const fits = [];
  const faults = [];
  find(main, "#cancel-upload").onclick = () => sending?.abort();
  for (const file of files) {
    try {
      fits.push((await submit(main, file, options)).id);
    } catch (error) {
      const { message } = /** @type {Error} */ (error);
      faults.push(files.length > 1 ? `${file.name}: ${message}` : message);
    }
  }
  if (!faults.length) return location.assign(new URL(files.length > 1 ? "." : `fits/${fits[0]}`, root));
  tell(main, "");
  find(main, "#file", HTMLInputElement).value = "";
  return say([...faults, ...(fits.length ? [`Sent: ${fits.length} of ${files.length}.`] : [])].join(" "), true);
}

/** @param {HTMLElement} main @param {File} file @param {[string, string][]} options @returns {Promise<Fit>} */
async function submit(main, file, options) {
  tell(main, `Reading ${file.name}`);
  const hash = await sha256(file);
  const isKnown = hash && await request(`v1/measurements/${hash}`, { method: "HEAD" }).then(() => true, (error) => {
    if (error.status === 404) return false;
    throw error;
  });
  if (isKnown) {
    tell(main, "The service has this file");
    const name = new URLSearchParams({ name: file.name.replace(/(?<=.)\.\w+$/, "") });
    return sendJson(`v1/fits?${name}`, "POST", { measurement: hash, options: inJson(options) });
  }
  tell(main, `Sending ${file.name}`, 0);
  const query = new URLSearchParams([["name", file.name.replace(/\.binary$/, "") || file.name], ...options]);
  return send(`v1/fits?${query}`, file, ({ loaded, total }) => {
    if (loaded < total) tell(main, `Sending ${file.name}`, loaded / total);
    else tell(main, "Checking the file");
  });
}

/** @param {File} file */
async function sha256(file) {
  if (!globalThis.crypto?.subtle) return null; // browsers hash on https and localhost only
  const digest = new Uint8Array(await crypto.subtle.digest("SHA-256", await file.arrayBuffer()));
  return Array.from(digest, (byte) => byte.toString(16).padStart(2, "0")).join("");
}

/** Sends a file, with a word about its progress, which `fetch` does not give. @param {string} path @param {File} file @param {(event: ProgressEvent) => void} onprogress @returns {Promise<Fit>} */
function send(path, file, onprogress) {
  const upload = sending = new XMLHttpRequest();
  upload.open("POST", new URL(path, root));
  upload.responseType = "json";
  const headers = { ...keyHeader(), "Content-Type": "application/octet-stream", Prefer: "respond-async" };
  for (const [name, value] of Object.entries(headers)) upload.setRequestHeader(name, value);
  upload.upload.onprogress = onprogress;
  return new Promise((resolve, reject) => {
    upload.onabort = () => reject(new Problem("The upload was cancelled."));
    upload.onerror = () => reject(new Problem("The service cannot be reached, or it has ended the upload."));
    upload.onload = () => (upload.status < 300 ? resolve(upload.response) : reject(problemOf(upload.response, upload.status)));
    upload.onloadend = () => { sending = null; };
    upload.send(file);
  });
}
