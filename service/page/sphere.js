// A lit sphere of a fit by WebGL 2. Its material is a GLSL function that the service exports, as it is: the fit's, or,
// once a component is hidden, that of a component, which has the weights of all.
const root = document.documentElement.dataset.root;
const VERTEX = `#version 300 es
void main() { gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0.0, 1.0); }`;
// The view is along -z, x to the right and y up; the normal of a pixel is the z axis of the function's frame.
const MAIN = `
uniform float size, exposure;
uniform int count;
uniform vec3 towards[3], irradiance[3];
out vec4 colour;
void main() {
  vec2 at = gl_FragCoord.xy * 2.0 / size - 1.0;
  float square = dot(at, at);
  if (square >= 1.0) { colour = vec4(0.0); return; }
  vec3 normal = vec3(at, sqrt(1.0 - square));
  vec3 along = normalize(vec3(normal.z, 0.0, -normal.x)), aside = cross(normal, along);
  vec3 omega_out = vec3(along.z, aside.z, normal.z), radiance = vec3(0.0);
  for (int light = 0; light < count; ++light) {
    vec3 omega_in = vec3(dot(along, towards[light]), dot(aside, towards[light]), dot(normal, towards[light]));
    if (omega_in.z > 0.0) radiance += material(omega_in, omega_out) * omega_in.z * irradiance[light];
  }
  vec3 linear = clamp(radiance * exposure, 0.0, 1.0);
  vec3 curved = 1.055 * pow(max(linear, 0.0031308), vec3(1.0 / 2.4)) - 0.055;
  colour = vec4(mix(curved, 12.92 * linear, vec3(lessThanEqual(linear, vec3(0.0031308)))), 1.0);
}`;

async function load(path, kind) {
  const answer = await fetch(root + path);
  if (!answer.ok) throw new Error((await answer.json()).detail);
  return answer[kind]();
}

function compile(gl, kind, source) {
  const shader = gl.createShader(kind);
  gl.shaderSource(shader, source);
  gl.compileShader(shader);
  return shader;
}

export class Sphere {
  constructor(figure) {
    this.figure = figure;
    this.canvas = figure.querySelector("canvas");
    this.hint = figure.querySelector(".hint");
    this.sources = new Map();
    this.programs = new Map();
    this.boxes = [...figure.querySelectorAll("[data-component]")];
    for (const box of this.boxes) box.checked = true; // a browser keeps what was ticked before
    this.stops = 0;
    this.single = false;
    this.onlight = () => {};
  }

  // Returns the description of the view; throws where there is no WebGL 2 or no view.
  async start() {
    const path = `fits/${this.figure.dataset.fit}`;
    const [view] = await Promise.all([load(`${path}/view`, "json"), this.source("")]);
    this.view = view;
    this.gl = this.canvas.getContext("webgl2", { antialias: false, preserveDrawingBuffer: true });
    if (!this.gl) throw new Error("This browser has no WebGL 2: the picture is the service's, its light is fixed.");
    this.reset();
    this.program("");
    this.listen();
    this.canvas.hidden = false;
    this.figure.querySelector(".fallback").hidden = true;
    this.hint.textContent = "Drag to move the light; with the keyboard, arrows, + and −, and R to reset.";
    new ResizeObserver(() => this.draw()).observe(this.canvas);
    return view;
  }

  // The GLSL function of the whole fit, "", or the one that weighs its components, "parts".
  source(kind) {
    if (!this.sources.has(kind)) {
      const part = kind && `&component=${this.boxes[0].dataset.component}`;
      this.sources.set(kind, load(`v1/fits/${this.figure.dataset.fit}/export?format=glsl${part}`, "text"));
    }
    return this.sources.get(kind).then((text) => (this.sources[kind] = text));
  }

  program(kind) {
    const known = this.programs.get(kind);
    if (known) return known;
    const gl = this.gl;
    const call = kind ? "dsbrdf_shown(a, b, shown)" : "dsbrdf(a, b)";
    const functions = `${this.sources[kind]}\nuniform vec3 shown;\nvec3 material(vec3 a, vec3 b) { return ${call}; }`;
    const program = gl.createProgram();
    const head = "#version 300 es\nprecision highp float;\nprecision highp int;\n";
    gl.attachShader(program, compile(gl, gl.VERTEX_SHADER, VERTEX));
    const fragment = compile(gl, gl.FRAGMENT_SHADER, head + functions + MAIN);
    gl.attachShader(program, fragment);
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) {
      throw new Error(`The shader does not compile here: ${gl.getShaderInfoLog(fragment) || gl.getProgramInfoLog(program)}`);
    }
    const at = (name) => gl.getUniformLocation(program, name);
    const places = { size: at("size"), exposure: at("exposure"), count: at("count"), towards: at("towards"), irradiance: at("irradiance"), shown: at("shown") };
    this.programs.set(kind, { program, places });
    return this.programs.get(kind);
  }

  async toggle() {
    try {
      await this.source("parts");
      this.program("parts");
      this.draw();
    } catch (error) {
      this.sources.delete("parts");
      this.hint.textContent = error.message;
    }
  }

  reset() {
    this.light = [...this.view.lights[0].direction];
    this.stops = 0;
  }

  draw() {
    if (this.pending || !this.gl) return;
    this.pending = requestAnimationFrame(() => {
      this.pending = 0;
      this.paint();
    });
  }

  paint() {
    const { gl, canvas, view } = this;
    const hidden = this.boxes.filter((box) => !box.checked).map((box) => box.dataset.component);
    const kind = hidden.length ? "parts" : "";
    if (!this.sources[kind]) return; // on its way
    const { program, places } = this.program(kind);
    const lights = this.single ? view.lights.slice(0, 1) : view.lights;
    const directions = lights.map((light, index) => (index === 0 ? this.light : light.direction));
    const padded = (vectors) => new Float32Array(9).map((_, index) => vectors.flat()[index] ?? 0);
    const size = Math.min(Math.max(Math.round(canvas.clientWidth * devicePixelRatio), 64), 1024);
    if (canvas.width !== size) canvas.width = canvas.height = size;
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.useProgram(program);
    gl.uniform1f(places.size, canvas.width);
    gl.uniform1f(places.exposure, view.exposure * 2 ** this.stops);
    gl.uniform1i(places.count, lights.length);
    gl.uniform3fv(places.towards, padded(directions));
    gl.uniform3fv(places.irradiance, padded(lights.map((light) => light.irradiance)));
    gl.uniform3fv(places.shown, view.labels.map((label) => Number(!hidden.includes(label))));
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    canvas.dataset.painted = String(Number(canvas.dataset.painted ?? 0) + 1);
  }

  // Puts the light where its reflection is seen at a point of the sphere.
  aim(x, y) {
    const far = Math.hypot(x, y);
    const shrink = far > 0.97 ? 0.97 / far : 1;
    const [a, b] = [x * shrink, y * shrink];
    const c = Math.sqrt(1 - a * a - b * b);
    this.light = [2 * c * a, 2 * c * b, 2 * c * c - 1];
    this.onlight(this);
  }

  listen() {
    const { canvas } = this;
    const point = (event) => {
      const box = canvas.getBoundingClientRect();
      this.aim(((event.clientX - box.left) / box.width) * 2 - 1, 1 - ((event.clientY - box.top) / box.height) * 2);
    };
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      point(event);
    });
    canvas.addEventListener("pointermove", (event) => event.buttons && point(event));
    canvas.addEventListener("keydown", (event) => {
      const steps = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key];
      if (!steps) return;
      event.preventDefault();
      const half = [this.light[0], this.light[1], this.light[2] + 1];
      const length = Math.hypot(...half) || 1;
      this.aim(half[0] / length + 0.05 * steps[0], half[1] / length + 0.05 * steps[1]);
    });
  }
}

// Connects the controls of a page with all its spheres, which share the light; returns the views by fit.
export async function startSpheres() {
  const spheres = [...document.querySelectorAll("figure.sphere")].map((figure) => new Sphere(figure));
  const running = [];
  const views = new Map();
  for (const sphere of spheres) {
    try {
      views.set(sphere.figure.dataset.fit, await sphere.start());
      running.push(sphere);
    } catch (error) {
      sphere.hint.textContent = error.message;
      const toggles = sphere.figure.querySelector(".toggles");
      if (toggles) toggles.hidden = true;
      if (sphere.view) views.set(sphere.figure.dataset.fit, sphere.view);
    }
  }
  if (running.length) control(running);
  return views;
}

function control(spheres) {
  const exposure = document.getElementById("exposure");
  const single = document.getElementById("one-light");
  const all = (change) => {
    for (const sphere of spheres) {
      change(sphere);
      sphere.draw();
    }
  };
  const expose = () => {
    const stops = Number(exposure.value);
    document.getElementById("exposure-value").textContent = `${stops > 0 ? "+" : ""}${stops} EV`;
    all((sphere) => { sphere.stops = stops; });
  };
  const reset = () => {
    exposure.value = "0";
    single.checked = false;
    all((sphere) => { sphere.reset(); sphere.single = false; });
    expose();
  };
  exposure.addEventListener("input", expose);
  single.addEventListener("change", () => all((sphere) => { sphere.single = single.checked; }));
  document.getElementById("reset").addEventListener("click", reset);
  for (const sphere of spheres) {
    sphere.onlight = ({ light }) => all((other) => { other.light = [...light]; });
    for (const box of sphere.boxes) box.addEventListener("change", () => sphere.toggle());
    sphere.canvas.addEventListener("keydown", (event) => {
      if (event.key === "r" || event.key === "R") reset();
      else if ("+-=".includes(event.key)) {
        exposure.value = String(Number(exposure.value) + (event.key === "-" ? -0.5 : 0.5));
        expose();
      }
    });
  }
  document.getElementById("controls").hidden = false;
}
