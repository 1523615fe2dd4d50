// Turning a sphere: the light, the line between measurement and fit, exposure and zoom, by pointer and keyboard; and what
// the values are at the point below the pointer.
import { find, json } from "./app.js";
import { controls, field, lightAt, LIGHTS, look, panorama, running, Sphere, USUAL } from "./sphere.js";

const GRIP = 14; // pixels from the line at which it is taken, and not the light
const STEPS = /** @type {Record<string, number[]>} */ ({ ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] });

/** Sets where the light's reflection is seen first, before the address is read. */
export function prepare() {
  const [x, y, z] = LIGHTS[0].towards;
  field("highlight").defaultValue = [x, y].map((value) => (value / Math.hypot(x, y, z + 1)).toFixed(6)).join();
}

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

/** @param {HTMLInputElement} input @param {string | number} value */
function set(input, value) {
  input.value = String(value);
  controls().dispatchEvent(new Event("input", { bubbles: true }));
}

/** @param {number[]} point */
function aim([x, y]) {
  const shrink = Math.min(1, 0.97 / Math.hypot(x, y));
  set(field("highlight"), [x * shrink, y * shrink].map((value) => value.toFixed(4)).join());
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
    if (wiping) set(field("wipe"), Math.min(Math.max(onScreen[0], -1), 1).toFixed(2));
    else aim(onScreen);
  };
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    wiping = isAtLine(event);
    follow(event);
  });
  canvas.addEventListener("pointermove", (event) => {
    if (event.buttons) return follow(event);
    canvas.style.cursor = isAtLine(event) ? "ew-resize" : "";
    clearTimeout(asked);
    asked = setTimeout(() => tell(sphere, pointOf(sphere, event).onSphere), 150);
  });
  canvas.addEventListener("pointerleave", () => { clearTimeout(asked); sphere.hint.textContent = USUAL; });
  canvas.addEventListener("keydown", (event) => {
    const exposure = field("exposure");
    if (STEPS[event.key]) aim(look().highlight.map((value, i) => value + 0.05 * STEPS[event.key][i]));
    else if (event.key === "r" || event.key === "R") reset();
    else if (event.key === "[" || event.key === "]") set(field("wipe"), (look().wipe + (event.key === "[" ? -0.05 : 0.05)).toFixed(2));
    else if ("+-=".includes(event.key)) set(exposure, Number(exposure.value) + (event.key === "-" ? -0.5 : 0.5));
    else return;
    event.preventDefault();
  });
  for (const box of sphere.boxes) box.addEventListener("change", () => sphere.draw());
}

function reset() {
  controls().reset();
  controls().dispatchEvent(new Event("change", { bubbles: true }));
}

function control() {
  const form = controls();
  const [exposure, zoom, wipe, turn] = ["exposure", "zoom", "wipe", "turn"].map(field);
  const chosen = find(form, "#panorama", HTMLInputElement);
  /** @param {HTMLInputElement} input */
  const label = (input) => /** @type {HTMLElement} */ (input.closest("label"));
  /** @param {HTMLInputElement} input @param {string} text */
  const write = (input, text) => { find(label(input), "output").textContent = text; };
  /** @param {boolean} moving */
  const change = (moving) => {
    const now = look();
    write(exposure, `${now.stops > 0 ? "+" : ""}${now.stops} EV`);
    write(zoom, `${now.zoom.toPrecision(2)}×`);
    write(turn, `${now.turn}°`);
    label(wipe).hidden = !running.some((sphere) => sphere.halves());
    label(turn).hidden = label(chosen).hidden = now.lighting !== "panorama";
    for (const sphere of running) {
      sphere.showLine();
      sphere.draw(moving);
    }
  };
  form.addEventListener("input", () => change(true));
  form.addEventListener("change", () => change(false));
  form.addEventListener("submit", (event) => event.preventDefault());
  chosen.addEventListener("change", async () => {
    try {
      panorama.pixels = await (await import("./panorama.js")).readPanorama(/** @type {FileList} */ (chosen.files)[0]);
      panorama.number += 1;
      change(false);
    } catch (error) {
      for (const sphere of running) sphere.hint.textContent = /** @type {Error} */ (error).message;
    }
  });
  find(form, "#reset-view").addEventListener("click", reset);
  find(form, "#show").hidden = !running.some(({ subject }) => subject.fit && subject.measured);
  find(form, "#own").hidden = running.length < 2;
  form.hidden = false;
  change(false);
}

/** Says the angles and values at a point of a sphere, for the light that is dragged, and whose light it is mostly. @param {Sphere} sphere @param {number[]} point */
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
  const query = `brdf?omega_in=${local(light)}&omega_out=${local([0, 0, 1])}`;
  const { fit, measured, labels } = subject;
  const paths = fit ? [`v1/fits/${fit}/${query}`, ...labels.map((label) => `v1/fits/${fit}/components/${label}/${query}`)] : [`v1/measurements/${measured}/${query}`];
  try {
    /** @type {number[][]} */
    const [whole, ...parts] = (await Promise.all(paths.map(json))).map(({ values }) => values[0]);
    const half = normal.map((_, i) => light[i] + Number(i === 2));
    /** @param {number} cosine */
    const degrees = (cosine) => ((Math.acos(Math.min(cosine, 1)) * 180) / Math.PI).toFixed(1);
    const angles = `θ_half ${degrees(dot(half, normal) / Math.hypot(...half))}°, θ_diff ${degrees(Math.hypot(...half) / 2)}°`;
    const sums = parts.map((values) => values.reduce((sum, value) => sum + value, 0));
    const most = sums.indexOf(Math.max(...sums));
    const share = Math.round((100 * sums[most]) / sums.reduce((sum, value) => sum + value, 0));
    const mostly = parts.length ? `, ${share} % ${labels[most].replace("_", " ")}` : "";
    hint.textContent = whole ? `${angles}: ${whole.map((value) => value.toPrecision(3)).join(", ")} 1/sr${mostly}` : `${angles}: not measured`;
  } catch (error) {
    hint.textContent = /** @type {Error} */ (error).message;
  }
}
