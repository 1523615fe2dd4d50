// Turning a sphere: the light, the line between measurement and fit, exposure and zoom, by pointer and keyboard; and what
// the values are at the point below the pointer.
import { find, json, say } from "./app.js";
import { controls, field, lightAt, look, panorama, running, Sphere, USUAL } from "./sphere.js";

const GRIP = 14; // pixels from the line at which it is taken, and not the light
const STEPS = /** @type {Record<string, number[]>} */ ({ ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] });

/**
 * Starts spheres, which share the light; where there is no WebGL 2, `instead` shows what there is.
 * @param {Sphere[]} spheres @param {(sphere: Sphere) => Promise<unknown>} instead @returns {Promise<boolean>} whether all are there
 */
export async function startSpheres(spheres, instead) {
  const started = await Promise.all(spheres.map((sphere) => sphere.start().then(() => true, async (error) => {
    sphere.hint.textContent = error.message;
    find(sphere.figure, ".toggles").hidden = true;
    await instead(sphere);
    return false;
  })));
  running.push(...spheres.filter((_, i) => started[i]));
  for (const sphere of running) listen(sphere);
  if (running.length) control();
  return started.every(Boolean);
}

/** @param {string} name @param {string} value */
function set(name, value) {
  field(name).value = value;
  controls().dispatchEvent(new Event("input", { bubbles: true }));
}

/** @param {number[]} point */
function aim([x, y]) {
  const shrink = Math.min(1, 0.97 / Math.hypot(x, y));
  set("highlight", [x * shrink, y * shrink].map((value) => value.toFixed(4)).join());
}

/** The points of the sphere and of its picture below a pointer. @param {Sphere} sphere @param {PointerEvent} event */
function pointOf({ canvas }, event) {
  const box = canvas.getBoundingClientRect();
  const onScreen = [((event.clientX - box.left) / box.width) * 2 - 1, 1 - ((event.clientY - box.top) / box.height) * 2];
  const { highlight, zoom } = look();
  return { box, onScreen, onSphere: onScreen.map((value, i) => highlight[i] + (value - highlight[i]) / zoom) };
}

/** @param {Sphere} sphere */
function listen(sphere) {
  const { canvas } = sphere;
  let asked = 0;
  let wiping = false;
  /** @param {PointerEvent} event */
  const isAtLine = (event) => {
    const { box, onScreen } = pointOf(sphere, event);
    return sphere.halves() && Math.abs(onScreen[0] - look().wipe) * box.width < 2 * GRIP;
  };
  /** @param {PointerEvent} event */
  const follow = (event) => {
    const { onScreen } = pointOf(sphere, event);
    if (wiping) set("wipe", Math.min(Math.max(onScreen[0], -1), 1).toFixed(2));
    else aim(onScreen);
  };
  canvas.onpointerdown = (event) => {
    canvas.setPointerCapture(event.pointerId);
    wiping = isAtLine(event);
    follow(event);
  };
  canvas.onpointermove = (event) => {
    if (event.buttons) return follow(event);
    canvas.style.cursor = isAtLine(event) ? "ew-resize" : "";
    clearTimeout(asked);
    asked = setTimeout(() => tell(sphere, pointOf(sphere, event).onSphere), 150);
    return undefined;
  };
  canvas.onpointerleave = () => { clearTimeout(asked); sphere.hint.textContent = USUAL; };
  canvas.onkeydown = (event) => {
    const { stops, wipe, highlight } = look();
    const key = event.key.toLowerCase();
    if (STEPS[event.key]) aim(highlight.map((value, i) => value + 0.05 * STEPS[event.key][i]));
    else if (key === "r") reset();
    else if (key === "[" || key === "]") set("wipe", (wipe + (key === "[" ? -0.05 : 0.05)).toFixed(2));
    else if ("+-=".includes(key)) set("exposure", String(stops + (key === "-" ? -0.5 : 0.5)));
    else return;
    event.preventDefault();
  };
  for (const box of sphere.boxes) box.onchange = () => sphere.draw();
}

function reset() {
  controls().reset();
  controls().dispatchEvent(new Event("change", { bubbles: true }));
}

function control() {
  const form = controls();
  const chosen = find(form, "#panorama", HTMLInputElement);
  /** @param {HTMLInputElement} input */
  const label = (input) => /** @type {HTMLElement} */ (input.closest("label"));
  /** @param {string} name @param {string} text */
  const write = (name, text) => { find(label(field(name)), "output").textContent = text; };
  /** @param {boolean} moving */
  const change = (moving) => {
    const { stops, zoom, turn, lighting } = look();
    write("exposure", `${stops > 0 ? "+" : ""}${stops} EV`);
    write("zoom", `${zoom.toPrecision(2)}×`);
    write("turn", `${turn}°`);
    label(field("wipe")).hidden = !running.some((sphere) => sphere.halves());
    label(field("turn")).hidden = label(chosen).hidden = lighting !== "panorama";
    for (const sphere of running) {
      sphere.showLine();
      sphere.draw(moving);
    }
  };
  form.oninput = () => change(true);
  form.onchange = () => change(false);
  form.onsubmit = (event) => event.preventDefault();
  chosen.onchange = async () => {
    try {
      panorama.pixels = await (await import("./panorama.js")).readPanorama(/** @type {FileList} */ (chosen.files)[0]);
      panorama.number += 1;
      change(false);
    } catch (error) {
      say(/** @type {Error} */ (error).message, true);
    }
  };
  find(form, "#reset-view").onclick = reset;
  find(form, "#show").hidden = !running.some(({ subject }) => subject.fit && subject.measured);
  find(form, "#own").hidden = running.length < 2;
  form.hidden = false;
  change(false);
}

/** Says the angles and values at a point of a sphere, for the light that is dragged. @param {Sphere} sphere @param {number[]} point */
async function tell({ subject, hint }, [x, y]) {
  const light = lightAt(look().highlight);
  const normal = [x, y, Math.sqrt(1 - x * x - y * y)];
  /** @param {number[]} a @param {number[]} b */
  const dot = (a, b) => a.reduce((sum, value, i) => sum + value * b[i], 0);
  if (!(normal[2] > 0 && dot(normal, light) > 0)) { hint.textContent = "The light does not reach this point."; return; }
  const flat = Math.hypot(normal[0], normal[2]);
  const along = [normal[2] / flat, 0, -normal[0] / flat];
  const aside = [normal[1] * along[2], normal[2] * along[0] - normal[0] * along[2], -normal[1] * along[0]];
  /** @param {number[]} vector */
  const local = (vector) => [along, aside, normal].map((axis) => dot(axis, vector).toFixed(6)).join();
  const { fit, measured } = subject;
  const { values: [value] } = await json(`v1/${fit ? `fits/${fit}` : `measurements/${measured}`}/brdf?omega_in=${local(light)}&omega_out=${local([0, 0, 1])}`);
  const half = normal.map((_, i) => light[i] + Number(i === 2));
  /** @param {number} cosine */
  const degrees = (cosine) => ((Math.acos(Math.min(cosine, 1)) * 180) / Math.PI).toFixed(1);
  const angles = `θ_half ${degrees(dot(half, normal) / Math.hypot(...half))}°, θ_diff ${degrees(Math.hypot(...half) / 2)}°`;
  hint.textContent = `${angles}: ${value ? `${value.map((/** @type {number} */ one) => one.toPrecision(3)).join(", ")} 1/sr` : "not measured"}`;
}
