// Builds WebGL 2 programs that light a sphere, by a GLSL function of the fit or by the table of the measurement, and the
// program that shows the pictures that these make, or pictures of the sphere in an environment.
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
// The view is along -z, x to the right and y up; the normal of a pixel is the z axis of the function's frame.
const HEAD = `#version 300 es
precision highp float;
precision highp int;
uniform float size, zoom;
uniform vec2 highlight;
out vec4 colour;
vec2 point() { return highlight + (gl_FragCoord.xy * 2.0 / size - 1.0 - highlight) / zoom; }
`;
// The radiance under one light. The function of a material is called once and outside of loops: compilers copy it wherever
// it is called, and some take minutes for a long function in a loop.
const LIT = `
uniform vec3 towards;
uniform float irradiance;
void main() {
  vec2 at = point();
  colour = vec4(0.0);
  if (dot(at, at) >= 1.0) return;
  vec3 normal = vec3(at, sqrt(1.0 - dot(at, at)));
  vec3 along = normalize(vec3(normal.z, 0.0, -normal.x)), aside = cross(normal, along);
  vec3 omega_in = vec3(dot(along, towards), dot(aside, towards), dot(normal, towards));
  if (omega_in.z > 0.0) colour.rgb = material(omega_in, vec3(along.z, aside.z, normal.z)) * omega_in.z * irradiance;
}`;
/** The function of a measurement, from its table. */
export const MEASURED = `
uniform highp sampler3D table;
vec3 measured(vec3 a, vec3 b) {
  vec3 total = a + b, difference = a - b;
  float radius = length(total.xy), sum = length(total);
  vec2 heading = radius > 0.0 ? total.xy / radius : vec2(1.0, 0.0);
  float along = (dot(heading, difference.xy) * total.z - radius * difference.z) / sum;
  float across = heading.x * difference.y - heading.y * difference.x;
  vec3 angles = degrees(vec3(atan(across, along + 1e-12), atan(length(difference), sum), atan(radius, total.z)));
  vec3 node = vec3(angles.x, angles.y, sqrt(90.0 * angles.z)) + 0.5;
  return exp(textureLod(table, node / vec3(180.0, 90.0, 90.0), 0.0).rgb) - 1e-6;
}`;
// Shows two pictures of radiance: of the screen, or, under an environment, of the whole sphere.
const SHOWN = `
const float DIFFERENCES_END = ${DIFFERENCES.length - 1}.0;
const vec3 DIFFERENCES[] = vec3[](${DIFFERENCES.map((colour) => `vec3(${colour.map((value) => value.toFixed(3))})`)});
uniform float exposure, wipe;
uniform int show;
uniform bool surrounded;
uniform sampler2D fitted, measured;
vec3 scaled(vec3 difference) {
  float place = sqrt(max(max(difference.r, difference.g), difference.b)) * DIFFERENCES_END;
  int below = int(min(place, DIFFERENCES_END - 1.0));
  return mix(DIFFERENCES[below], DIFFERENCES[below + 1], place - float(below));
}
vec3 displayed(vec3 radiance) {
  vec3 linear = clamp(radiance * exposure, 0.0, 1.0);
  vec3 curved = 1.055 * pow(max(linear, 0.0031308), vec3(1.0 / 2.4)) - 0.055;
  return mix(curved, 12.92 * linear, vec3(lessThanEqual(linear, vec3(0.0031308))));
}
void main() {
  vec2 at = point(), on_screen = gl_FragCoord.xy * 2.0 / size - 1.0;
  if (dot(at, at) >= 1.0) { colour = vec4(0.0); return; }
  vec2 place = 0.5 + 0.5 * (surrounded ? vec2(at.x, -at.y) * min(1.0, 0.985 / length(at)) : on_screen);
  vec3 fit = displayed(textureLod(fitted, place, 0.0).rgb), real = displayed(textureLod(measured, place, 0.0).rgb);
  vec3 one = show == 1 || (show == 2 && on_screen.x < wipe) ? real : fit;
  if (show == 3) one = scaled(abs(fit - real));
  else if (show == 2 && abs(on_screen.x - wipe) < 2.0 / size) one = vec3(1.0);
  colour = vec4(one, 1.0);
}`;

/** @param {WebGL2RenderingContext} gl @param {number} kind @param {string} source */
function compile(gl, kind, source) {
  const shader = /** @type {WebGLShader} */ (gl.createShader(kind));
  gl.shaderSource(shader, source);
  gl.compileShader(shader);
  return shader;
}

/** Makes a program that lights a sphere, from the functions of a material and the call that returns its values for the
 * directions a and b; or the program that shows pictures, without a call.
 * @param {WebGL2RenderingContext} gl @param {string} [given] @param {string} [call] @returns {Promise<Program>} */
export async function programOf(gl, given = "", call = "") {
  const source = call ? `${given}\nuniform vec3 shown;\nvec3 material(vec3 a, vec3 b) { return ${call}; }${LIT}` : SHOWN;
  const program = /** @type {WebGLProgram} */ (gl.createProgram());
  gl.attachShader(program, compile(gl, gl.VERTEX_SHADER, VERTEX));
  const fragment = compile(gl, gl.FRAGMENT_SHADER, HEAD + source);
  gl.attachShader(program, fragment);
  gl.linkProgram(program);
  const parallel = gl.getExtension("KHR_parallel_shader_compile"); // Without this extension, compilation blocks the page.
  while (parallel && !gl.getProgramParameter(program, parallel.COMPLETION_STATUS_KHR)) await pause(5);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) {
    throw new Error(`The shader does not compile here: ${gl.getShaderInfoLog(fragment) || gl.getProgramInfoLog(program)}`);
  }
  gl.useProgram(program);
  ["table", "fitted", "measured"].forEach((name, unit) => gl.uniform1i(gl.getUniformLocation(program, name), unit));
  return { program, at: (name) => gl.getUniformLocation(program, name) };
}

/** Puts values into the texture of a unit: unit 0 holds a three-dimensional table, other units hold pictures; a picture
 * without values is black, and becomes the target of drawing.
 * @param {WebGL2RenderingContext} gl @param {number} unit @param {number[]} size @param {Uint16Array | Float32Array | null} values */
export function setTexture(gl, unit, [width, height, depth], values) {
  const target = unit === 0 ? gl.TEXTURE_3D : gl.TEXTURE_2D;
  const type = values instanceof Float32Array ? gl.FLOAT : gl.HALF_FLOAT;
  gl.activeTexture(gl.TEXTURE0 + unit);
  const texture = gl.getParameter(unit === 0 ? gl.TEXTURE_BINDING_3D : gl.TEXTURE_BINDING_2D) ?? gl.createTexture();
  gl.bindTexture(target, texture);
  gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
  if (unit === 0) gl.texImage3D(target, 0, gl.RGB16F, width, height, depth, 0, gl.RGB, type, values);
  else if (values) gl.texImage2D(target, 0, gl.RGB16F, width, height, 0, gl.RGB, type, values);
  else gl.texImage2D(target, 0, gl.RGBA16F, width, height, 0, gl.RGBA, type, null);
  for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(target, filter, gl.LINEAR);
  for (const wrap of [gl.TEXTURE_WRAP_T, gl.TEXTURE_WRAP_R]) gl.texParameteri(target, wrap, gl.CLAMP_TO_EDGE);
  gl.texParameteri(target, gl.TEXTURE_WRAP_S, unit === 0 ? gl.REPEAT : gl.CLAMP_TO_EDGE); // phi_diff is periodic.
  if (values) return;
  if (!gl.getParameter(gl.FRAMEBUFFER_BINDING)) gl.bindFramebuffer(gl.FRAMEBUFFER, gl.createFramebuffer());
  gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, target, texture, 0);
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
