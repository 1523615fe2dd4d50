// Fetches values of a fit, its components and its measurement along the curves of plots, and at a point of a sphere.
import { askArray, json } from "./app.js";

/** Samples farther from the angle of a slider are hidden. */
export const MAX_SAMPLE_DISTANCE_DEG = 3;
const MOST_SAMPLES = 4000;
const NODES = Array.from({ length: 90 }, (_, i) => (i * i) / 90); // Angles theta_half of the MERL grid, dense at the peak [degrees].
const MEAN_PHI_DIFF_DEG = [15, 45, 75, 105, 135, 165]; // Means are taken over these angles phi_diff.
const IN_PLANE = Array.from({ length: 179 }, (_, i) => i - 89); // Angles of the viewer, negative on the light's side [degrees].
const rad = Math.PI / 180;

/** @param {number} sine @param {number} cosine */
const degrees = (sine, cosine) => Math.atan2(sine, cosine) / rad;

/** Returns the cosines of both directions to the normal. @param {number[]} point theta_half, theta_diff, phi_diff [degrees] */
export function cosines([half, diff, phi]) {
  const along = Math.cos(half * rad) * Math.cos(diff * rad);
  const across = Math.sin(half * rad) * Math.sin(diff * rad) * Math.cos(phi * rad);
  return [along - across, along + across];
}

/** Returns the mean value of each list of points, over its points above the horizon. @param {string} path @param {number[][][]} places theta_half, theta_diff, phi_diff of points [degrees] @returns {Promise<Channels>} */
async function meansAt(path, places) {
  const points = places.flat();
  const [theta_half_deg, theta_diff_deg, phi_diff_deg] = [0, 1, 2].map((i) => points.map((point) => point[i]));
  const { values } = await json(path, "POST", { theta_half_deg, theta_diff_deg, phi_diff_deg });
  return [0, 1, 2].map((channel) => {
    let at = 0;
    return places.map((some) => {
      const known = some.map(() => values[at++]?.[channel]).filter((value) => value !== undefined);
      return known.length ? known.reduce((sum, value) => sum + value, 0) / known.length : null;
    });
  });
}

/** Returns the angle with the most samples, in steps of five degrees. @param {Sample[]} samples @param {"half" | "out"} along */
export function mostAt(samples, along) {
  const counts = Array.from({ length: 18 }, (_, i) => samples.filter((one) => isNear(one, along, 5 * i)).length);
  return 5 * counts.indexOf(Math.max(...counts));
}

/** Whether a sample is shown at a place of a slider. @param {Sample} one @param {"half" | "out"} along @param {number} place */
function isNear(one, along, place) {
  return along === "half" ? Math.abs(one.diff - place) <= MAX_SAMPLE_DISTANCE_DEG : Math.abs(one.light - place) <= MAX_SAMPLE_DISTANCE_DEG && one.aside <= MAX_SAMPLE_DISTANCE_DEG;
}

/** Fetches samples of a table, at most MOST_SAMPLES. @param {string} path @returns {Promise<Sample[]>} */
export async function samplesOf(path) {
  const table = await askArray(`${path}most=${MOST_SAMPLES}`); // A sample has nine numbers.
  return Array.from({ length: table.length / 9 }, (_, i) => {
    const [a, b, c, d, e, f, ...values] = Array.from({ length: 9 }, (_, k) => table[9 * i + k]);
    const flat = Math.hypot(a, b);
    const along = flat > 1e-6 ? a * d + b * e : -d || -e; // This is positive on the light's side; for light along the normal, on the side of phi = 180.
    const out = degrees(Math.hypot(d, e), f) * (along > 0 ? -1 : 1);
    const aside = flat > 1e-6 ? Math.abs(degrees((b * d - a * e) / flat, Math.hypot(f, along / flat))) : 0;
    return { ...halfAndDifference([a, b, c], [d, e, f]), light: degrees(flat, c), out, aside, values };
  });
}

/** Returns theta_half and theta_diff of directions [degrees]. @param {number[]} first @param {number[]} second */
function halfAndDifference(first, second) {
  const [x, y, z] = first.map((value, i) => value + second[i]);
  const apart = Math.hypot(...first.map((value, i) => value - second[i]));
  return { half: degrees(Math.hypot(x, y), z), diff: degrees(apart, Math.hypot(x, y, z)) };
}

/** Returns the values of a plot at a place of its slider [degrees]: over theta_half at one theta_diff, means over phi_diff; or over the
 * viewer's angle in the plane of incidence, for one angle of the light.
 * @param {Subject} subject @param {Sample[] | null} samples those near the place are shown @param {"half" | "out"} along
 * @param {number} place @param {boolean} withParts @returns {Promise<Values>} */
export async function valuesAt({ fit, measured, parts }, samples, along, place, withParts) {
  const x = along === "half" ? NODES : IN_PLANE;
  const places = along === "half"
    ? NODES.map((half) => MEAN_PHI_DIFF_DEG.map((phi) => [half, place, phi]).filter((point) => Math.min(...cosines(point)) > 0))
    : IN_PLANE.map((out) => [[Math.abs(out - place) / 2, Math.abs(out + place) / 2, 0]]);
  const near = samples?.filter((one) => isNear(one, along, place)).sort((a, b) => a[along] - b[along]);
  const [ofMeasurement, ofFit, ...ofParts] = await Promise.all([
    measured ? meansAt(`v1/measurements/${measured}/brdf`, places) : null,
    fit ? meansAt(`v1/fits/${fit}/brdf`, places) : null,
    ...(withParts ? parts : []).map(({ label }) => meansAt(`v1/fits/${fit}/components/${label}/brdf`, places)),
  ]);
  const ofSamples = near && [0, 1, 2].map((channel) => near.map((one) => one.values[channel]));
  return { x, at: near?.map((one) => one[along]) ?? x, measured: ofSamples ?? ofMeasurement, fit: ofFit, parts: /** @type {Channels[]} */ (ofParts) };
}

/** Returns the angles and values at a point of a sphere. @param {Subject} subject @param {number[]} point @param {number[]} light its direction */
export async function valuesBelow({ fit, measured }, [x, y], light) {
  const normal = [x, y, Math.sqrt(1 - x * x - y * y)];
  const flat = Math.hypot(normal[0], normal[2]);
  const along = [normal[2] / flat, 0, -normal[0] / flat];
  const aside = [normal[1] * along[2], normal[2] * along[0] - normal[0] * along[2], -normal[1] * along[0]];
  const [omega_in, omega_out] = [light, [0, 0, 1]].map((vector) => [along, aside, normal].map((axis) => axis.reduce((sum, value, i) => sum + value * vector[i], 0)));
  if (!(omega_in[2] > 0)) return "The light does not reach this point.";
  const { values: [value] } = await json(`v1/${fit ? `fits/${fit}` : `measurements/${measured}`}/brdf`, "POST", { omega_in: [omega_in], omega_out: [omega_out] });
  const { half, diff } = halfAndDifference(omega_in, omega_out);
  const said = value?.map((/** @type {number} */ one) => one.toPrecision(3)).join(", ");
  return `θ_half ${half.toFixed(1)}°, θ_diff ${diff.toFixed(1)}°: ${said ? `${said} 1/sr` : "not measured"}`;
}
