// Builds WebGL 2 programs that light a sphere: by a GLSL function of the fit, by the table of the measurement, or by
// pictures of the sphere in an environment.
import { pause } from "./app.js";

/** Colours of a difference, from 0 to 1 on a square root scale. */
const DIFFERENCES = [[0, 0, 0], [0.35, 0.06, 0.43], [0.84, 0.25, 0.31], [0.98, 0.6, 0.1], [1, 0.92, 0.55]];
document.body.style.setProperty("--scale", `linear-gradient(90deg, ${DIFFERENCES.map((colour) => `rgb(${colour.map((value) => 255 * value).join(" ")})`).join(", ")})`);
/** Returns the colour of a difference of two pictures. @param {number} difference of the channel that differs most, from 0 to 1 */
export function colourOf(difference) {
  const place = Math.sqrt(difference) * (DIFFERENCES.length - 1);
  const below = Math.min(Math.floor(place), DIFFERENCES.length - 2);
  return DIFFERENCES[below].map((value, i) => value + (place - below) * (DIFFERENCES[below + 1][i] - value));
}

const VERTEX = `#version 300 es
void main() { gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0.0, 1.0); }`;
const HEAD = "#version 300 es\nprecision highp float;\nprecision highp int;\n";
// The view is along -z, x to the right and y up; the normal of a pixel is the z axis of the function's frame.
const MAIN = `
const float DIFFERENCES_END = ${DIFFERENCES.length - 1}.0;
const vec3 DIFFERENCES[] = vec3[](${DIFFERENCES.map((colour) => `vec3(${colour.map((value) => value.toFixed(3))})`)});
uniform float size, exposure, wipe, zoom;
uniform int count, show;
uniform bool surrounded;
uniform vec2 highlight;
uniform vec3 towards[3];
uniform float irradiance[3];
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
vec3 scaled(vec3 difference) {
  float place = sqrt(max(max(difference.r, difference.g), difference.b)) * DIFFERENCES_END;
  int below = int(min(place, DIFFERENCES_END - 1.0));
  return mix(DIFFERENCES[below], DIFFERENCES[below + 1], place - float(below));
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
  bool real = show == 1 || (show == 2 && on_screen.x < wipe);
  vec3 one = vec3(0.0);
  // A single call in a loop keeps compilation short: compilers copy a function wherever it is called.
  for (int side = 0; side < (show == 3 ? 2 : 1); ++side) one = abs(one - seen(at, real != (side == 1)));
  if (show == 3) one = scaled(one);
  else if (show == 2 && abs(on_screen.x - wipe) < 2.0 / size) one = vec3(1.0);
  colour = vec4(one, 1.0);
}`;

const TABLE = /const (vec4 (\w+)\[(\d+)\]) = vec4\[\d+\]\(([^;]*)\);/;
const RESERVED_UNIFORM_VECTORS = 32; // Uniforms other than the material's need at most this number of vectors.

/** @param {WebGL2RenderingContext} gl @param {number} kind @param {string} source */
function compile(gl, kind, source) {
  const shader = /** @type {WebGLShader} */ (gl.createShader(kind));
  gl.shaderSource(shader, source);
  gl.compileShader(shader);
  return shader;
}

/** Makes a program from the functions of a material, and the call that returns its values for the directions a and b.
 * A long table of constants takes more time than all else: it becomes a uniform where there is room for it.
 * @param {WebGL2RenderingContext} gl @param {string} given @param {string} call @returns {Promise<Program>} */
export async function programOf(gl, given, call) {
  const [constants = "", declared, name, count, numbers] = TABLE.exec(given) ?? [];
  const isUniform = Number(count) < gl.getParameter(gl.MAX_FRAGMENT_UNIFORM_VECTORS) - RESERVED_UNIFORM_VECTORS;
  const functions = isUniform ? given.replace(constants, `uniform ${declared};`) : given;
  const material = `${functions}\nuniform vec3 shown;\nvec3 material(vec3 a, vec3 b) { return ${call}; }`;
  const program = /** @type {WebGLProgram} */ (gl.createProgram());
  gl.attachShader(program, compile(gl, gl.VERTEX_SHADER, VERTEX));
  const fragment = compile(gl, gl.FRAGMENT_SHADER, HEAD + material + MAIN);
  gl.attachShader(program, fragment);
  gl.linkProgram(program);
  const parallel = gl.getExtension("KHR_parallel_shader_compile"); // Without this extension, compilation blocks the page.
  while (parallel && !gl.getProgramParameter(program, parallel.COMPLETION_STATUS_KHR)) await pause(5);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) {
    throw new Error(`The shader does not compile here: ${gl.getShaderInfoLog(fragment) || gl.getProgramInfoLog(program)}`);
  }
  gl.useProgram(program);
  if (isUniform) gl.uniform4fv(gl.getUniformLocation(program, name), JSON.parse(`[${numbers.replace(/vec4\(|\)/g, "")}]`));
  ["table", "around", "around_measured"].forEach((name, unit) => gl.uniform1i(gl.getUniformLocation(program, name), unit));
  return { program, at: (name) => gl.getUniformLocation(program, name) };
}

/** Puts values into the texture of a unit: unit 0 holds a three-dimensional table, other units hold pictures.
 * @param {WebGL2RenderingContext} gl @param {number} unit @param {number[]} size @param {Uint16Array | Float32Array} values */
export function setTexture(gl, unit, [width, height, depth], values) {
  const target = unit === 0 ? gl.TEXTURE_3D : gl.TEXTURE_2D;
  const type = values instanceof Uint16Array ? gl.HALF_FLOAT : gl.FLOAT;
  gl.activeTexture(gl.TEXTURE0 + unit);
  gl.bindTexture(target, gl.createTexture());
  gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
  if (unit === 0) gl.texImage3D(target, 0, gl.RGB16F, width, height, depth, 0, gl.RGB, type, values);
  else gl.texImage2D(target, 0, gl.RGB16F, width, height, 0, gl.RGB, type, values);
  for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(target, filter, gl.LINEAR);
  for (const wrap of [gl.TEXTURE_WRAP_T, gl.TEXTURE_WRAP_R]) gl.texParameteri(target, wrap, gl.CLAMP_TO_EDGE);
  gl.texParameteri(target, gl.TEXTURE_WRAP_S, unit === 0 ? gl.REPEAT : gl.CLAMP_TO_EDGE); // phi_diff is periodic.
}

/** Waits for the end of drawing without blocking the page. @param {WebGL2RenderingContext} gl */
export async function finished(gl) {
  const fence = /** @type {WebGLSync} */ (gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0));
  gl.flush();
  do await pause(4); while (gl.clientWaitSync(fence, 0, 0) === gl.TIMEOUT_EXPIRED);
  gl.deleteSync(fence);
}

/** Returns the factor that takes the 99th percentile of a sphere's pixels to 1. @param {Float32Array} picture */
export function exposureOf(picture) {
  const side = Math.sqrt(picture.length / 3);
  const centred = (/** @type {number} */ i) => ((i % side) + 0.5) / side - 0.5;
  const sorted = picture.filter((_, i) => Math.hypot(centred(Math.floor(i / 3)), centred(Math.floor(i / 3 / side))) < 0.5).sort();
  return 1 / (sorted[Math.round(0.99 * (sorted.length - 1))] || 1);
}
