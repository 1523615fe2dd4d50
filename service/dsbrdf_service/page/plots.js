// Plots as SVG of measured points, the fit and its components: profiles over theta_half at one theta_diff, and values in
// the plane of incidence for one direction of the light. The legend says the values below the pointer.
import { fill, find, make } from "./app.js";
import { words } from "./said.js";
import { LABELS } from "./sphere.js";
import { mostAt, NEAR, planeOfIncidence, profile } from "./values.js";

/** What a plot draws, and how it is to look. @typedef {{all: Values[], subjects: Subject[], place: number, channel: string, axis: string, range: string}} Drawing */
/** @typedef {{along: "half" | "out", start: number, values: typeof profile, about: (place: number) => string}} Kind */

/** @type {Record<string, Kind>} */
const KINDS = {
  profiles: { along: "half", start: 0, values: profile, about: (place) => `BRDF over theta_half at theta_diff ${place} degrees` },
  plane: { along: "out", start: -90, values: planeOfIncidence, about: (place) => `BRDF in the plane of incidence for light at ${place} degrees` },
};
const CHANNELS = ["red", "green", "blue"];
const MARGIN = { left: 62, right: 14, top: 12, bottom: 42 };
const HEIGHT = 340;
const APART = 6; // pixels between marks at least

/** @param {string} name @param {Record<string, string | number>} attributes @param {(Node | string)[]} content */
function svg(name, attributes, ...content) {
  const made = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, String(value));
  made.append(...content);
  return made;
}

/** The points and curves of a plot. In one channel a component has a colour of its own, and a band for the range of its albedo. @param {Drawing} drawing @returns {Curve[]} */
function curvesOf({ all, subjects, channel }) {
  const several = all.length > 1;
  const shown = several || channel !== "all" ? [Number(channel) || 0] : [0, 1, 2];
  const alone = shown.length === 1;
  return all.flatMap(({ x, at, fit, measured, parts }, i) => shown.flatMap((c) => {
    const lead = several ? `${subjects[i].name}, ` : alone ? "" : `${CHANNELS[c]}, `;
    const colour = several ? ["part-0", "part-2"][i] : alone ? "ink" : CHANNELS[c];
    const components = parts.map((values, k) => {
      const { label, albedo, ranges } = subjects[i].parts[k];
      const own = `part-${LABELS.indexOf(label)}`;
      const band = /** @type {Interval} */ (ranges.albedo[c].map((end) => end / albedo[c]));
      return { label: words(label), part: true, x, y: values[c], ...(alone ? { colour: own, band } : { colour, dash: own }) };
    });
    return [
      ...(measured ? [{ label: `${lead}measured`, colour, points: true, x: at, y: measured[c] }] : []),
      ...components,
      ...(fit ? [{ label: `${lead}fit`, colour, x, y: fit[c] }] : []),
    ];
  }));
}

/** The bounds of the axes. @param {Kind} kind @param {Drawing} drawing @param {Curve[]} curves */
function limits({ start }, { all: [{ x, fit }], axis, range }, curves) {
  const whole = curves.filter((one) => !one.part);
  const top = Math.max(...whole.flatMap(({ y }) => y.map(Number)), 1e-6);
  const total = x.map((_, i) => (fit ?? []).reduce((sum, values) => sum + (values[i] ?? 0), 0));
  const width = x[total.findLastIndex((value) => value >= Math.max(...total) / 2)] ?? 90;
  const end = range === "peak" ? Math.min(Math.max(4 * width, 3), 90) : 90;
  if (axis === "linear") return { start, end, low: 0, high: 1.06 * top };
  const inside = whole.flatMap((one) => one.y.filter((value, i) => Number(value) > 1e-7 * top && one.x[i] <= end).map(Number));
  return { start, end, low: Math.min(...inside, top / 2) / 1.6, high: 1.6 * top };
}

/** Round numbers between the bounds of an axis. @param {number} low @param {number} high @param {string} axis */
function ticksOf(low, high, axis) {
  const power = 10 ** Math.floor(Math.log10(high));
  if (axis === "linear") {
    const step = [0.1, 0.2, 0.5, 1, 2].map((factor) => factor * power).find((candidate) => candidate >= high / 6) ?? power;
    return Array.from({ length: Math.floor(high / step) + 1 }, (_, i) => i * step);
  }
  const powers = Array.from({ length: 12 }, (_, i) => power / 10 ** i);
  const inside = [powers, powers.flatMap((one) => [one, 2 * one, 5 * one])].map((ticks) => ticks.filter((tick) => tick >= low && tick <= high));
  return inside[0].length >= 2 ? inside[0] : inside[1];
}

/** @param {HTMLElement} panel @param {Kind} kind @param {Drawing} drawing */
function plot(panel, kind, drawing) {
  const { axis, place } = drawing;
  const width = Math.max(find(panel, ".plot").clientWidth, 280);
  const curves = curvesOf(drawing);
  const { start, end, low, high } = limits(kind, drawing, curves);
  const [right, bottom] = [width - MARGIN.right, HEIGHT - MARGIN.bottom];
  const scale = axis === "log" ? Math.log : Number;
  /** @param {number} degrees */
  const px = (degrees) => MARGIN.left + ((right - MARGIN.left) * (degrees - start)) / (end - start);
  /** @param {number} value */
  const py = (value) => bottom - ((bottom - MARGIN.top) * (scale(Math.max(value, low / 100)) - scale(low))) / (scale(high) - scale(low));
  const clip = svg("clipPath", { id: `inside-${panel.id}` }, svg("rect", { x: MARGIN.left, y: MARGIN.top, width: right - MARGIN.left, height: bottom - MARGIN.top }));
  const picture = svg("svg", { viewBox: `0 0 ${width} ${HEIGHT}`, role: "img", "aria-label": `${kind.about(place)}, ${axis} axis` }, clip);
  const step = [0.5, 1, 2, 5, 10, 15, 30].find((candidate) => (end - start) / candidate <= (width < 500 ? 6 : 12)) ?? 30;
  for (let degrees = start; degrees <= end + 1e-9; degrees += step) {
    picture.append(svg("path", { class: "grid", d: `M${px(degrees)} ${MARGIN.top}V${bottom}` }), svg("text", { x: px(degrees), y: bottom + 18, "text-anchor": "middle" }, `${degrees}°`));
  }
  for (const tick of ticksOf(low, high, axis)) {
    const text = tick !== 0 && (tick < 0.01 || tick >= 1e4) ? tick.toExponential(0).replace("e+", "e") : String(Number(tick.toPrecision(3)));
    picture.append(svg("path", { class: "grid", d: `M${MARGIN.left} ${py(tick)}H${right}` }), svg("text", { x: MARGIN.left - 8, y: py(tick) + 4, "text-anchor": "end" }, text));
  }
  const middle = (MARGIN.top + bottom) / 2;
  picture.append(
    svg("path", { class: "axis", d: `M${MARGIN.left} ${MARGIN.top}V${bottom}H${right}` }),
    svg("text", { x: (MARGIN.left + right) / 2, y: HEIGHT - 6, "text-anchor": "middle" }, `θ ${kind.along}`),
    svg("text", { x: 12, y: middle, "text-anchor": "middle", transform: `rotate(-90 12 ${middle})` }, "BRDF in 1/sr"),
    ...(start < 0 ? [svg("path", { class: "light", d: `M${px(-place)} ${MARGIN.top}V${bottom}` })] : []),
  );
  const group = svg("g", { "clip-path": `url(#inside-${panel.id})` });
  for (const one of curves) {
    /** @param {number} factor */
    const places = (factor) => one.y.flatMap((value, i) => (value !== null && (axis === "linear" || value > 0) ? [[px(one.x[i]), py(value * factor)]] : []));
    if (one.band) group.append(svg("path", { class: `band c-${one.colour}`, d: `${line([...places(one.band[0]), ...places(one.band[1]).reverse()])}Z` }));
    group.append(svg("path", { class: classOf(one), d: one.points ? squares(places(1)) : line(places(1)) }));
  }
  picture.append(group);
  find(panel, ".plot").replaceChildren(picture);
  showLegend(panel, curves);
  picture.addEventListener("pointermove", (event) => {
    const { left, width: shown } = picture.getBoundingClientRect();
    const x = ((/** @type {PointerEvent} */ (event).clientX - left) * width) / shown;
    tellValues(panel, curves, `θ_${kind.along}`, start + ((end - start) * (x - MARGIN.left)) / (right - MARGIN.left));
  });
  picture.addEventListener("pointerleave", () => showLegend(panel, curves));
}

/** @param {Curve} curve */
const classOf = ({ points, colour, dash }) => `${points ? "point" : "curve"} c-${colour} ${dash ? `dash-${dash}` : ""}`;

/** @param {number[][]} places */
const line = (places) => (places.length ? `M${places.map(([x, y]) => `${x.toFixed(1)} ${y.toFixed(1)}`).join("L")}` : "");

/** Small squares, no nearer to each other than some pixels. @param {number[][]} places */
function squares(places) {
  let last = [-Infinity, 0];
  return places.filter(([x, y]) => {
    const isFar = Math.hypot(x - last[0], y - last[1]) >= APART;
    if (isFar) last = [x, y];
    return isFar;
  }).map(([x, y]) => `M${(x - 2.5).toFixed(1)} ${(y - 2.5).toFixed(1)}h5v5h-5z`).join("");
}

/** Where a component is drawn in three channels, its dashes are shown once. @param {HTMLElement} panel @param {Curve[]} curves */
function showLegend(panel, curves) {
  const items = curves.filter((one, i) => curves.findIndex(({ label }) => label === one.label) === i).map((one) => {
    const look = svg("path", { class: classOf(one.dash ? { ...one, colour: "ink" } : one), d: one.points ? "M12 3h6v6h-6z" : "M1 6H29" });
    return make("li", { "data-label": one.label }, svg("svg", { viewBox: "0 0 30 12", "aria-hidden": "true" }, look), one.label, make("b"));
  });
  find(panel, ".legend").replaceChildren(...items, make("li"));
}

/** Says in the legend the values of all curves at an angle. @param {HTMLElement} panel @param {Curve[]} curves @param {string} name @param {number} degrees */
function tellValues(panel, curves, name, degrees) {
  for (const item of /** @type {NodeListOf<HTMLElement>} */ (panel.querySelectorAll(".legend [data-label]"))) {
    const values = curves.filter(({ label }) => label === item.dataset.label).map(({ x, y }) => {
      const near = x.reduce((best, value, i) => (Math.abs(value - degrees) < Math.abs(x[best] - degrees) ? i : best), 0);
      return y[near]?.toPrecision(3) ?? "no value";
    });
    find(item, "b").textContent = ` ${values.join(", ")}`;
  }
  find(panel, ".legend li:last-child").textContent = `at ${name} ${degrees.toFixed(1)}°`;
}

/** Fetches what belongs to the place of a slider and draws it, whenever the slider, a choice or the width changes. @param {HTMLElement} panel @param {Subject[]} subjects */
async function followSlider(panel, subjects) {
  const kind = KINDS[panel.id];
  const [input, box] = [find(panel, "input[type=range]", HTMLInputElement), find(panel, ".plot")];
  const samples = subjects.find((one) => one.samples)?.samples;
  /** @type {Map<string, Values[]>} */
  const known = new Map();
  let busy = false;
  /** @param {string} name */
  const choice = (name) => /** @type {HTMLInputElement | null} */ (panel.querySelector(`input[name$="${name}"]:checked`))?.value ?? "";
  const show = async () => {
    find(panel, ".wide output").textContent = `${input.value}°`;
    if (busy || !box.isConnected) return;
    busy = true;
    try {
      let place = "";
      do { // the slider may move on while an answer is on its way
        place = input.value;
        if (!known.has(place)) known.set(place, await Promise.all(subjects.map((one) => kind.values(one, Number(place), subjects.length < 2))));
      } while (place !== input.value);
      const all = /** @type {Values[]} */ (known.get(place));
      const isEmpty = samples && !all.some(({ measured }) => measured?.[0].length);
      fill(panel, { near: isEmpty ? `There are no samples here; most are at ${await mostAt(samples, kind.along)}°.` : "" });
      plot(panel, kind, { all, subjects, place: Number(place), channel: choice("channel"), axis: choice("axis"), range: choice("range") });
    } finally {
      busy = false;
    }
  };
  input.oninput = panel.onchange = show;
  if (samples && !location.hash.includes(`${input.name}=`)) input.value = input.defaultValue = String(await mostAt(samples, kind.along));
  let width = 0;
  new ResizeObserver(() => {
    if (box.clientWidth === width) return undefined;
    width = box.clientWidth;
    return show();
  }).observe(box);
}

/** What the marks in the plots of some subjects mean. @param {Subject[]} subjects */
function marks(subjects) {
  const [{ fit, measured, samples, parts }] = subjects;
  const points = subjects.some((one) => one.measured) || measured ? "points are measured" : samples ? `points are samples within ${NEAR}°` : "";
  const components = subjects.length < 2 && parts.length > 0;
  const sentence = [points, fit ? "full lines are the fit" : "", components ? "the other lines its components" : ""].filter(Boolean).join(", ");
  return `${sentence[0]?.toUpperCase() ?? ""}${sentence.slice(1)}. ${components ? "When one channel is shown, bands are the ranges of the components' albedo." : ""}`;
}

/** Draws the plots that are in a box. @param {HTMLElement} box @param {Subject[]} subjects */
export async function startPlots(box, subjects) {
  fill(box, { marks: marks(subjects) });
  await Promise.all([...box.querySelectorAll("section")].map((panel) => followSlider(panel, subjects)));
}
