// Two plots as SVG of measured points, the fit and its components: profiles over theta_half at one theta_diff, and values
// in the plane of incidence for one direction of the light.
import { fill, find } from "./app.js";
import { classOf, showLegend, svg, tellValues } from "./legend.js";
import { LABELS } from "./sphere.js";
import { mostAt, NEAR, planeOfIncidence, profile } from "./values.js";

/** @typedef {import("./types").Subject} Subject */
/** @typedef {import("./types").Curve} Curve */
/** @typedef {import("./values.js").Values} Values */
/** @typedef {import("./values.js").Channels} Channels */
/** What a plot draws, and how it is to look. @typedef {{all: Values[], subjects: Subject[], place: number, channel: string, axis: string, range: string}} Drawing */

const CHANNELS = ["red", "green", "blue"];
const MARGIN = { left: 62, right: 14, top: 12, bottom: 42 };
const HEIGHT = 340;
const DECADES = [4, 7]; // of the logarithmic axis of the plane of incidence, below the largest value: at least, and at most
const SPACE = 34; // beside and below the half circle

/** @param {string} label */
const words = (label) => label.replace("_", " ");

/** What a plot draws: points and curves, each with a colour; in one channel a component has its own. @param {Drawing} drawing @returns {Curve[]} */
function curvesOf({ all, subjects, channel }) {
  const several = all.length > 1;
  return all.flatMap(({ x, at, fit, measured, parts }, i) => {
    const lead = several ? `${subjects[i].name}, ` : "";
    const colour = several ? ["part-0", "part-2"][i] : "ink";
    if (several || channel !== "all") {
      const c = channel === "all" ? 0 : Number(channel);
      return [
        ...(measured ? [{ label: `${lead}measured`, colour, points: true, x: at, y: measured[c] }] : []),
        ...parts.map(({ label, values }) => ({ label: words(label), colour: `part-${LABELS.indexOf(label)}`, x, y: values[c], part: true })),
        ...(fit ? [{ label: `${lead}fit`, colour, x, y: fit[c] }] : []),
      ];
    }
    /** @param {Channels} values @param {(name: string) => Omit<Curve, "x" | "y" | "colour"> & {x?: number[]}} more @returns {Curve[]} */
    const ofChannels = (values, more) => CHANNELS.map((name, c) => ({ colour: name, x, y: values[c], ...more(name) }));
    return [
      ...(measured ? ofChannels(measured, (name) => ({ label: `${name}, measured`, points: true, x: at })) : []),
      ...parts.flatMap(({ label, values }) => ofChannels(values, () => ({ label: words(label), dash: `part-${LABELS.indexOf(label)}`, part: true }))),
      ...(fit ? ofChannels(fit, (name) => ({ label: `${name}, fit` })) : []),
    ];
  });
}

/** @param {Curve} curve */
const positive = ({ y }) => /** @type {number[]} */ (y.filter((value) => value !== null && value > 0));

/** The bounds of the axes. @param {Drawing} drawing @param {Curve[]} series */
function limits({ all: [{ x, at, fit, measured }], axis, range }, series) {
  const curves = series.filter((one) => !one.part);
  const top = Math.max(...curves.flatMap(positive), 1e-6);
  const [shown, places] = fit ? [fit, x] : [/** @type {Channels} */ (measured ?? [[]]), at];
  const total = places.map((_, i) => shown.reduce((sum, curve) => sum + (curve[i] ?? 0), 0));
  const half = Math.max(...total) / 2;
  const width = places[total.findLastIndex((value) => value >= half)] ?? 90;
  const end = range === "peak" ? Math.min(Math.max(4 * width, 3), 90) : 90;
  const inside = curves.flatMap((one) => one.y.filter((value, i) => value !== null && value > 0 && one.x[i] <= end).map(Number));
  if (axis === "linear") return { end, low: 0, high: 1.06 * top };
  const low = Math.min(...inside.filter((value) => value > 1e-7 * top), top / 2);
  return { end, low: low / 1.6, high: 1.6 * top };
}

/** @param {number} high */
function linearTicks(high) {
  const raw = high / 5;
  const power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map((factor) => factor * power).find((candidate) => candidate >= raw) ?? raw;
  return Array.from({ length: Math.floor(high / step) + 1 }, (_, i) => i * step);
}

/** @param {number} low @param {number} high */
function logTicks(low, high) {
  const ticks = [];
  for (let power = Math.ceil(Math.log10(low)); power <= Math.floor(Math.log10(high)); power += 1) ticks.push(10 ** power);
  if (ticks.length >= 2) return ticks;
  const finer = ticks.concat([1, 2, 5].flatMap((f) => [-1, 0, 1].map((s) => f * 10 ** (Math.floor(Math.log10(high)) + s))));
  return [...new Set(finer)].filter((tick) => tick >= low && tick <= high).sort((a, b) => a - b);
}

/** @param {HTMLElement} box @param {Drawing} drawing */
function plotProfile(box, drawing) {
  const { axis, place } = drawing;
  const width = Math.max(box.clientWidth, 280);
  const series = curvesOf(drawing);
  const { end, low, high } = limits(drawing, series);
  const scale = axis === "log" ? Math.log : Number;
  const inner = { width: width - MARGIN.left - MARGIN.right, height: HEIGHT - MARGIN.top - MARGIN.bottom };
  /** @param {number} degrees */
  const px = (degrees) => MARGIN.left + (inner.width * degrees) / end;
  /** @param {number} value */
  const py = (value) => MARGIN.top + inner.height * (1 - (scale(value) - scale(low)) / (scale(high) - scale(low)));
  const picture = svg("svg", { viewBox: `0 0 ${width} ${HEIGHT}`, role: "img", "aria-label": `BRDF over theta_half at theta_diff ${place} degrees, ${axis} axis` });
  const clip = svg("clipPath", { id: "inside" });
  clip.append(svg("rect", { x: MARGIN.left, y: MARGIN.top, width: inner.width, height: inner.height }));
  picture.append(clip);
  const step = [0.5, 1, 2, 5, 10, 15, 30].find((candidate) => end / candidate <= (width < 500 ? 6 : 9)) ?? 30;
  for (let degrees = 0; degrees <= end + 1e-9; degrees += step) {
    picture.append(svg("path", { class: "grid", d: `M${px(degrees)} ${MARGIN.top}V${MARGIN.top + inner.height}` }));
    picture.append(svg("text", { x: px(degrees), y: HEIGHT - 24, "text-anchor": "middle" }, `${degrees}°`));
  }
  for (const tick of axis === "log" ? logTicks(low, high) : linearTicks(high)) {
    picture.append(svg("path", { class: "grid", d: `M${MARGIN.left} ${py(tick)}H${width - MARGIN.right}` }));
    const text = tick !== 0 && (tick < 0.01 || tick >= 1e4) ? tick.toExponential(0).replace("e+", "e") : String(Number(tick.toPrecision(3)));
    picture.append(svg("text", { x: MARGIN.left - 8, y: py(tick) + 4, "text-anchor": "end" }, text));
  }
  picture.append(svg("path", { class: "axis", d: `M${MARGIN.left} ${MARGIN.top}V${MARGIN.top + inner.height}H${width - MARGIN.right}` }));
  picture.append(svg("text", { x: MARGIN.left + inner.width / 2, y: HEIGHT - 6, "text-anchor": "middle" }, "θ half"));
  const middle = MARGIN.top + inner.height / 2;
  picture.append(svg("text", { x: 12, y: middle, "text-anchor": "middle", transform: `rotate(-90 12 ${middle})` }, "BRDF in 1/sr"));
  const group = svg("g", { "clip-path": "url(#inside)" });
  const floor = axis === "log" ? low / 100 : low - 1e9;
  for (const one of series) {
    const visible = one.y.flatMap((value, i) => (value !== null && one.x[i] <= 1.1 * end && (axis === "linear" || value > 0) ? [[px(one.x[i]), py(Math.max(value, floor))]] : []));
    group.append(svg("path", { class: classOf(one), d: one.points ? squares(visible, 6) : line(visible) }));
  }
  picture.append(group);
  box.replaceChildren(picture);
  showLegend(series, box);
  tellValues(picture, box, series, "θ_half", (x) => Math.max(((x - MARGIN.left) * end) / inner.width, 0));
}

/** @param {number[][]} places */
const line = (places) => places.map(([x, y], i) => `${i ? "L" : "M"}${x.toFixed(1)} ${y.toFixed(1)}`).join("");

/** Small squares, no nearer to each other than some pixels. @param {number[][]} places @param {number} apart */
function squares(places, apart) {
  let last = [-Infinity, 0];
  return places.filter((place) => {
    const far = Math.hypot(place[0] - last[0], place[1] - last[1]) >= apart;
    if (far) last = place;
    return far;
  }).map(([x, y]) => `M${(x - 2.5).toFixed(1)} ${(y - 2.5).toFixed(1)}h5v5h-5z`).join("");
}

/** @param {Curve[]} series @param {string} kind */
function radialAxis(series, kind) {
  const top = Math.max(...series.flatMap(positive), 1e-6);
  if (kind === "linear") return { share: (/** @type {number} */ value) => value / (1.04 * top), ticks: linearTicks(top).filter((tick) => tick > 0) };
  const end = Math.ceil(Math.log10(top));
  const usual = series.filter((one) => !one.part).flatMap(positive).sort((a, b) => a - b);
  const needed = end - Math.floor(Math.log10(Math.max(usual[usual.length >> 1], 1e-30))) + 1; // so that the ground is seen
  const decades = Math.min(Math.max(needed, DECADES[0]), DECADES[1]);
  const ticks = Array.from({ length: decades }, (_, i) => 10 ** (end - i));
  return { share: (/** @type {number} */ value) => Math.max(0, 1 - (end - Math.log10(Math.max(value, 1e-30))) / decades), ticks };
}

/** @param {HTMLElement} box @param {Drawing} drawing */
function plotPlane(box, drawing) {
  const { axis, place } = drawing;
  const width = Math.max(box.clientWidth, 280);
  const radius = Math.min(width / 2 - SPACE, 320);
  const middle = { x: width / 2, y: radius + SPACE };
  const series = curvesOf(drawing);
  const { share, ticks } = radialAxis(series, axis);
  /** @param {number} degrees @param {number} length */
  const at = (degrees, length) => {
    const angle = (degrees * Math.PI) / 180;
    return [middle.x + radius * length * Math.sin(angle), middle.y - radius * length * Math.cos(angle)];
  };
  const label = `BRDF in the plane of incidence for light at ${place} degrees, ${axis} axis`;
  const picture = svg("svg", { viewBox: `0 0 ${width} ${radius + 2 * SPACE}`, role: "img", "aria-label": label });
  for (const tick of ticks) {
    const r = radius * share(tick);
    picture.append(svg("path", { class: "grid", d: `M${middle.x - r} ${middle.y}A${r} ${r} 0 0 1 ${middle.x + r} ${middle.y}` }));
    picture.append(svg("text", { x: middle.x + r, y: middle.y + 16, "text-anchor": "middle" }, String(Number(tick.toPrecision(2)))));
  }
  for (let degrees = -90; degrees <= 90; degrees += 30) {
    picture.append(svg("path", { class: "grid", d: line([at(degrees, 0), at(degrees, 1)]) }));
    const [x, y] = at(degrees, 1.07);
    picture.append(svg("text", { x, y: y + 4, "text-anchor": "middle" }, `${Math.abs(degrees)}°`));
  }
  picture.append(svg("path", { class: "axis", d: line([at(-90, 1), at(90, 1)]) }));
  picture.append(svg("path", { class: "light", d: line([at(-place, 1), at(0, 0)]) }));
  for (const one of series) {
    const places = one.y.flatMap((value, i) => (value === null ? [] : [at(one.x[i], share(value))]));
    picture.append(svg("path", { class: classOf(one), d: one.points ? squares(places, 8) : line(places) }));
  }
  box.replaceChildren(picture);
  showLegend(series, box);
  tellValues(picture, box, series, "θ_out", (x, y) => (Math.atan2(x - middle.x, middle.y - y) * 180) / Math.PI);
}

/**
 * Fetches what belongs to the place of a slider and draws it, whenever the slider, a choice or the width changes.
 * @param {HTMLElement} panel @param {Subject[]} subjects
 * @param {(subject: Subject, place: number, withParts: boolean) => Promise<Values>} fetchValues
 * @param {(box: HTMLElement, drawing: Drawing) => void} plot
 */
function followSlider(panel, subjects, fetchValues, plot) {
  const [input, box, fault] = [find(panel, "input[type=range]", HTMLInputElement), find(panel, ".plot"), find(panel, ".fault")];
  /** @type {Map<string, Values[]>} */
  const known = new Map();
  let busy = false;
  /** @param {string} name */
  const choice = (name) => /** @type {HTMLInputElement | null} */ (panel.querySelector(`input[name$="${name}"]:checked`))?.value ?? "all";

  async function show() {
    find(panel, ".wide output").textContent = `${input.value}°`;
    if (busy) return;
    busy = true;
    try {
      let wanted = input.value;
      do { // the slider may move on while an answer is on its way
        wanted = input.value;
        if (!known.has(wanted)) known.set(wanted, await Promise.all(subjects.map((one) => fetchValues(one, Number(wanted), subjects.length < 2))));
      } while (wanted !== input.value);
      fault.hidden = true;
      const all = /** @type {Values[]} */ (known.get(wanted));
      const table = all.some(({ measured }) => measured?.[0].length) ? null : subjects.find(({ samples }) => samples)?.samples;
      fill(panel, { near: table ? `There is none here; most are at ${await mostAt(table, fetchValues === profile ? "diff" : "light")}°.` : "" });
      plot(box, { all, subjects, place: Number(wanted), channel: choice("channel"), axis: choice("axis"), range: choice("range") });
    } catch (error) {
      fault.hidden = false;
      fault.textContent = /** @type {Error} */ (error).message;
    } finally {
      busy = false;
    }
  }

  input.addEventListener("input", show);
  panel.addEventListener("change", show);
  let width = 0;
  new ResizeObserver(() => {
    if (box.clientWidth === width) return;
    width = box.clientWidth;
    show();
  }).observe(box);
}

/** What the marks in the plots of some subjects mean. @param {Subject[]} subjects */
function marks(subjects) {
  const samples = subjects.some((one) => one.samples) ? `points are samples within ${NEAR}°` : "";
  const measured = subjects.some((one) => one.measured) ? "points are measured" : samples;
  const fits = subjects.some((one) => one.fit) ? "full lines are the fit" : "";
  const parts = subjects.length < 2 && subjects[0].labels.length ? "the others its components" : "";
  const sentence = [measured, fits, parts].filter(Boolean).join(", ");
  return sentence ? `${sentence[0].toUpperCase()}${sentence.slice(1)}.` : "";
}

/** Draws the plots of one subject, or the profiles of two. @param {HTMLElement} box @param {Subject[]} subjects */
export function startPlots(box, subjects) {
  fill(box, { marks: marks(subjects) });
  followSlider(find(box, "#profiles-panel"), subjects, profile, plotProfile);
  if (subjects.length < 2) followSlider(find(box, "#polar-panel"), subjects, planeOfIncidence, plotPlane);
}
