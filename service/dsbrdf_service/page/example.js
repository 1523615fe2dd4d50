// An example to try: samples of a synthetic blue paint, GGX over a diffuse ground, as a table.
import { directions } from "./values.js";

const [ALPHA, F0, COLOUR] = [0.15, 0.045, [0.08, 0.16, 0.42]];

/** The value of the highlight [1/sr]. @param {number[]} pair of directions */
function highlight([a, b, c, d, e, f]) {
  const length = Math.hypot(a + d, b + e, c + f);
  const distribution = ALPHA ** 2 / (Math.PI * (((c + f) / length) ** 2 * (ALPHA ** 2 - 1) + 1) ** 2);
  const reflectance = F0 + (1 - F0) * (1 - Math.min(length / 2, 1)) ** 5;
  const [inward, outward] = [c, f].map((cosine) => cosine + Math.sqrt(ALPHA ** 2 + (1 - ALPHA ** 2) * cosine ** 2)); // its shadows
  return (distribution * reflectance) / (inward * outward);
}

/** The table as a file. */
export function examplePaint() {
  const rows = ["omega_in_x,omega_in_y,omega_in_z,omega_out_x,omega_out_y,omega_out_z,red,green,blue"];
  for (let step = 0; step <= 26; step += 1) {
    for (let diff = 0; diff <= 75; diff += 7.5) {
      for (let phi = 15; phi < 180; phi += 30) {
        const pair = directions(step ** 2 / 8, diff, phi);
        const values = COLOUR.map((albedo) => albedo / Math.PI + highlight(pair));
        if (Math.min(pair[2], pair[5]) >= 0.1) rows.push([...pair, ...values].map((value) => value.toPrecision(7)).join());
      }
    }
  }
  return new File([rows.join("\n")], "example paint.csv", { type: "text/csv" });
}
