// Draws lit spheres of a fit, of its measurement, or of both, under a light that pointer and keyboard move; shows the
// values at the point below the pointer. The form of controls applies to all spheres of a view.
import { askArray, find, LABELS, make, request, showPicture, words } from "./app.js";
import { exposureOf, finished, MEASURED, programOf, setTexture } from "./shader.js";

const SHOWN = ["fit", "measured", "half", "difference"];
const ENVIRONMENT_PICTURE_PX = 256; // Size of pictures under environment light.
const EXPOSURE_PICTURE_PX = 64; // Size of the pictures that determine the exposure.
const FIRST_PICTURE_PX = 128; // Size of the first picture, and minimum size of later pictures.
const MAX_MOVING_PICTURE_MS = 50; // During a movement, a slower picture gets fewer pixels.
const MAX_SILENT_PICTURE_MS = 200; // A slower picture is announced as "Drawing…".
const KEYS = "Keys: arrows move the light, + and − change the exposure, [ and ] move the line between halves, R resets.";
// Key light from the upper left, fill light from the right, rim light from behind: as `lighting=three_lights`. The form's
// `highlight` is the point of the sphere that reflects the first light to the viewer.
const LIGHTS = [[40, 125, 1], [80, -20, 0.5], [140, 70, 0.5]].map(([polar, azimuth, share]) => {
  const [away, round] = [polar, azimuth].map((degrees) => (degrees * Math.PI) / 180);
  return { towards: [Math.sin(away) * Math.cos(round), Math.sin(away) * Math.sin(round), Math.cos(away)], irradiance: share * Math.PI };
});

/** All spheres of the view. @type {Sphere[]} */
export const running = [];
/** The user's panorama as a .npy file in place of the environment, and a count of choices. */
export const panorama = { file: /** @type {Blob | null} */ (null), number: 0 };

export const controls = () => find(document, "#controls", HTMLFormElement);

/** Returns the state of the form; the highlight is the point of the light's reflection on the sphere. @returns {Look} */
export function look() {
  const given = Object.fromEntries(new FormData(controls()));
  const [show, lighting] = [String(given.show), String(given.lighting)];
  const [x, y] = String(given.highlight).split(",").map(Number);
  const numbers = { stops: Number(given.exposure), zoom: 2 ** Number(given.zoom), wipe: Number(given.wipe) };
  return { show, lighting, ...numbers, highlight: Math.hypot(x, y) <= 1 ? [x, y] : [0, 0] };
}

/** Waits until the page is painted: without a graphics card, compilation and drawing block the page. */
const seenByNow = () => new Promise((resolve) => { requestAnimationFrame(() => requestAnimationFrame(resolve)); });

/** Says what a pointer does. */
const usual = () => (look().lighting === "environment" ? "Drag to replace the sky by lights that you move." : `Drag to move the light.${matchMedia("(hover: hover)").matches ? " Point at the sphere to read values." : ""}`);

/** @param {number[]} highlight */
function lightAt([a, b]) {
  const c = Math.sqrt(Math.max(1 - a * a - b * b, 0));
  return [2 * c * a, 2 * c * b, 2 * c * c - 1];
}

export class Sphere {
  /** @param {HTMLElement} figure @param {Subject} subject @param {Promise<string | undefined>} [source] GLSL of the fit that is on its way */
  constructor(figure, subject, source) {
    this.figure = figure;
    this.subject = subject;
    this.source = source;
    this.path = subject.fit ? `v1/fits/${subject.fit}` : `v1/measurements/${subject.measured}`;
    this.hasBoth = Boolean(subject.fit && subject.measured);
    this.canvas = find(figure, "canvas", HTMLCanvasElement);
    this.gl = /** @type {WebGL2RenderingContext} */ (this.canvas.getContext("webgl2", { antialias: false, preserveDrawingBuffer: true }));
    this.hint = find(figure, ".hint");
    this.stage = find(figure, ".stage");
    /** Programs and data of pictures, by name. @type {Map<string, Promise<any>>} */
    this.loaded = new Map();
    this.cost = 0; // Measured time of a picture of all pixels [ms].
    /** The content of the textures, and its exposure. */
    this.seen = { key: "", exposure: Infinity, pictures: /** @type {Float32Array[]} */ ([]) };
    this.turns = this.rest = 0;
    this.painted = Promise.resolve();
    this.onpaint = () => {};
    this.canvas.setAttribute("aria-label", `Lit sphere of ${subject.name}. ${KEYS}`);
    this.canvas.title = KEYS;
    /** The checkboxes of the components, if there are several. */
    this.boxes = subject.parts.length < 2 ? [] : subject.parts.map(({ label }) => make("input", { type: "checkbox", name: `${subject.fit?.slice(0, 6)}-${label}`, value: label, defaultChecked: true }));
    for (const box of this.boxes) box.setAttribute("form", "controls");
    const toggles = find(figure, ".toggles");
    toggles.hidden = !this.boxes.length;
    toggles.append(...this.boxes.map((box) => make("label", { className: `c-part-${LABELS.indexOf(box.value)}` }, box, ` ${words(box.value)}`)));
  }

  async start() { // This throws without WebGL 2.
    if (!["EXT_color_buffer_float", "EXT_color_buffer_half_float"].some((name) => this.gl?.getExtension(name))) throw new Error("This browser has no WebGL 2 that draws on textures. The service draws the sphere, and its light cannot be moved.");
    for (const unit of [0, 1, 2]) setTexture(this.gl, unit, [1, 1, 1], new Uint16Array(3));
    await this.lookAround(look(), null);
    this.canvas.hidden = false;
    new ResizeObserver(() => this.draw()).observe(this.canvas);
  }

  /** Requests data of a picture once, and again after a failure. @param {string} name @param {boolean} [quietly] */
  load(name, quietly = false) {
    if (!this.loaded.has(name)) {
      if (!quietly) this.work(name === "measured" ? "Loading the measurement, 9 MB…" : "Preparing the sphere…");
      const asked = this.fetch(name);
      this.loaded.set(name, asked);
      asked.catch(() => this.loaded.delete(name));
    }
    return this.loaded.get(name);
  }

  /** Shows the current work on the sphere; an empty text hides it. @param {string} [text] */
  work(text = "") {
    this.stage.ariaBusy = String(Boolean(text));
    find(this.stage, ".work").textContent = text;
  }

  // Names are "glsl" for a program that lights the whole fit, "parts" for one with weights of components, "measured" for one
  // with the table of the measurement, "pictures" for the program that shows pictures, and for example "environment/fit"
  // or "panorama 1/fit" for radiance under a lighting.
  /** @param {string} name @returns {Promise<any>} */
  async fetch(name) {
    const { subject: { fit, measured, parts }, gl } = this;
    if (name === "measured") {
      setTexture(gl, 0, [180, 90, 90], await askArray(`v1/measurements/${measured}/table.npy`));
      return programOf(gl, MEASURED, "measured(a, b)");
    }
    await seenByNow();
    if (name === "pictures") return programOf(gl);
    if (name === "glsl" || name === "parts") {
      const part = name === "parts" ? `&component=${parts[0].label}` : "";
      const source = (!part && await this.source) || await (await request(`v1/fits/${fit}/export?format=glsl${part}`)).text();
      return programOf(gl, source, part ? "dsbrdf_shown(a, b, shown)" : "dsbrdf(a, b)");
    }
    const [lighting, what] = name.split("/");
    const path = `v1/${what === "measured" ? `measurements/${measured}` : `fits/${fit}`}/figures/sphere.npy?size=${lighting === "three_lights" ? EXPOSURE_PICTURE_PX : ENVIRONMENT_PICTURE_PX}`;
    const part = ["fit", "measured"].includes(what) ? "" : `&component=${what}`;
    if (!lighting.startsWith("panorama")) return askArray(`${path}${part}&lighting=${lighting}`);
    return askArray(`${path}${part}`, { method: "POST", headers: { "Content-Type": "application/x-npy" }, body: panorama.file });
  }

  /** Paints as soon as all data are loaded; until then, and until a movement has ended, the canvas has the attribute
   * data-drawing. During a movement, a slow machine paints fewer pixels. @param {boolean} [moving] */
  async draw(moving = false) {
    if (!running.includes(this)) return;
    const turn = this.turns += 1;
    this.canvas.dataset.drawing = "";
    clearTimeout(this.rest);
    if (moving) this.rest = setTimeout(() => this.draw(), 250);
    const now = look();
    if (this.cost > MAX_SILENT_PICTURE_MS && !moving) this.work("Drawing…");
    for (const mark of this.stage.querySelectorAll("span")) mark.hidden = !(this.hasBoth && now.show === "half");
    this.stage.style.setProperty("--wipe", String(now.wipe));
    find(this.figure, ".scale").hidden = !(this.hasBoth && now.show === "difference");
    now.show = this.hasBoth ? now.show : this.subject.fit ? "fit" : "measured";
    const shown = this.boxes.filter((box) => box.checked).map((box) => box.value);
    const isWhole = shown.length === this.boxes.length;
    const isAround = now.lighting === "environment"; // Pictures under an environment need no program of the material.
    try {
      const lit = isAround ? [] : [now.show !== "measured" && (isWhole ? "glsl" : "parts"), now.show !== "fit" && "measured"];
      const [seen, program, ...programs] = await Promise.all([this.lookAround(now, isWhole ? null : shown), this.load("pictures"), ...lit.map((name) => name && this.load(name))]);
      await Promise.all([this.painted, new Promise(requestAnimationFrame)]);
      if (turn !== this.turns) return; // A later change has begun to draw the sphere.
      this.painted = this.paint(program, programs, now, isWhole ? LABELS : shown, seen, moving);
      await this.painted;
    } finally {
      if (turn === this.turns) {
        this.work();
        if (!moving) delete this.canvas.dataset.drawing;
      }
    }
  }

  /** Loads pictures under an environment into textures: the components that are shown, or all, and the measurement; the
   * exposure is that of the whole. Hidden components are subtracted from the whole fit if this needs fewer pictures to be
   * loaded.
   * @param {Look} now @param {string[] | null} parts */
  async lookAround({ lighting, show }, parts) {
    const isAround = lighting === "environment";
    const light = !isAround ? "three_lights" : panorama.file ? `panorama ${panorama.number}` : lighting;
    const whole = this.subject.fit ? "fit" : "measured";
    const hidden = this.boxes.map((box) => box.value).filter((label) => parts && !parts.includes(label));
    const toLoad = (/** @type {string[]} */ labels) => labels.filter((label) => !this.loaded.has(`${light}/${label}`)).length;
    const takesAway = parts !== null && toLoad(hidden) <= toLoad(parts);
    const summed = parts === null ? [whole] : takesAway ? [whole, ...hidden] : parts;
    const names = [whole, ...(isAround ? [show === "fit" ? whole : "measured", ...summed] : [])];
    const key = `${light} ${takesAway} ${names}`;
    if (key === this.seen.key) return this.seen;
    /** @type {Float32Array[]} */
    const [all, measured, ...pictures] = await Promise.all(names.map((name) => this.load(`${light}/${name}`)));
    return { key, exposure: exposureOf(all), pictures: isAround ? [all.map((_, i) => pictures.reduce((sum, picture, k) => sum + (takesAway && k ? -picture[i] : picture[i]), 0)), measured] : [] };
  }
  /** @param {Program} program @param {(Program | false)[]} programs that light fit and measurement @param {Look} now @param {string[]} shown @param {Sphere["seen"]} seen @param {boolean} moving */
  async paint({ program, at }, programs, now, shown, seen, moving) {
    const { canvas, gl } = this;
    const full = Math.min(Math.max(Math.round(canvas.clientWidth * devicePixelRatio), 64), 1024);
    const quick = Math.min(full, this.cost ? Math.max(Math.round(full * Math.sqrt(MAX_MOVING_PICTURE_MS / this.cost)), FIRST_PICTURE_PX) : FIRST_PICTURE_PX);
    const size = moving || !this.cost ? quick : full;
    if (canvas.width !== size) canvas.width = canvas.height = size;
    if (seen !== this.seen) {
      this.seen = seen;
      seen.pictures.forEach((picture, i) => setTexture(gl, i + 1, [ENVIRONMENT_PICTURE_PX, ENVIRONMENT_PICTURE_PX], picture));
      for (const other of running) if (other !== this) other.draw(); // The common exposure may have changed.
    }
    if (this.stage.ariaBusy === "true") await seenByNow();
    const begun = performance.now();
    gl.viewport(0, 0, size, size);
    const use = (/** @type {Program} */ one, /** @type {Record<string, number>} */ numbers) => {
      gl.useProgram(one.program);
      for (const [name, value] of Object.entries({ size, zoom: now.zoom, ...numbers })) gl.uniform1f(one.at(name), value);
      gl.uniform2fv(one.at("highlight"), now.highlight);
    };
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE); // Lights add up.
    for (const [i, one] of programs.entries()) {
      if (!one) continue;
      setTexture(gl, i + 1, [size, size, 1], null);
      gl.clear(gl.COLOR_BUFFER_BIT);
      for (const { towards, irradiance } of now.lighting === "one" ? LIGHTS.slice(0, 1) : LIGHTS) {
        use(one, { irradiance });
        gl.uniform3fv(one.at("towards"), towards === LIGHTS[0].towards ? lightAt(now.highlight) : towards);
        gl.uniform3fv(one.at("shown"), LABELS.map((label) => Number(shown.includes(label))));
        gl.drawArrays(gl.TRIANGLES, 0, 3);
      }
    }
    gl.disable(gl.BLEND);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    use({ program, at }, { wipe: now.wipe, exposure: Math.min(...running.map((sphere) => sphere.seen.exposure)) * 2 ** now.stops });
    gl.uniform1i(at("show"), SHOWN.indexOf(now.show));
    gl.uniform1i(at("surrounded"), Number(now.lighting === "environment"));
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    await finished(gl);
    this.cost = (performance.now() - begun) * (full / size) ** 2;
    this.figure.querySelector(".fallback")?.remove();
    if (size === full) canvas.dataset.painted = String(Number(canvas.dataset.painted ?? 0) + 1);
    else canvas.dataset.rough = String(size);
    this.onpaint();
    if (size < full && !moving) this.draw();
    else if (now.lighting === "environment" && this.subject.fit) requestIdleCallback(() => this.load("glsl", true)); // The first movement of the light needs this program.
  }
}

const MAX_GRIP_DISTANCE_PX = 14; // A pointer closer to the line between measurement and fit drags the line, otherwise the light.
const STEPS = /** @type {Record<string, number[]>} */ ({ ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] });

/** Starts spheres under one light; without WebGL 2, the service draws them. @param {Sphere[]} spheres */
export async function startSpheres(spheres) {
  await Promise.all(spheres.map((sphere) => sphere.start().then(() => running.push(sphere), async (error) => {
    sphere.hint.textContent = error.message;
    find(sphere.figure, ".toggles").hidden = true;
    await showPicture(find(sphere.figure, ".fallback", HTMLImageElement), `${sphere.path}/figures/sphere.png?size=256`).catch(() => undefined);
    sphere.work();
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
  if (look().lighting === "environment") find(controls(), "[name=lighting]", HTMLSelectElement).value = "three_lights"; // The sky does not move.
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
    if (look().lighting === "environment") return undefined; // A point has a value for each light, not for all of the sky.
    asked = setTimeout(async () => {
      const { highlight, zoom, show, wipe } = look();
      const isMeasured = sphere.hasBoth && (show === "measured" || (show === "half" && point[0] < wipe));
      const onSphere = point.map((value, i) => highlight[i] + (value - highlight[i]) / zoom);
      hint.textContent = await (await import("./plots.js")).valuesBelow(isMeasured ? { ...sphere.subject, fit: null } : sphere.subject, onSphere, lightAt(highlight));
    }, 150);
    return undefined;
  };
  canvas.onpointerleave = () => {
    clearTimeout(asked);
    hint.textContent = usual();
  };
  canvas.onkeydown = (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return; // The browser has shortcuts with these keys, for example zoom.
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
    for (const sphere of running) {
      if (!moving) sphere.hint.textContent = usual();
      sphere.draw(moving);
    }
  };
  form.oninput = () => change(true);
  form.onchange = () => change(false);
  own.oninput = (event) => event.stopPropagation(); // Spheres are drawn after the file has been read.
  own.onchange = async (event) => {
    event.stopPropagation();
    panorama.file = (own.files?.length && await (await import("./panorama.js")).readPanorama(own.files[0])) || null;
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
