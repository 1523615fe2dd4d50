// An example to try: samples of a synthetic blue paint, GGX over a diffuse ground, as a table.
import { cosines } from "./values.js";

const [ALPHA, F0, COLOUR] = [0.15, 0.045, [0.08, 0.16, 0.42]];

/** Returns the value of the highlight [1/sr]. @param {number[]} point half and difference angles [degrees] */
function highlight(point) {
  const [half, diff] = point.map((degrees) => Math.cos((degrees * Math.PI) / 180));
  const distribution = ALPHA ** 2 / (Math.PI * (half ** 2 * (ALPHA ** 2 - 1) + 1) ** 2);
  const [inward, outward] = cosines(point).map((cosine) => cosine + Math.sqrt(ALPHA ** 2 + (1 - ALPHA ** 2) * cosine ** 2)); // cosines with masking and shadowing
  return (distribution * (F0 + (1 - F0) * (1 - diff) ** 5)) / (inward * outward);
}

/** Makes the table as a file. */
export function examplePaint() {
  const halves = Array.from({ length: 27 }, (_, step) => step ** 2 / 8);
  const points = halves.flatMap((half) => [0, 10, 20, 30, 40, 50, 60, 65, 70, 75].flatMap((diff) => [15, 45, 75, 105, 135, 165].map((phi) => [half, diff, phi])));
  const rows = points.filter((point) => Math.min(...cosines(point)) >= 0.1).map((point) => [...point, ...COLOUR.map((albedo) => albedo / Math.PI + highlight(point))].join());
  return new File([["theta_half,theta_diff,phi_diff,red,green,blue", ...rows].join("\n")], "example paint.csv", { type: "text/csv" });
}
