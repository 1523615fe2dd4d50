// The page of all fits. A dropped or chosen file: its SHA-256 is sent first, the file itself only if the service does not
// have it.
const root = document.documentElement.dataset.root;
const form = document.getElementById("upload");
const file = document.getElementById("file");
const bar = document.getElementById("sending-bar");
const title = document.getElementById("sending-title");
const fault = document.getElementById("upload-fault");

function show(text, share) {
  form.querySelector(".drop-main").hidden = true;
  document.getElementById("sending").hidden = false;
  title.textContent = text;
  if (share === undefined) bar.removeAttribute("value");
  else bar.value = share;
}

function fail(text) {
  form.querySelector(".drop-main").hidden = false;
  document.getElementById("sending").hidden = true;
  fault.hidden = false;
  fault.textContent = text;
  file.value = "";
}

async function sha256(chosen) {
  if (!globalThis.crypto?.subtle) return null; // browsers hash on https and localhost only
  const digest = new Uint8Array(await crypto.subtle.digest("SHA-256", await chosen.arrayBuffer()));
  return Array.from(digest, (byte) => byte.toString(16).padStart(2, "0")).join("");
}

function options() {
  const given = {};
  for (const [name, value] of new FormData(form)) if (typeof value === "string") given[name] = value;
  if (given.n_lobes !== "auto") given.n_lobes = Number(given.n_lobes);
  return given;
}

let sending = null;
addEventListener("beforeunload", (event) => sending && event.preventDefault());
document.getElementById("cancel-upload").addEventListener("click", () => sending?.abort());

function send(url, headers, body, onprogress) {
  return new Promise((resolve, reject) => {
    const request = new XMLHttpRequest();
    request.open("POST", url);
    request.responseType = "json";
    sending = request;
    request.onabort = () => { sending = null; reject(new Error("The upload was cancelled.")); };
    for (const [name, value] of Object.entries(headers)) request.setRequestHeader(name, value);
    request.upload.onprogress = onprogress;
    request.onload = () => { sending = null; resolve(request); };
    request.onerror = () => { sending = null; reject(new Error("The service cannot be reached, or it broke the upload off.")); };
    request.send(body);
  });
}

// Sends a file; returns the id of its fit.
async function submit(chosen) {
  const named = (suffixes) => `name=${encodeURIComponent(chosen.name.replace(suffixes, "") || chosen.name)}`;
  show(`Reading ${chosen.name}`);
  const hash = await sha256(chosen);
  const known = hash && (await fetch(`${root}v1/measurements/${hash}`, { method: "HEAD" })).ok;
  let answer;
  if (known) {
    show("The service has this file");
    const body = JSON.stringify({ measurement: hash, options: options() });
    answer = await send(`${root}v1/fits?${named(/\.(binary|bsdf|csv|tsv|txt)$/i)}`, { "Content-Type": "application/json", Prefer: "respond-async" }, body);
  } else {
    show(`Sending ${chosen.name}`, 0);
    const query = new URLSearchParams(options());
    const headers = { "Content-Type": "application/octet-stream", Prefer: "respond-async" };
    answer = await send(`${root}v1/fits?${named(/\.binary$/)}&${query}`, headers, chosen, (event) => {
      if (event.loaded < event.total) show(`Sending ${chosen.name}`, event.loaded / event.total);
      else show("Checking the file");
    });
  }
  if (answer.status >= 300) throw new Error(answer.response?.detail ?? `The service answered ${answer.status}.`);
  return answer.response.id;
}

// Sends files one after the other and leads to the fit, or to the list of several; files with a fault hold up no other.
async function submitAll(files) {
  fault.hidden = true;
  const fits = [];
  const faults = [];
  for (const chosen of files) {
    try {
      fits.push(await submit(chosen));
    } catch (error) {
      faults.push(files.length > 1 ? `${chosen.name}: ${error.message}` : error.message);
    }
  }
  if (faults.length) fail([...faults, ...(fits.length ? [`Sent: ${fits.length} of ${files.length}.`] : [])].join(" "));
  else location.assign(files.length > 1 ? root : `${root}fits/${fits[0]}`);
}

form.addEventListener("submit", (event) => event.preventDefault());
file.addEventListener("change", () => file.files.length && submitAll([...file.files]));
let depth = 0;
addEventListener("dragenter", (event) => { event.preventDefault(); depth += 1; form.classList.add("over"); });
addEventListener("dragleave", () => { depth -= 1; if (depth <= 0) form.classList.remove("over"); });
addEventListener("dragover", (event) => event.preventDefault());
addEventListener("drop", (event) => {
  event.preventDefault();
  depth = 0;
  form.classList.remove("over");
  if (event.dataTransfer.files.length && !form.querySelector(".drop-main").hidden) submitAll([...event.dataTransfer.files]);
});

// Filters the list by name while one types, and lets two fits be ticked for comparison.
const search = document.getElementById("search");
if (search) {
  const cards = [...document.querySelectorAll(".card")];
  const none = document.getElementById("no-match");
  search.addEventListener("input", () => {
    const wanted = search.value.trim().toLowerCase();
    for (const card of cards) card.hidden = !card.dataset.name.toLowerCase().includes(wanted);
    document.getElementById("wanted").textContent = search.value.trim();
    none.hidden = cards.some((card) => !card.hidden);
  });
  const orders = {
    newest: () => 0,
    name: (a, b) => a.dataset.name.localeCompare(b.dataset.name),
    error: (a, b) => a.dataset.error - b.dataset.error,
  };
  const sort = document.getElementById("sort");
  sort.value = "newest"; // a browser keeps what was chosen before
  sort.addEventListener("change", () => document.querySelector(".cards").append(...[...cards].sort(orders[sort.value])));
  for (const button of document.querySelectorAll(".delete")) {
    button.addEventListener("click", async () => {
      const card = button.closest(".card");
      if (!confirm(`Delete this fit of ${card.dataset.name}? Its measurement stays.`)) return;
      const answer = await fetch(`${root}v1/fits/${button.dataset.fit}?only=delete`, { method: "DELETE" });
      if (answer.ok) location.reload();
      else fail((await answer.json()).detail);
    });
  }
  const boxes = [...document.querySelectorAll('input[name="fit"]')];
  const button = document.getElementById("compare-button");
  const update = () => {
    const ticked = boxes.filter((box) => box.checked).length;
    button.disabled = ticked !== 2;
    for (const box of boxes) box.disabled = ticked === 2 && !box.checked;
  };
  for (const box of boxes) box.addEventListener("change", update);
  update();
}
