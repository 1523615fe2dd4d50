// Sends files: first the SHA-256 of a file, and the file itself only if the service does not have it. A table is shown first.
import { find, progressOf, request, root, say, sizeOf } from "./app.js";
import { chosen, fitStored } from "./options.js";

const TABLE = /\.(csv|tsv|txt|astm|xlsx|ods|xls)$/i;
/** @type {AbortController | null} */
let sending = null;
addEventListener("beforeunload", (event) => sending && event.preventDefault());

/** Shows a single table, and sends all other files. @param {HTMLElement} main @param {File[]} files */
export async function take(main, files) {
  const [box, options] = [find(main, "#table"), find(main, ".options")];
  say("");
  box.replaceChildren();
  const send = () => sendAll(main, files, options);
  if (files.length > 1 || !TABLE.test(files[0].name)) return send();
  const { showTable } = await import("./table.js");
  return showTable(box, files[0], options, { fit: send });
}

/** Shows the progress of a file, or the drop area again. @param {HTMLElement} main @param {string} text */
function tell(main, text) {
  find(main, ".drop-main").hidden = Boolean(text);
  find(main, "#sending").hidden = !text;
  find(main, "#sending-title").textContent = text;
}

/** Sends files in turn, then opens the fit, or the list for several files; a faulty file does not stop the others. @param {HTMLElement} main @param {File[]} files @param {HTMLElement} options the form */
export async function sendAll(main, files, options) {
  const fits = [];
  const faults = [];
  for (const file of files) {
    const { signal } = sending = new AbortController();
    find(main, "#cancel-upload").onclick = () => sending?.abort();
    try {
      fits.push((await submit(main, file, options, signal)).id);
    } catch (error) {
      const { message } = /** @type {Error} */ (error);
      faults.push(files.length > 1 ? `${file.name}: ${message}` : message);
    }
  }
  sending = null;
  if (!faults.length) return location.assign(new URL(files.length > 1 ? "." : `fits/${fits[0]}`, root));
  tell(main, "");
  find(main, "#file", HTMLInputElement).value = "";
  return say([...faults, ...(fits.length ? [`Sent: ${fits.length} of ${files.length}.`] : [])].join(" "), true);
}

/** @param {HTMLElement} main @param {File} file @param {HTMLElement} options the form @param {AbortSignal} signal @returns {Promise<Fit>} */
async function submit(main, file, options, signal) {
  tell(main, `Reading ${file.name}`);
  const bar = find(main, "progress", HTMLProgressElement);
  bar.removeAttribute("value");
  const measurement = await sha256(file);
  const known = measurement && await fitStored(file.name.replace(/(?<=.)\.\w+$/, ""), measurement, chosen(options, "[name]:not(.of-table)")).catch((error) => {
    if (error.status !== 404) throw error;
  });
  if (known) return known;
  const words = progressOf(`Sending ${file.name}, ${sizeOf(file)}`);
  tell(main, words(0));
  const query = new URLSearchParams([["name", file.name.replace(/\.binary$/, "") || file.name], ...chosen(options)]);
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
  signal?.addEventListener("abort", () => sent.abort());
  sent.send(/** @type {File} */ (body));
});

/** @param {File} file */
async function sha256(file) {
  if (!globalThis.crypto?.subtle) return null; // Browsers hash only on https and localhost.
  const digest = new Uint8Array(await crypto.subtle.digest("SHA-256", await file.arrayBuffer()));
  return Array.from(digest, (byte) => byte.toString(16).padStart(2, "0")).join("");
}
