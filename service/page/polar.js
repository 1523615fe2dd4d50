// Reflectance in the plane of incidence for one direction of the light, as a polar plot in SVG.
import { choice, classOf, element, followSlider, linearTicks, seriesOf, showLegend } from "./profiles.js";

const DECADES = [4, 7]; // of the logarithmic axis, below the largest value: at least, and at most
const SPACE = 34; // beside and below the half circle

function radialAxis(series, kind) {
  const top = Math.max(...series.flatMap((one) => one.y), 1e-6);
  if (kind === "linear") {
    const ticks = linearTicks(top).filter((tick) => tick > 0);
    return { share: (value) => value / (1.04 * top), ticks };
  }
  const end = Math.ceil(Math.log10(top));
  const usual = series.filter((one) => !one.part).flatMap((one) => one.y).sort((a, b) => a - b);
  const needed = end - Math.floor(Math.log10(Math.max(usual[usual.length >> 1], 1e-30))) + 1; // so that the ground is seen
  const decades = Math.min(Math.max(needed, DECADES[0]), DECADES[1]);
  const ticks = Array.from({ length: decades }, (_, i) => 10 ** (end - i));
  return { share: (value) => Math.max(0, 1 - (end - Math.log10(Math.max(value, 1e-30))) / decades), ticks };
}

function plot(box, data, kind, channel) {
  const width = Math.max(box.clientWidth, 280);
  const radius = Math.min(width / 2 - SPACE, 320);
  const height = radius + 2 * SPACE;
  const middle = { x: width / 2, y: height - SPACE };
  const series = seriesOf(data, channel);
  const { share, ticks } = radialAxis(series, kind);
  const at = (degrees, length) => {
    const angle = (degrees * Math.PI) / 180;
    return [middle.x + radius * length * Math.sin(angle), middle.y - radius * length * Math.cos(angle)];
  };
  const path = (points) => points.map(([x, y], i) => `${i ? "L" : "M"}${x.toFixed(1)} ${y.toFixed(1)}`).join("");
  const label = `BRDF in the plane of incidence for light at ${data.theta_in_deg} degrees, ${kind} axis`;
  const svg = element("svg", { viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": label });
  for (const tick of ticks) {
    const r = radius * share(tick);
    svg.append(element("path", { class: "grid", d: `M${middle.x - r} ${middle.y}A${r} ${r} 0 0 1 ${middle.x + r} ${middle.y}` }));
    svg.append(element("text", { x: middle.x + r, y: middle.y + 16, "text-anchor": "middle" }, String(Number(tick.toPrecision(2)))));
  }
  for (let degrees = -90; degrees <= 90; degrees += 30) {
    svg.append(element("path", { class: "grid", d: path([at(degrees, 0), at(degrees, 1)]) }));
    const [x, y] = at(degrees, 1.07);
    svg.append(element("text", { x, y: y + 4, "text-anchor": "middle" }, `${Math.abs(degrees)}°`));
  }
  svg.append(element("path", { class: "axis", d: path([at(-90, 1), at(90, 1)]) }));
  svg.append(element("path", { class: "light", d: path([at(-data.theta_in_deg, 1), at(0, 0)]) }));
  for (const one of series) {
    const places = one.y.map((value, i) => at(data.theta_out_deg[i], share(value)));
    const squares = () => places.filter((_, i) => i % 3 === 1).map(([x, y]) => `M${(x - 2.5).toFixed(1)} ${(y - 2.5).toFixed(1)}h5v5h-5z`);
    svg.append(element("path", { class: classOf(one), d: one.points ? squares().join("") : path(places) }));
  }
  box.replaceChildren(svg);
  showLegend(series, box);
}

export function startPolar(id) {
  const draw = (box, data) => plot(box, data, choice("polar-axis"), choice("polar-channel"));
  followSlider({ slider: "theta-in", panel: "polar", box: "polar-plot", address: `fits/${id}/polar`, draw });
}
