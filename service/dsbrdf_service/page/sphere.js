// A lit sphere of a fit, of its measurement, or of both, which can be turned under one's own light. All spheres of a view
// show what the form of controls says.
import { find, make, request } from "./app.js";
import { fromNpy, toNpy } from "./npy.js";
import { exposureOf, finished, programOf, radianceIn, setTexture } from "./shader.js";

/** @typedef {{show: string, lighting: string, stops: number, zoom: number, wipe: number, turn: number, highlight: number[]}} Look */

const SHOWN = ["fit", "measured", "half", "difference"];
export const LABELS = ["specular_spike", "specular_lobe", "diffuse"]; // in the order of the weights in GLSL
const SIDE = 256; // pixels of a picture under environment light
const SAMPLED = 128; // pixels along a side of the pictures whose brightness gives the exposure
const QUICK = 50; // milliseconds that a picture may take while something is moved
export const USUAL = "Drag to move the light. Keys: arrows move it, + and − change the exposure, R resets.";
// Key light from the upper left, fill light from the right, rim light from behind: as `lighting=three_lights`. The form's
// `highlight` is where the reflection of the first one is seen.
const LIGHTS = [[40, 125, 1], [80, -20, 0.5], [140, 70, 0.5]].map(([polar, azimuth, share]) => {
  const [away, round] = [polar, azimuth].map((degrees) => (degrees * Math.PI) / 180);
  return { towards: [Math.sin(away) * Math.cos(round), Math.sin(away) * Math.sin(round), Math.cos(away)], irradiance: share * Math.PI };
});

/** All spheres of the view. @type {Sphere[]} */
export const running = [];
/** A panorama of one's own: which one of those that were chosen, and its pixels. @type {{number: number, pixels: Float32Array | null}} */
export const panorama = { number: 0, pixels: null };

export const controls = () => find(document, "#controls", HTMLFormElement);
/** @param {string} name */
export const field = (name) => /** @type {HTMLInputElement} */ (controls().elements.namedItem(name));

/** What the form says; the highlight is the point of the sphere where the light's reflection is seen. @returns {Look} */
export function look() {
  const { show, lighting, exposure, zoom, wipe, turn, highlight } = Object.fromEntries(new FormData(controls()));
  const [x, y] = String(highlight).split(",").map(Number);
  const numbers = { stops: Number(exposure), zoom: 2 ** Number(zoom), wipe: Number(wipe), turn: Number(turn) };
  return { show: String(show), lighting: String(lighting), ...numbers, highlight: Math.hypot(x, y) <= 1 ? [x, y] : [0, 0] };
}

/** @param {number[]} highlight */
export function lightAt([a, b]) {
  const c = Math.sqrt(Math.max(1 - a * a - b * b, 0));
  return [2 * c * a, 2 * c * b, 2 * c * c - 1];
}

export class Sphere {
  /** @param {HTMLElement} figure @param {Subject} subject @param {Promise<string | undefined>} [source] GLSL of the fit that is on its way */
  constructor(figure, subject, source) {
    this.figure = figure;
    this.subject = subject;
    this.source = source;
    this.canvas = find(figure, "canvas", HTMLCanvasElement);
    this.hint = find(figure, ".hint");
    /** What was asked for, by name: null on its way. @type {Map<string, any>} */
    this.loaded = new Map();
    /** One for each component that can be hidden. @type {HTMLInputElement[]} */
    this.boxes = [];
    this.exposure = 1;
    this.cost = 0; // milliseconds of a picture of all pixels
    /** @type {{key: string, exposure: number} | null} */
    this.surroundings = null;
    this.moving = this.changed = this.tabled = this.seen = false;
    this.pending = this.rest = 0;
    this.onpaint = () => {};
    this.canvas.setAttribute("aria-label", `Lit sphere of ${subject.name}. Arrow keys move the light, plus and minus change the exposure, R resets.`);
    this.offerParts();
  }

  offerParts() {
    const { parts, fit } = this.subject;
    const toggles = find(this.figure, ".toggles");
    toggles.hidden = parts.length < 2;
    if (toggles.hidden) return;
    for (const { label } of parts) {
      const box = make("input", { type: "checkbox", name: `${fit?.slice(0, 6)}-${label}`, "data-component": label, defaultChecked: true });
      box.setAttribute("form", "controls");
      this.boxes.push(box);
      toggles.append(make("label", { className: `c-part-${LABELS.indexOf(label)}` }, box, ` ${label.replace("_", " ")}`));
    }
  }

  async start() { // throws where there is no WebGL 2
    const { subject } = this;
    const gl = this.canvas.getContext("webgl2", { antialias: false, preserveDrawingBuffer: true });
    if (!gl) throw new Error("This browser has no WebGL 2: the picture is the service's, its light is fixed.");
    this.gl = gl;
    for (const unit of [0, 1, 2]) setTexture(gl, unit, [1, 1, 1], new Uint16Array(3));
    if (!subject.fit) this.hint.textContent = "Loading the measurement, 9 MB…";
    const [source, show] = subject.fit ? ["glsl", "fit"] : ["measured", "measured"];
    await this.fetch(source);
    if (!subject.fit) {
      this.loaded.set("glsl", await programOf(gl, "", "vec3(0.0)"));
      this.setTable();
    }
    const light = lightAt(String(field("highlight").defaultValue).split(",").map(Number));
    const begun = performance.now();
    Object.assign(this.canvas, { width: 3 * SAMPLED, height: SAMPLED });
    this.shade("glsl", { ...look(), lighting: "three", show, highlight: [0, 0] }, { size: SAMPLED, exposure: 0, wipe: 0, zoom: 1 }, light);
    this.exposure = exposureOf(await radianceIn(gl, 3 * SAMPLED, SAMPLED));
    this.hint.textContent = USUAL;
    this.canvas.hidden = false;
    this.cost = (performance.now() - begun) * (this.fullSize() / SAMPLED) ** 2;
    new ResizeObserver(() => { this.showLine(); this.draw(); }).observe(this.canvas);
  }

  /** The address of what is seen: of the fit, of a component, or of the measurement. @param {string} source @param {string} more */
  address(source, more) {
    const { fit, measured } = this.subject;
    if (source === "measured") return `v1/measurements/${measured}/figures/sphere.npy?size=${SIDE}${more}`;
    return `v1/fits/${fit}/figures/sphere.npy?size=${SIDE}${more}${source === "fit" ? "" : `&component=${source}`}`;
  }

  /** @param {string} lighting @param {string} source */
  async radiance(lighting, source) {
    return fromNpy(await (await request(this.address(source, `&lighting=${lighting}`))).arrayBuffer());
  }

  // A program of the whole fit, "glsl", or one that weighs its components, "parts"; the table of the measurement,
  // "measured"; or what is seen in the environment, "environment/fit", of the measurement or of a component; in a
  // panorama the name begins with its number and its turn.
  /** @param {string} name */
  async fetch(name) {
    this.loaded.set(name, null);
    const [around, ...rest] = name.split("/");
    let found;
    if (name === "measured") {
      found = fromNpy(await (await request(`v1/measurements/${this.subject.measured}/table.npy`)).arrayBuffer());
    } else if (name === "glsl" || name === "parts") {
      const part = name === "parts" ? `&component=${this.subject.parts[0].label}` : "";
      const known = name === "glsl" ? await this.source : undefined;
      const source = known ?? await (await request(`v1/fits/${this.subject.fit}/export?format=glsl${part}`)).text();
      found = await programOf(/** @type {WebGL2RenderingContext} */ (this.gl), source, part ? "dsbrdf_shown(a, b, shown)" : "dsbrdf(a, b)");
    } else if (around === "environment") {
      found = await this.radiance("environment", rest[0]);
    } else {
      const { turned } = await import("./panorama.js");
      const { shape, values } = turned(/** @type {Float32Array} */ (panorama.pixels), Number(rest[0]));
      const options = { method: "POST", headers: { "Content-Type": "application/x-npy" }, body: toNpy(shape, values) };
      found = fromNpy(await (await request(this.address(rest[1], ""), options)).arrayBuffer());
    }
    this.loaded.set(name, found);
  }

  /** Fetches what is missing for a picture, which is drawn when all is there; returns whether all is. @param {string[]} names */
  has(names) {
    const missing = names.filter((name) => !this.loaded.has(name));
    if (missing.length && this.moving && missing[0].startsWith("panorama")) return false; // not before it rests
    for (const name of this.loaded.keys()) if (name.startsWith("panorama") && !names.includes(name)) this.loaded.delete(name);
    for (const name of missing) {
      this.hint.textContent = name === "measured" ? "Loading the measurement, 9 MB…" : "Loading…";
      this.fetch(name).then(() => this.draw()).catch((error) => {
        this.loaded.delete(name); // the next change asks again
        throw error;
      }).finally(() => { this.hint.textContent = USUAL; });
    }
    return names.every((name) => this.loaded.get(name));
  }

  setTable() {
    if (!this.tabled) setTexture(/** @type {WebGL2RenderingContext} */ (this.gl), 0, [180, 90, 90], this.loaded.get("measured"));
    this.tabled = true;
  }

  /** Paints soon, and not before the last picture is there. While something is moved a slow machine paints fewer pixels. @param {boolean} [moving] */
  draw(moving = false) {
    this.moving = moving;
    this.changed = true;
    clearTimeout(this.rest);
    if (moving) this.rest = setTimeout(() => this.draw(), 250);
    if (this.pending || !this.gl || !running.includes(this)) return;
    this.pending = requestAnimationFrame(() => {
      this.changed = false;
      if (!this.paint()) this.pending = 0;
    });
  }

  /** Whether the left half is the measurement and the right one the fit. */
  halves() {
    return look().show === "half" && Boolean(this.subject.fit && this.subject.measured);
  }

  /** Puts the handle where the line between the halves is. */
  showLine() {
    const [handle, { offsetLeft, offsetTop, clientWidth, clientHeight }] = [find(this.figure, ".handle"), this.canvas];
    handle.hidden = !this.halves();
    handle.style.left = `${offsetLeft + (clientWidth * (1 + look().wipe)) / 2}px`;
    handle.style.top = `${offsetTop + clientHeight}px`;
  }

  fullSize() {
    return Math.min(Math.max(Math.round(this.canvas.clientWidth * devicePixelRatio), 64), 1024);
  }

  paint() {
    const { canvas, subject } = this;
    const now = look();
    const hidden = this.hidden();
    const kind = hidden.length ? "parts" : "glsl";
    const around = { environment: "environment", panorama: `panorama${panorama.number}/${now.turn}` }[now.lighting];
    now.show = !subject.fit ? "measured" : subject.measured ? now.show : "fit";
    if (now.lighting === "panorama" && !panorama.pixels) {
      this.hint.textContent = "Choose a panorama below, a picture of 360 by 180 degrees.";
      return false;
    }
    if (!this.has(this.needed(kind, now.show, around))) return false;
    if (around) this.surround(around, hidden, now.show);
    else if (now.show !== "fit") this.setTable();
    const full = this.fullSize();
    const size = this.moving || !this.seen ? Math.min(full, Math.max(Math.round(full * Math.sqrt(QUICK / this.cost)), SAMPLED)) : full;
    this.seen = true;
    if (canvas.width !== size) canvas.width = canvas.height = size;
    /** @param {Sphere} sphere */
    const own = (sphere) => (around ? sphere.surroundings?.exposure ?? Infinity : sphere.exposure);
    const base = field("own").checked ? own(this) : Math.min(...running.map(own));
    this.shade(kind, now, { size, exposure: base * 2 ** now.stops, wipe: now.wipe, zoom: now.zoom }, lightAt(now.highlight));
    this.wait(performance.now(), full, size);
    return true;
  }

  hidden() {
    return this.boxes.filter((box) => !box.checked).map((box) => String(box.dataset.component));
  }

  /** @param {string} kind of program @param {Look} now @param {Record<string, number>} numbers @param {number[]} light */
  shade(kind, now, numbers, light) {
    /** @type {import("./shader.js").Program} */
    const { program, at } = this.loaded.get(kind);
    const gl = /** @type {WebGL2RenderingContext} */ (this.gl);
    const lights = now.lighting === "one" ? LIGHTS.slice(0, 1) : LIGHTS;
    const hidden = this.hidden();
    gl.viewport(0, 0, this.canvas.width, this.canvas.height);
    gl.useProgram(program);
    for (const [name, value] of Object.entries(numbers)) gl.uniform1f(at(name), value);
    gl.uniform1i(at("count"), lights.length);
    gl.uniform1i(at("show"), SHOWN.indexOf(now.show));
    gl.uniform1i(at("surrounded"), Number(["environment", "panorama"].includes(now.lighting)));
    gl.uniform2fv(at("highlight"), now.highlight);
    const all = LIGHTS.map(({ towards }, i) => (i ? towards : light));
    gl.uniform3fv(at("towards"), all.flat());
    gl.uniform3fv(at("irradiance"), LIGHTS.flatMap(({ irradiance }) => [irradiance, irradiance, irradiance]));
    gl.uniform3fv(at("shown"), LABELS.map((label) => Number(!hidden.includes(label))));
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  /** Waits until the picture is there, so that no more than one is on its way. @param {number} begun @param {number} full @param {number} size */
  async wait(begun, full, size) {
    await finished(/** @type {WebGL2RenderingContext} */ (this.gl));
    this.cost = (performance.now() - begun) * (full / size) ** 2;
    this.pending = 0;
    find(this.figure, ".fallback").hidden = true;
    if (size === full) this.canvas.dataset.painted = String(Number(this.canvas.dataset.painted ?? 0) + 1);
    else this.canvas.dataset.rough = String(size);
    this.onpaint();
    if (this.changed || (size < full && !this.moving)) this.draw(this.moving);
  }

  /** @param {string} kind @param {string} show @param {string | undefined} around */
  needed(kind, show, around) {
    const programs = this.subject.fit ? [kind] : [];
    if (!around) return show === "fit" ? programs : [...programs, "measured"];
    const parts = kind === "parts" ? this.boxes.map((box) => `${around}/${box.dataset.component}`) : [];
    const whole = this.subject.fit ? [`${around}/fit`] : [];
    return [...programs, ...whole, ...parts, ...(show === "fit" ? [] : [`${around}/measured`])];
  }

  /** Puts what is seen in an environment into textures; the exposure is that of the whole fit. @param {string} around @param {string[]} hidden @param {string} show */
  surround(around, hidden, show) {
    const key = `${around} ${hidden} ${show === "fit"}`;
    if (this.surroundings?.key === key) return;
    const gl = /** @type {WebGL2RenderingContext} */ (this.gl);
    /** @param {string} name @returns {Float32Array} */
    const picture = (name) => this.loaded.get(`${around}/${name}`);
    const whole = picture(this.subject.fit ? "fit" : "measured");
    const shown = hidden.length ? new Float32Array(whole.length) : whole;
    if (hidden.length) {
      const visible = this.boxes.filter((box) => box.checked).map((box) => picture(String(box.dataset.component)));
      for (const part of visible) part.forEach((value, i) => { shown[i] += value; });
    }
    setTexture(gl, 1, [SIDE, SIDE], shown);
    if (show !== "fit") setTexture(gl, 2, [SIDE, SIDE], picture("measured"));
    this.surroundings = { key, exposure: exposureOf(whole.filter((value) => value > 0)) };
    for (const other of running) if (other !== this) other.draw(); // the common exposure may be another now
  }
}
