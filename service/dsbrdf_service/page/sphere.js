// A lit sphere of a fit by WebGL 2, of its measurement, or of both. The fit is a GLSL function that the service exports,
// as it is, or, once a component is hidden, that of a component, which has the weights of all. The measurement is a
// texture of its logarithms. All spheres of a page show what the form of controls says.
import { readPanorama, turned } from "./panorama.js";

const root = document.documentElement.dataset.root;
const form = document.getElementById("controls");
const SHOWN = ["fit", "measured", "half", "difference"];
const SIDE = 256; // pixels of a picture under environment light
const QUICK = 50; // milliseconds that a picture may take while something is moved
const VERTEX = `#version 300 es
void main() { gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0.0, 1.0); }`;
// The view is along -z, x to the right and y up; the normal of a pixel is the z axis of the function's frame.
const MAIN = `
uniform float size, exposure, wipe, zoom;
uniform int count, show;
uniform bool surrounded;
uniform vec2 highlight;
uniform vec3 towards[3], irradiance[3];
uniform highp sampler3D table;
uniform sampler2D around, around_measured;
out vec4 colour;
vec3 measured(vec3 a, vec3 b) {
  vec3 total = a + b, difference = a - b;
  float radius = length(total.xy), sum = length(total);
  vec2 heading = radius > 0.0 ? total.xy / radius : vec2(1.0, 0.0);
  float along = (dot(heading, difference.xy) * total.z - radius * difference.z) / sum;
  float across = heading.x * difference.y - heading.y * difference.x;
  vec3 angles = degrees(vec3(atan(across, along + 1e-12), atan(length(difference), sum), atan(radius, total.z)));
  vec3 node = vec3(angles.x, angles.y, sqrt(90.0 * angles.z)) + 0.5;
  return exp(textureLod(table, node / vec3(180.0, 90.0, 90.0), 0.0).rgb) - 1e-6;
}
vec3 seen(vec2 at, bool real) {
  vec3 normal = vec3(at, sqrt(1.0 - dot(at, at))), radiance = vec3(0.0);
  vec3 along = normalize(vec3(normal.z, 0.0, -normal.x)), aside = cross(normal, along);
  vec3 omega_out = vec3(along.z, aside.z, normal.z);
  vec2 place = vec2(at.x, -at.y) * min(1.0, 0.985 / length(at)) * 0.5 + 0.5;
  if (surrounded) radiance = real ? textureLod(around_measured, place, 0.0).rgb : textureLod(around, place, 0.0).rgb;
  else for (int light = 0; light < count; ++light) {
    vec3 omega_in = vec3(dot(along, towards[light]), dot(aside, towards[light]), dot(normal, towards[light]));
    if (omega_in.z <= 0.0) continue;
    radiance += (real ? measured(omega_in, omega_out) : material(omega_in, omega_out)) * omega_in.z * irradiance[light];
  }
  vec3 linear = clamp(radiance * exposure, 0.0, 1.0);
  vec3 curved = 1.055 * pow(max(linear, 0.0031308), vec3(1.0 / 2.4)) - 0.055;
  return mix(curved, 12.92 * linear, vec3(lessThanEqual(linear, vec3(0.0031308))));
}
void main() {
  vec2 on_screen = gl_FragCoord.xy * 2.0 / size - 1.0;
  vec2 at = highlight + (on_screen - highlight) / zoom;
  if (dot(at, at) >= 1.0) { colour = vec4(0.0); return; }
  bool left = on_screen.x < wipe;
  if (show == 3) colour = vec4(4.0 * abs(seen(at, true) - seen(at, false)), 1.0);
  else if (show == 2 && abs(on_screen.x - wipe) < 2.0 / size) colour = vec4(1.0);
  else colour = vec4(seen(at, show == 1 || (show == 2 && left)), 1.0);
}`;

async function load(path, kind, body) {
  const answer = await fetch(root + path, body && { method: "POST", headers: { "Content-Type": "application/octet-stream" }, body });
  if (!answer.ok) throw new Error((await answer.json()).detail);
  return answer[kind]();
}

function compile(gl, kind, source) {
  const shader = gl.createShader(kind);
  gl.shaderSource(shader, source);
  gl.compileShader(shader);
  return shader;
}

// What the form says; the highlight is the point of the sphere where the light's reflection is seen.
function look() {
  const { show, lighting, exposure, zoom, wipe, turn, highlight } = Object.fromEntries(new FormData(form));
  const [x, y] = highlight.split(",").map(Number);
  return { show, lighting, stops: Number(exposure), zoom: 2 ** Number(zoom), wipe: Number(wipe), turn: Number(turn), highlight: Math.hypot(x, y) <= 1 ? [x, y] : [0, 0] };
}

function lightAt([a, b]) {
  const c = Math.sqrt(Math.max(1 - a * a - b * b, 0));
  return [2 * c * a, 2 * c * b, 2 * c * c - 1];
}

function aim(x, y) {
  const shrink = Math.min(1, 0.97 / Math.hypot(x, y));
  form.elements.highlight.value = [x * shrink, y * shrink].map((value) => value.toFixed(4)).join();
  form.dispatchEvent(new Event("input", { bubbles: true }));
}

const running = []; // all spheres of the page
const panorama = { number: 0, pixels: null }; // of one's own: which one of those that were chosen, and its pixels

export class Sphere {
  constructor(figure) {
    this.figure = figure;
    this.path = `fits/${figure.dataset.fit}`;
    this.canvas = figure.querySelector("canvas");
    this.hint = figure.querySelector(".hint");
    this.loaded = new Map(); // by name: null on its way
    this.programs = new Map();
    this.boxes = [...figure.querySelectorAll("[data-component]")];
    this.cost = 0; // milliseconds of a picture of all pixels
    this.onpaint = () => {};
  }

  // Throws where there is no WebGL 2 or no view.
  async start() {
    [this.view] = await Promise.all([load(`${this.path}/view`, "json"), this.fetch("glsl")]);
    const [x, y, z] = this.view.lights[0].direction;
    const { highlight } = form.elements;
    highlight.defaultValue ||= [x, y].map((value) => (value / Math.hypot(x, y, z + 1)).toFixed(6)).join();
    highlight.value ||= highlight.defaultValue;
    this.gl = this.canvas.getContext("webgl2", { antialias: false, preserveDrawingBuffer: true });
    if (!this.gl) throw new Error("This browser has no WebGL 2: the picture is the service's, its light is fixed.");
    for (const unit of [0, 1, 2]) this.texture(unit, [1, 1, 1], new Uint16Array(3));
    this.program("glsl");
    this.listen();
    this.canvas.hidden = false;
    this.figure.querySelector(".fallback").hidden = true;
    this.usual = "Drag to move the light; with the keyboard, arrows, + and −, and R to reset.";
    this.hint.textContent = this.usual;
    new ResizeObserver(() => this.draw()).observe(this.canvas);
  }

  // A GLSL function of the whole fit, "glsl", or one that weighs its components, "parts"; the table of the measurement,
  // "measured"; or what is seen under environment light, "environment/fit", of the measurement or of a component; under
  // a panorama the name begins with its number and its turn.
  async fetch(name) {
    this.loaded.set(name, null);
    if (name.startsWith("panorama")) {
      const [, turn, source] = name.split("/");
      this.loaded.set(name, await load(`${this.path}/environment/${source}.bin`, "arrayBuffer", turned(panorama.pixels, turn)));
      return;
    }
    const part = name === "parts" ? `&component=${this.boxes[0].dataset.component}` : "";
    const [path, kind] = ["glsl", "parts"].includes(name)
      ? [`v1/${this.path}/export?format=glsl${part}`, "text"]
      : [`${this.path}/${name}.bin`, "arrayBuffer"];
    this.loaded.set(name, await load(path, kind));
  }

  // Fetches what is missing for a picture, which is drawn when all is there; returns whether all is.
  has(names) {
    const missing = names.filter((name) => !this.loaded.has(name));
    if (missing.length && this.moving && missing[0].startsWith("panorama")) return false; // not before it rests
    for (const name of this.loaded.keys()) if (name.startsWith("panorama") && !names.includes(name)) this.loaded.delete(name);
    for (const name of missing) {
      this.hint.textContent = name === "measured" ? "Loading the measurement, 9 MB…" : "Loading…";
      this.fetch(name).then(() => {
        if (name === "parts") this.program(name);
        this.hint.textContent = this.usual;
        this.draw();
      }).catch((error) => {
        this.loaded.delete(name); // the next change asks again
        this.hint.textContent = error.message;
      });
    }
    return names.every((name) => this.loaded.get(name));
  }

  texture(unit, [width, height, depth], values) {
    const { gl } = this;
    const target = unit === 0 ? gl.TEXTURE_3D : gl.TEXTURE_2D;
    const type = values instanceof Uint16Array ? gl.HALF_FLOAT : gl.FLOAT;
    gl.activeTexture(gl.TEXTURE0 + unit);
    gl.bindTexture(target, gl.createTexture());
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    if (unit === 0) gl.texImage3D(target, 0, gl.RGB16F, width, height, depth, 0, gl.RGB, type, values);
    else gl.texImage2D(target, 0, gl.RGB16F, width, height, 0, gl.RGB, type, values);
    for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(target, filter, gl.LINEAR);
    for (const wrap of [gl.TEXTURE_WRAP_T, gl.TEXTURE_WRAP_R]) gl.texParameteri(target, wrap, gl.CLAMP_TO_EDGE);
    gl.texParameteri(target, gl.TEXTURE_WRAP_S, unit === 0 ? gl.REPEAT : gl.CLAMP_TO_EDGE); // phi_diff is periodic
  }

  program(kind) {
    const known = this.programs.get(kind);
    if (known) return known;
    const gl = this.gl;
    const call = kind === "parts" ? "dsbrdf_shown(a, b, shown)" : "dsbrdf(a, b)";
    const functions = `${this.loaded.get(kind)}\nuniform vec3 shown;\nvec3 material(vec3 a, vec3 b) { return ${call}; }`;
    const program = gl.createProgram();
    const head = "#version 300 es\nprecision highp float;\nprecision highp int;\n";
    gl.attachShader(program, compile(gl, gl.VERTEX_SHADER, VERTEX));
    const fragment = compile(gl, gl.FRAGMENT_SHADER, head + functions + MAIN);
    gl.attachShader(program, fragment);
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) {
      throw new Error(`The shader does not compile here: ${gl.getShaderInfoLog(fragment) || gl.getProgramInfoLog(program)}`);
    }
    gl.useProgram(program);
    ["table", "around", "around_measured"].forEach((name, unit) => gl.uniform1i(gl.getUniformLocation(program, name), unit));
    this.programs.set(kind, { program, at: (name) => gl.getUniformLocation(program, name) });
    return this.programs.get(kind);
  }

  // Paints soon, and not before the last picture is there. While something is moved a slow machine paints fewer pixels.
  draw(moving = false) {
    this.moving = moving;
    this.changed = true;
    clearTimeout(this.rest);
    if (moving) this.rest = setTimeout(() => this.draw(), 250);
    if (this.pending || !this.gl) return;
    this.pending = requestAnimationFrame(() => {
      this.changed = false;
      if (!this.paint()) this.pending = 0;
    });
  }

  paint() {
    const { gl, canvas, view } = this;
    const now = look();
    const hidden = this.boxes.filter((box) => !box.checked).map((box) => box.dataset.component);
    const kind = hidden.length ? "parts" : "glsl";
    const around = { environment: "environment", panorama: `panorama${panorama.number}/${now.turn}` }[now.lighting];
    const surrounded = around !== undefined;
    const show = view.pictures.includes("measured") ? now.show : "fit";
    if (now.lighting === "panorama" && !panorama.pixels) { this.hint.textContent = "Choose a panorama below: a .hdr file or a picture, 360 by 180 degrees."; return false; }
    if (!this.has(this.needed(kind, show, around))) return false;
    if (surrounded) this.surround(around, hidden, show);
    else if (show !== "fit" && !this.tabled) this.tabled = !this.texture(0, [180, 90, 90], new Uint16Array(this.loaded.get("measured")));
    const lights = (now.lighting === "one" ? view.lights.slice(0, 1) : view.lights).map((light, i) => (i ? light.direction : lightAt(now.highlight)));
    const padded = (vectors) => new Float32Array(9).map((_, index) => vectors.flat()[index] ?? 0);
    const full = Math.min(Math.max(Math.round(canvas.clientWidth * devicePixelRatio), 64), 1024);
    const size = this.moving ? Math.round(Math.max(full * Math.min(1, Math.sqrt(QUICK / this.cost)), 64)) : full;
    if (canvas.width !== size) canvas.width = canvas.height = size;
    const { program, at } = this.program(kind);
    gl.viewport(0, 0, size, size);
    gl.useProgram(program);
    const own = (sphere) => (surrounded ? sphere.surroundings?.exposure : sphere.view.exposure);
    const base = form.elements.own?.checked === false ? Math.min(...running.map(own).filter(Boolean)) : own(this);
    const numbers = { size, exposure: base * 2 ** now.stops, wipe: now.wipe, zoom: now.zoom };
    for (const [name, value] of Object.entries(numbers)) gl.uniform1f(at(name), value);
    gl.uniform1i(at("count"), lights.length);
    gl.uniform1i(at("show"), SHOWN.indexOf(show));
    gl.uniform1i(at("surrounded"), surrounded);
    gl.uniform2fv(at("highlight"), now.highlight);
    gl.uniform3fv(at("towards"), padded(lights));
    gl.uniform3fv(at("irradiance"), padded(view.lights.map((light) => light.irradiance)));
    gl.uniform3fv(at("shown"), view.labels.map((label) => Number(!hidden.includes(label))));
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    this.wait(performance.now(), full, size);
    return true;
  }

  // Waits until the picture is there, so that no more than one is on its way.
  wait(begun, full, size) {
    const { gl, canvas } = this;
    const fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    gl.flush();
    const check = () => {
      if (gl.clientWaitSync(fence, 0, 0) === gl.TIMEOUT_EXPIRED) return setTimeout(check, 4);
      gl.deleteSync(fence);
      this.cost = (performance.now() - begun) * (full / size) ** 2;
      this.pending = 0;
      if (size === full) canvas.dataset.painted = String(Number(canvas.dataset.painted ?? 0) + 1);
      else canvas.dataset.rough = String(size);
      this.onpaint();
      return this.changed && this.draw(this.moving);
    };
    setTimeout(check, 0);
  }

  needed(kind, show, around) {
    if (around === undefined) return show === "fit" ? [kind] : [kind, "measured"];
    const parts = kind === "parts" ? this.boxes.map((box) => `${around}/${box.dataset.component}`) : [];
    return [kind, `${around}/fit`, ...parts, ...(show === "fit" ? [] : [`${around}/measured`])];
  }

  // Puts what is seen under environment light into textures; the exposure is that of the whole fit.
  surround(around, hidden, show) {
    const key = `${around} ${hidden} ${show === "fit"}`;
    if (this.surroundings?.key === key) return;
    const picture = (name) => new Float32Array(this.loaded.get(`${around}/${name}`));
    const whole = picture("fit");
    const shown = hidden.length ? new Float32Array(whole.length) : whole;
    if (hidden.length) {
      const visible = this.boxes.filter((box) => box.checked).map((box) => picture(box.dataset.component));
      for (const part of visible) part.forEach((value, i) => { shown[i] += value; });
    }
    this.texture(1, [SIDE, SIDE], shown);
    if (show !== "fit") this.texture(2, [SIDE, SIDE], picture("measured"));
    const bright = whole.filter((value) => value > 0).sort();
    for (const other of running) if (other !== this) other.draw(); // the common exposure may be another now
    this.surroundings = { key, exposure: 1 / (bright[Math.floor(0.99 * bright.length)] || 1) };
  }

  // The point of the sphere below a pointer, or null.
  point(event) {
    const box = this.canvas.getBoundingClientRect();
    const at = [((event.clientX - box.left) / box.width) * 2 - 1, 1 - ((event.clientY - box.top) / box.height) * 2];
    return { onScreen: at, onSphere: at.map((value, i) => look().highlight[i] + (value - look().highlight[i]) / look().zoom) };
  }

  listen() {
    const { canvas } = this;
    const follow = (event) => aim(...this.point(event).onScreen);
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      follow(event);
    });
    canvas.addEventListener("pointermove", (event) => {
      if (event.buttons) return follow(event);
      clearTimeout(this.asked);
      this.asked = setTimeout(() => this.tell(this.point(event).onSphere), 150);
    });
    canvas.addEventListener("pointerleave", () => { clearTimeout(this.asked); this.hint.textContent = this.usual; });
    canvas.addEventListener("keydown", (event) => {
      const steps = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key];
      if (!steps) return;
      event.preventDefault();
      aim(...look().highlight.map((value, i) => value + 0.05 * steps[i]));
    });
  }

  // Says the angles and values at a point of the sphere, for the light that is dragged, and whose light it is mostly.
  async tell([x, y]) {
    const light = lightAt(look().highlight);
    const normal = [x, y, Math.sqrt(1 - x * x - y * y)];
    const dot = (a, b) => a.reduce((sum, value, i) => sum + value * b[i], 0);
    if (!(normal[2] > 0 && dot(normal, light) > 0)) { this.hint.textContent = "The light does not reach this point."; return; }
    const flat = Math.hypot(normal[0], normal[2]);
    const along = [normal[2] / flat, 0, -normal[0] / flat];
    const aside = [normal[1] * along[2], normal[2] * along[0] - normal[0] * along[2], -normal[1] * along[0]];
    const local = (vector) => [along, aside, normal].map((axis) => dot(axis, vector).toFixed(6)).join();
    const query = `brdf?omega_in=${local(light)}&omega_out=${local([0, 0, 1])}`;
    const labels = this.boxes.map((box) => box.dataset.component);
    try {
      const answers = [`${query}`, ...labels.map((label) => `components/${label}/${query}`)].map((path) => load(`v1/${this.path}/${path}`, "json"));
      const [fit, ...parts] = (await Promise.all(answers)).map(({ values }) => values[0]);
      const half = normal.map((_, i) => light[i] + Number(i === 2));
      const degrees = (cosine) => ((Math.acos(Math.min(cosine, 1)) * 180) / Math.PI).toFixed(1);
      const angles = `θ_half ${degrees(dot(half, normal) / Math.hypot(...half))}°, θ_diff ${degrees(Math.hypot(...half) / 2)}°`;
      const sums = parts.map((values) => values.reduce((sum, value) => sum + value, 0));
      const most = sums.indexOf(Math.max(...sums));
      const share = Math.round((100 * sums[most]) / sums.reduce((sum, value) => sum + value, 0));
      const mostly = labels.length ? `, ${share} % ${labels[most].replace("_", " ")}` : "";
      this.hint.textContent = `${angles}: ${fit.map((value) => value.toPrecision(3)).join(", ")} 1/sr${mostly}`;
    } catch (error) {
      this.hint.textContent = error.message;
    }
  }
}

// Connects the controls of a page with all its spheres, which share the light; returns the spheres that have a view.
export async function startSpheres() {
  const spheres = [...document.querySelectorAll("figure.sphere")].map((figure) => new Sphere(figure));
  for (const sphere of spheres) {
    try {
      await sphere.start();
      running.push(sphere);
    } catch (error) {
      sphere.hint.textContent = error.message;
      const toggles = sphere.figure.querySelector(".toggles");
      if (toggles) toggles.hidden = true;
    }
  }
  if (running.length) control(running);
  return spheres.filter((sphere) => sphere.view);
}

function control(spheres) {
  const { exposure, zoom, wipe, turn } = form.elements;
  const chosen = document.getElementById("panorama");
  const change = (moving) => {
    exposure.closest("label").querySelector("output").textContent = `${exposure.value > 0 ? "+" : ""}${exposure.value} EV`;
    zoom.closest("label").querySelector("output").textContent = `${(2 ** zoom.value).toPrecision(2)}×`;
    wipe.closest("label").hidden = look().show !== "half";
    turn.closest("label").querySelector("output").textContent = `${turn.value}°`;
    turn.closest("label").hidden = chosen.closest("label").hidden = look().lighting !== "panorama";
    for (const sphere of spheres) sphere.draw(moving);
  };
  const reset = () => {
    form.reset();
    form.dispatchEvent(new Event("change", { bubbles: true }));
  };
  form.addEventListener("input", () => change(true));
  form.addEventListener("change", () => change(false));
  form.addEventListener("submit", (event) => event.preventDefault());
  chosen.addEventListener("change", async () => {
    try {
      panorama.pixels = await readPanorama(chosen.files[0]);
      panorama.number += 1;
      change(false);
    } catch (error) {
      for (const sphere of spheres) sphere.hint.textContent = error.message;
    }
  });
  document.getElementById("reset-view").addEventListener("click", reset);
  document.getElementById("show").hidden = !spheres.some(({ view }) => view.pictures.includes("measured"));
  for (const sphere of spheres) {
    for (const box of sphere.boxes) box.addEventListener("change", () => sphere.draw());
    sphere.canvas.addEventListener("keydown", (event) => {
      if (event.key === "r" || event.key === "R") reset();
      else if ("+-=".includes(event.key)) {
        exposure.value = String(Number(exposure.value) + (event.key === "-" ? -0.5 : 0.5));
        form.dispatchEvent(new Event("input", { bubbles: true }));
      }
    });
  }
  form.hidden = false;
  change(false);
}
