// Values of a fit, its components and its measurement along the lines of the plots.
import { Problem, request } from "./app.js";
import { fromNpy, toNpy } from "./npy.js";

/** @typedef {import("./types").Subject} Subject */
/** Values by channel, then place; null where there is none. @typedef {(number | null)[][]} Channels */
/** Samples are at places of their own. @typedef {{x: number[], fit: Channels | null, parts: {label: string, values: Channels}[], measured: Channels | null, at: number[]}} Values */
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

/** @param {string} path @param {number[]} points six numbers each @returns {Promise<ArrayLike<number>>} three numbers each */
async function valuesAt(path, points) {
  const headers = { "Content-Type": "application/x-npy", Accept: "application/x-npy" };
  const body = toNpy([points.length / 6, 6], Float64Array.from(points));
  return fromNpy(await (await request(path, { method: "POST", headers, body })).arrayBuffer());
}

/**
 * Values of all that a plot shows, for some points at each place, of which it shows the mean; parts add up to the fit.
 * @param {Subject} subject @param {number[]} x @param {number[][][]} points by place @param {boolean} withParts @returns {Promise<Values>}
 */
async function valuesOf({ fit, measured, labels }, x, points, withParts) {
  const [flat, counts] = [points.flat(2), points.map((some) => some.length)];
  /** @param {ArrayLike<number>} values @returns {Channels} */
  const means = (values) => [0, 1, 2].map((channel) => {
    let at = 0;
    return counts.map((count) => {
      const some = Array.from({ length: count }, (_, i) => values[3 * (at + i) + channel]).filter((value) => !Number.isNaN(value));
      at += count;
      return some.length ? some.reduce((sum, value) => sum + value, 0) / some.length : null;
    });
  });
  /** @param {string} path */
  const asked = async (path) => means(await valuesAt(path, flat));
  const shown = withParts ? labels : [];
  const found = await Promise.all([
    measured ? asked(`v1/measurements/${measured}/brdf`).catch(gone) : null,
    fit && !shown.length ? asked(`v1/fits/${fit}/brdf`) : null,
    ...shown.map((label) => asked(`v1/fits/${fit}/components/${label}/brdf`)),
  ]);
  const parts = shown.map((label, i) => ({ label, values: /** @type {Channels} */ (found[i + 2]) }));
  const sum = [0, 1, 2].map((channel) => x.map((_, i) => (counts[i] ? parts.reduce((total, part) => total + Number(part.values[channel][i]), 0) : null)));
  return { x, at: x, measured: found[0], fit: fit ? found[1] ?? sum : null, parts };
}

/** A measurement may be deleted while its fit is looked at. @param {unknown} error */
function gone(error) {
  if (error instanceof Problem && error.status === 404) return null;
  throw error;
}

/** @type {Map<string, Promise<Sample[]>>} */
const tables = new Map();
/** The samples of a table. @param {string} path */
function samplesOf(path) {
  if (!tables.has(path)) tables.set(path, request(`${path}?most=${MOST_SAMPLES}`).then(async (answer) => anglesOf(fromNpy(await answer.arrayBuffer()))));
  return /** @type {Promise<Sample[]>} */ (tables.get(path));
}

/** Where most samples are, in whole steps of a slider of a plot. @param {string} path @param {"diff" | "light"} along */
export async function mostAt(path, along) {
  const found = await samplesOf(path);
  const counts = Array.from({ length: 18 }, (_, i) => found.filter((one) => Math.abs(one[along] - 5 * i) <= NEAR && (along === "diff" || one.aside <= NEAR)).length);
  return 5 * counts.indexOf(Math.max(...counts));
}

/** @param {ArrayLike<number>} table nine numbers each @returns {Sample[]} */
function anglesOf(table) {
  /** @param {number} cosine */
  const degrees = (cosine) => Math.acos(Math.max(-1, Math.min(cosine, 1))) / rad;
  return Array.from({ length: table.length / 9 }, (_, i) => {
    const [a, b, c, d, e, f, ...values] = Array.from({ length: 9 }, (_, k) => table[9 * i + k]);
    const [half, flat] = [Math.hypot(a + d, b + e, c + f), Math.hypot(a, b)];
    return {
      half: degrees((c + f) / half), diff: degrees(half / 2), light: degrees(c),
      out: degrees(f) * (a * d + b * e > 0 ? -1 : 1), aside: flat > 1e-9 ? Math.abs(Math.asin(Math.max(-1, Math.min((b * d - a * e) / flat, 1)))) / rad : 0, values,
    };
  });
}

/** Puts the samples that are near into values. @param {Values} values @param {Subject} subject @param {(one: Sample) => boolean} isNear @param {"half" | "out"} along @returns {Promise<Values>} */
async function withSamples(values, { samples }, isNear, along) {
  if (!samples) return values;
  const near = (await samplesOf(samples)).filter(isNear).sort((a, b) => a[along] - b[along]);
  return { ...values, at: near.map((one) => one[along]), measured: [0, 1, 2].map((channel) => near.map((one) => one.values[channel])) };
}

/** Over theta_half at one theta_diff [degrees]: means over phi_diff, of what is above the horizon; samples near it. @param {Subject} subject @param {number} diff @param {boolean} withParts */
export async function profile(subject, diff, withParts) {
  const points = NODES.map((half) => AROUND.map((phi) => directions(half, diff, phi)).filter((pair) => pair[2] > 0 && pair[5] > 0));
  return withSamples(await valuesOf(subject, NODES, points, withParts), subject, (one) => Math.abs(one.diff - diff) <= NEAR, "half");
}

/** Over the viewer's angle in the plane of incidence, for one angle of the light [degrees]. @param {Subject} subject @param {number} light @param {boolean} withParts */
export async function planeOfIncidence(subject, light, withParts) {
  const into = [Math.sin(-light * rad), 0, Math.cos(light * rad)];
  const found = await valuesOf(subject, IN_PLANE, IN_PLANE.map((out) => [[...into, Math.sin(out * rad), 0, Math.cos(out * rad)]]), withParts);
  return withSamples(found, subject, (one) => Math.abs(one.light - light) <= NEAR && one.aside <= NEAR, "out");
}
