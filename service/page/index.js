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

function send(url, headers, body, onprogress) {
  return new Promise((resolve, reject) => {
    const request = new XMLHttpRequest();
    request.open("POST", url);
    request.responseType = "json";
    for (const [name, value] of Object.entries(headers)) request.setRequestHeader(name, value);
    request.upload.onprogress = onprogress;
    request.onload = () => resolve(request);
    request.onerror = () => reject(new Error("The service cannot be reached, or it broke the upload off."));
    request.send(body);
  });
}

async function submit(chosen) {
  fault.hidden = true;
  const name = chosen.name.replace(/\.binary$/, "");
  const named = name ? `name=${encodeURIComponent(name)}` : "";
  try {
    show(`Reading ${chosen.name}`);
    const hash = await sha256(chosen);
    const known = hash && (await fetch(`${root}v1/measurements/${hash}`, { method: "HEAD" })).ok;
    let answer;
    if (known) {
      show("The service has this file");
      const body = JSON.stringify({ measurement: hash, options: options() });
      answer = await send(`${root}v1/fits?${named}`, { "Content-Type": "application/json", Prefer: "respond-async" }, body);
    } else {
      show(`Sending ${chosen.name}`, 0);
      const query = new URLSearchParams(options());
      const headers = { "Content-Type": "application/octet-stream", Prefer: "respond-async" };
      answer = await send(`${root}v1/fits?${named}&${query}`, headers, chosen, (event) => {
        if (event.loaded < event.total) show(`Sending ${chosen.name}`, event.loaded / event.total);
        else show("Checking the file");
      });
    }
    if (answer.status >= 300) fail(answer.response?.detail ?? `The service answered ${answer.status}.`);
    else location.assign(`${root}fits/${answer.response.id}`);
  } catch (error) {
    fail(error.message);
  }
}

form.addEventListener("submit", (event) => event.preventDefault());
file.addEventListener("change", () => file.files.length && submit(file.files[0]));
let depth = 0;
addEventListener("dragenter", (event) => { event.preventDefault(); depth += 1; form.classList.add("over"); });
addEventListener("dragleave", () => { depth -= 1; if (depth <= 0) form.classList.remove("over"); });
addEventListener("dragover", (event) => event.preventDefault());
addEventListener("drop", (event) => {
  event.preventDefault();
  depth = 0;
  form.classList.remove("over");
  const dropped = event.dataTransfer.files;
  if (dropped.length === 1) submit(dropped[0]);
  else fail("Drop one file at a time.");
});

// Filters the list by name while one types, and lets two fits be ticked for comparison.
const search = document.getElementById("search");
if (search) {
  const cards = [...document.querySelectorAll(".card")];
  const none = document.getElementById("no-match");
  search.addEventListener("input", () => {
    const wanted = search.value.trim().toLowerCase();
    for (const card of cards) card.hidden = !card.dataset.name.toLowerCase().includes(wanted);
    none.hidden = cards.some((card) => !card.hidden);
  });
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
