// Values of a fit, its components and its measurement along the lines of the plots.
import { Problem, request } from "./app.js";
import { fromNpy, toNpy } from "./npy.js";

/** Angles in degrees; theta_out is negative on the side of the light, `aside` is the way out of the plane of incidence. @typedef {{half: number, diff: number, light: number, out: number, aside: number, values: number[]}} Sample */

/** Samples so near to the place of a slider are shown [degrees]. */
export const NEAR = 3;
const MOST_SAMPLES = 4000;
const NODES = Array.from({ length: 90 }, (_, i) => (i * i) / 90); // theta_half of the MERL grid [degrees], dense at the peak
const AROUND = [15, 45, 75, 105, 135, 165]; // phi_diff [degrees]
const IN_PLANE = Array.from({ length: 179 }, (_, i) => i - 89); // of the viewer, negative on the light's side [degrees]
const rad = Math.PI / 180;

/** The directions of half and difference angles [degrees]: six numbers. @param {number} half @param {number} diff @param {number} phi */
export function directions(half, diff, phi) {
  const [a, b, c] = [half * rad, diff * rad, phi * rad];
  const about = [Math.sin(b) * Math.cos(c), Math.sin(b) * Math.sin(c), Math.cos(b)]; // the light, as the half vector sees it
  const into = [Math.cos(a) * about[0] + Math.sin(a) * about[2], about[1], Math.cos(a) * about[2] - Math.sin(a) * about[0]];
  const out = [2 * about[2] * Math.sin(a) - into[0], -into[1], 2 * about[2] * Math.cos(a) - into[2]];
  return [...into, ...out];
}

/** Mean values at places with some points each, NaN left out. @param {string} path @param {number[][][]} points six numbers each @returns {Promise<Channels>} */
async function meansAt(path, points) {
  const flat = Float64Array.from(points.flat(2));
  const headers = { "Content-Type": "application/x-npy", Accept: "application/x-npy" };
  const answer = await request(path, { method: "POST", headers, body: toNpy([flat.length / 6, 6], flat) });
  const values = fromNpy(await answer.arrayBuffer());
  return [0, 1, 2].map((channel) => {
    let at = 0;
    return points.map((some) => {
      const known = some.map(() => values[3 * at++ + channel]).filter((value) => !Number.isNaN(value));
      return known.length ? known.reduce((sum, value) => sum + value, 0) / known.length : null;
    });
  });
}

/** Values of all that a plot shows along x; components add up to the fit. @param {Subject} subject @param {number[]} x @param {number[][][]} points by place @param {boolean} withParts @returns {Promise<Values>} */
async function valuesOf({ fit, measured, parts }, x, points, withParts) {
  const shown = withParts ? parts : [];
  /** @param {unknown} error a measurement may be deleted while its fit is looked at */
  const gone = (error) => (error instanceof Problem && error.status === 404 ? null : Promise.reject(error));
  const [ofMeasurement, ofFit, ...ofParts] = await Promise.all([
    measured ? meansAt(`v1/measurements/${measured}/brdf`, points).catch(gone) : null,
    fit && !shown.length ? meansAt(`v1/fits/${fit}/brdf`, points) : null,
    ...shown.map(({ label }) => meansAt(`v1/fits/${fit}/components/${label}/brdf`, points)),
  ]);
  const all = /** @type {Channels[]} */ (ofParts);
  const sum = [0, 1, 2].map((channel) => points.map((some, i) => (some.length ? all.reduce((total, part) => total + Number(part[channel][i]), 0) : null)));
  return { x, at: x, measured: ofMeasurement, fit: ofFit ?? (fit ? sum : null), parts: all };
}

/** @type {Map<string, Promise<Sample[]>>} */
const tables = new Map();
/** The samples of a table. @param {string} path */
function samplesOf(path) {
  if (!tables.has(path)) tables.set(path, request(`${path}most=${MOST_SAMPLES}`).then(async (answer) => anglesOf(fromNpy(await answer.arrayBuffer()))));
  return /** @type {Promise<Sample[]>} */ (tables.get(path));
}

/** Where most samples are, in steps of five degrees. @param {string} path @param {"half" | "out"} along */
export async function mostAt(path, along) {
  const found = await samplesOf(path);
  const counts = Array.from({ length: 18 }, (_, i) => found.filter((one) => isNear(one, along, 5 * i)).length);
  return 5 * counts.indexOf(Math.max(...counts));
}

/** Whether a sample is shown at a place of a slider. @param {Sample} one @param {"half" | "out"} along @param {number} place */
function isNear(one, along, place) {
  return along === "half" ? Math.abs(one.diff - place) <= NEAR : Math.abs(one.light - place) <= NEAR && one.aside <= NEAR;
}

/** @param {ArrayLike<number>} table nine numbers each @returns {Sample[]} */
function anglesOf(table) {
  /** @param {number} sine @param {number} cosine */
  const degrees = (sine, cosine) => Math.atan2(sine, cosine) / rad;
  return Array.from({ length: table.length / 9 }, (_, i) => {
    const [a, b, c, d, e, f, ...values] = Array.from({ length: 9 }, (_, k) => table[9 * i + k]);
    const sum = Math.hypot(a + d, b + e, c + f);
    const flat = Math.hypot(a, b);
    const along = flat > 1e-6 ? a * d + b * e : -d || -e; // above 0 on the light's side; of light from the normal on that of phi = 180
    const out = degrees(Math.hypot(d, e), f) * (along > 0 ? -1 : 1);
    const aside = flat > 1e-6 ? Math.abs(degrees((b * d - a * e) / flat, Math.hypot(f, along / flat))) : 0;
    return { half: degrees(Math.hypot(a + d, b + e), c + f), diff: degrees(Math.hypot(a - d, b - e, c - f), sum), light: degrees(flat, c), out, aside, values };
  });
}

/** Puts the samples near a place into values. @param {Values} values @param {Subject} subject @param {"half" | "out"} along @param {number} place @returns {Promise<Values>} */
async function withSamples(values, { samples }, along, place) {
  if (!samples) return values;
  const near = (await samplesOf(samples)).filter((one) => isNear(one, along, place)).sort((a, b) => a[along] - b[along]);
  return { ...values, at: near.map((one) => one[along]), measured: [0, 1, 2].map((channel) => near.map((one) => one.values[channel])) };
}

/** Over theta_half at one theta_diff [degrees]: means over phi_diff, of what is above the horizon; samples near it. @param {Subject} subject @param {number} diff @param {boolean} withParts */
export async function profile(subject, diff, withParts) {
  const points = NODES.map((half) => AROUND.map((phi) => directions(half, diff, phi)).filter((pair) => pair[2] > 0 && pair[5] > 0));
  return withSamples(await valuesOf(subject, NODES, points, withParts), subject, "half", diff);
}

/** Over the viewer's angle in the plane of incidence, for one angle of the light [degrees]. @param {Subject} subject @param {number} light @param {boolean} withParts */
export async function planeOfIncidence(subject, light, withParts) {
  const points = IN_PLANE.map((out) => [[-light, out].flatMap((angle) => [Math.sin(angle * rad), 0, Math.cos(angle * rad)])]);
  return withSamples(await valuesOf(subject, IN_PLANE, points, withParts), subject, "out", light);
}
