// Handles pointer and keyboard on a sphere: the light, the line between measurement and fit, exposure and zoom; and shows
// the values at the point below the pointer.
import { find, showPicture } from "./app.js";
import { controls, lightAt, look, panorama, running, Sphere, USUAL } from "./sphere.js";

const MAX_GRIP_DISTANCE_PX = 14; // A pointer closer to the line between measurement and fit drags the line, otherwise the light.
const STEPS = /** @type {Record<string, number[]>} */ ({ ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] });

/** Starts spheres under one light; without WebGL 2, the service draws them. @param {Sphere[]} spheres */
export async function startSpheres(spheres) {
  await Promise.all(spheres.map((sphere) => sphere.start().then(() => running.push(sphere), async (error) => {
    sphere.hint.textContent = error.message;
    find(sphere.figure, ".toggles").hidden = true;
    await showPicture(find(sphere.figure, ".fallback", HTMLImageElement), `${sphere.path}/figures/sphere.png?size=256`).catch(() => undefined);
  })));
  for (const sphere of running) listen(sphere);
  if (running.length) control();
}

/** @param {string} name @param {string} value */
function set(name, value) {
  find(controls(), `[name=${name}]`, HTMLInputElement).value = value;
  controls().dispatchEvent(new Event("input", { bubbles: true }));
}

/** @param {number[]} point */
function aim([x, y]) {
  const shrink = Math.min(1, 0.97 / Math.hypot(x, y));
  set("highlight", [x * shrink, y * shrink].map((value) => value.toFixed(4)).join());
}

/** @param {Sphere} sphere */
function listen(sphere) {
  const { canvas, hint } = sphere;
  let asked = 0;
  let wiping = false;
  /** Returns the point of the picture below a pointer, from -1 to 1, and whether the line is there. @param {PointerEvent} event */
  const at = ({ clientX, clientY }) => {
    const { left, top, width, height } = canvas.getBoundingClientRect();
    const x = ((clientX - left) / width) * 2 - 1;
    return { point: [x, 1 - ((clientY - top) / height) * 2], isLine: sphere.hasBoth && look().show === "half" && Math.abs(x - look().wipe) * width < 2 * MAX_GRIP_DISTANCE_PX };
  };
  /** @param {PointerEvent} event */
  const follow = (event) => {
    const { point } = at(event);
    if (wiping) set("wipe", Math.min(Math.max(point[0], -1), 1).toFixed(2));
    else aim(point);
  };
  canvas.onpointerdown = (event) => {
    canvas.setPointerCapture(event.pointerId);
    wiping = at(event).isLine;
    follow(event);
  };
  canvas.onpointermove = (event) => {
    if (event.buttons) return follow(event);
    const { point, isLine } = at(event);
    canvas.style.cursor = isLine ? "ew-resize" : "";
    clearTimeout(asked);
    asked = setTimeout(async () => {
      const { highlight, zoom } = look();
      const onSphere = point.map((value, i) => highlight[i] + (value - highlight[i]) / zoom);
      hint.textContent = await (await import("./values.js")).valuesBelow(sphere.subject, onSphere, lightAt(highlight));
    }, 150);
    return undefined;
  };
  canvas.onpointerleave = () => {
    clearTimeout(asked);
    hint.textContent = USUAL;
  };
  canvas.onkeydown = (event) => {
    const { stops, wipe, highlight } = look();
    const key = event.key.toLowerCase();
    if (STEPS[event.key]) aim(highlight.map((value, i) => value + 0.05 * STEPS[event.key][i]));
    else if (key === "r") controls().reset();
    else if (key === "[" || key === "]") set("wipe", (wipe + (key === "[" ? -0.05 : 0.05)).toFixed(2));
    else if ("+-=".includes(key)) set("exposure", String(stops + (key === "-" ? -0.5 : 0.5)));
    else return;
    event.preventDefault();
  };
  for (const box of sphere.boxes) box.onchange = () => { // Two spheres always show the same components.
    for (const same of running.flatMap((other) => other.boxes)) if (same.value === box.value) same.checked = box.checked;
    for (const other of running) other.draw();
  };
}

function control() {
  const form = controls();
  const own = find(form, "#panorama", HTMLInputElement);
  const hasBoth = running.some((sphere) => sphere.hasBoth);
  /** @param {string} name @param {string} text */
  const write = (name, text) => { find(form, `[name=${name}] + output`).textContent = text; };
  /** @param {boolean} moving */
  const change = (moving) => {
    const { stops, zoom, show, lighting } = look();
    write("exposure", `${stops > 0 ? "+" : ""}${stops} EV`);
    write("zoom", `${zoom.toPrecision(2)}×`);
    find(form, ".wipe").hidden = show !== "half" || !hasBoth;
    find(form, ".panorama").hidden = lighting !== "environment";
    if (!own.value) panorama.file = null;
    for (const sphere of running) sphere.draw(moving);
  };
  form.oninput = () => change(true);
  form.onchange = () => change(false);
  own.oninput = (event) => event.stopPropagation(); // Spheres are drawn after the file has been read.
  own.onchange = async (event) => {
    event.stopPropagation();
    const { readPanorama } = await import("./panorama.js");
    panorama.file = (own.files?.length && await readPanorama(own.files[0])) || null;
    panorama.number += 1;
    if (!panorama.file) own.value = "";
    change(false);
  };
  form.onsubmit = (event) => event.preventDefault();
  form.onreset = () => setTimeout(() => form.dispatchEvent(new Event("change", { bubbles: true }))); // The event must follow the reset of the fields.
  find(form, "#show").hidden = !hasBoth;
  form.hidden = false;
  change(false);
}
