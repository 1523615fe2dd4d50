// Two plots as SVG of measured points, the fit and its components: profiles over theta_half at one theta_diff, and
// values in the plane of incidence for one direction of the light.
const root = document.documentElement.dataset.root;
const SVG = "http://www.w3.org/2000/svg";
const CHANNELS = ["red", "green", "blue"];
const MARGIN = { left: 62, right: 14, top: 12, bottom: 42 };
const HEIGHT = 340;

function element(name, attributes, text) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  if (text !== undefined) made.textContent = text;
  return made;
}

function choice(name) {
  return document.querySelector(`input[name="${name}"]:checked`).value;
}

// What a plot draws: points and curves, each with a class for its colour; in one channel a component has its own colour.
function seriesOf({ fit, measured, components, both }, channel) {
  if (both) {
    return both.flatMap((one, i) => {
      const [label, colour, c] = [document.querySelectorAll(".side-name")[i].textContent, ["part-0", "part-2"][i], Number(channel)];
      const points = one.measured ? [{ label: `${label}, measured`, colour, points: true, y: one.measured[c] }] : [];
      return [...points, { label: `${label}, fit`, colour, y: one.fit[c] }];
    });
  }
  if (channel !== "all") {
    const c = Number(channel);
    const parts = components.map(({ label, place, values }) => ({ label: label.replace("_", " "), colour: `part-${place}`, y: values[c], part: true }));
    const points = measured ? [{ label: "measured", colour: "ink", points: true, y: measured[c] }] : [];
    return [...points, ...parts, { label: "fit", colour: "ink", y: fit[c] }];
  }
  const ofChannels = (values, more) => CHANNELS.map((name, c) => ({ colour: name, y: values[c], ...more(name) }));
  const points = measured ? ofChannels(measured, (name) => ({ label: `${name}, measured`, points: true })) : [];
  const parts = components.flatMap(({ label, place, values }) => ofChannels(values, () => ({ label: label.replace("_", " "), dash: `part-${place}`, part: true })));
  return [...points, ...parts, ...ofChannels(fit, (name) => ({ label: `${name}, fit` }))];
}

const classOf = ({ points, colour, dash }) => `${points ? "point" : "curve"} c-${colour} ${dash ? `dash-${dash}` : ""}`;

function limits(data, series, axis, range) {
  const curves = series.filter((one) => !one.part);
  const values = curves.flatMap((one) => one.y.filter((value) => value > 0));
  const top = Math.max(...values, 1e-6);
  const total = data.theta_half_deg.map((_, i) => data.fit.reduce((sum, curve) => sum + curve[i], 0));
  const half = Math.max(...total) / 2;
  const width = data.theta_half_deg[total.findLastIndex((value) => value >= half)] ?? 90;
  const end = range === "peak" ? Math.min(Math.max(4 * width, 3), 90) : 90;
  const inside = curves.flatMap((one) => one.y.filter((value, i) => value > 0 && one.x[i] <= end));
  if (axis === "linear") return { end, low: 0, high: 1.06 * top };
  const low = Math.min(...inside.filter((value) => value > 1e-7 * top), top / 2);
  return { end, low: low / 1.6, high: 1.6 * top };
}

function linearTicks(high) {
  const raw = high / 5;
  const power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map((factor) => factor * power).find((candidate) => candidate >= raw);
  return Array.from({ length: Math.floor(high / step) + 1 }, (_, i) => i * step);
}

function logTicks(low, high) {
  const ticks = [];
  for (let power = Math.ceil(Math.log10(low)); power <= Math.floor(Math.log10(high)); power += 1) ticks.push(10 ** power);
  if (ticks.length >= 2) return ticks;
  const finer = ticks.concat([1, 2, 5].flatMap((f) => [-1, 0, 1].map((s) => f * 10 ** (Math.floor(Math.log10(high)) + s))));
  return [...new Set(finer)].filter((tick) => tick >= low && tick <= high).sort((a, b) => a - b);
}

function plot(box, data, channel, axis, range) {
  const width = Math.max(box.clientWidth, 280);
  const series = seriesOf(data, channel).map((one) => ({ ...one, x: one.points ? data.node_theta_half_deg : data.theta_half_deg }));
  const { end, low, high } = limits(data, series, axis, range);
  const scale = axis === "log" ? Math.log : (value) => value;
  const inner = { width: width - MARGIN.left - MARGIN.right, height: HEIGHT - MARGIN.top - MARGIN.bottom };
  const px = (degrees) => MARGIN.left + (inner.width * degrees) / end;
  const py = (value) => MARGIN.top + inner.height * (1 - (scale(value) - scale(low)) / (scale(high) - scale(low)));
  const label = `BRDF over theta_half at theta_diff ${data.theta_diff_deg} degrees, ${axis} axis`;
  const svg = element("svg", { viewBox: `0 0 ${width} ${HEIGHT}`, role: "img", "aria-label": label });
  const clip = element("clipPath", { id: "inside" });
  clip.append(element("rect", { x: MARGIN.left, y: MARGIN.top, width: inner.width, height: inner.height }));
  svg.append(clip);
  const step = [0.5, 1, 2, 5, 10, 15, 30].find((candidate) => end / candidate <= (width < 500 ? 6 : 9)) ?? 30;
  for (let degrees = 0; degrees <= end + 1e-9; degrees += step) {
    svg.append(element("path", { class: "grid", d: `M${px(degrees)} ${MARGIN.top}V${MARGIN.top + inner.height}` }));
    svg.append(element("text", { x: px(degrees), y: HEIGHT - 24, "text-anchor": "middle" }, `${degrees}°`));
  }
  for (const tick of axis === "log" ? logTicks(low, high) : linearTicks(high)) {
    svg.append(element("path", { class: "grid", d: `M${MARGIN.left} ${py(tick)}H${width - MARGIN.right}` }));
    const text = tick !== 0 && (tick < 0.01 || tick >= 1e4) ? tick.toExponential(0).replace("e+", "e") : String(Number(tick.toPrecision(3)));
    svg.append(element("text", { x: MARGIN.left - 8, y: py(tick) + 4, "text-anchor": "end" }, text));
  }
  svg.append(element("path", { class: "axis", d: `M${MARGIN.left} ${MARGIN.top}V${MARGIN.top + inner.height}H${width - MARGIN.right}` }));
  svg.append(element("text", { x: MARGIN.left + inner.width / 2, y: HEIGHT - 6, "text-anchor": "middle" }, "θ half"));
  const middle = MARGIN.top + inner.height / 2;
  svg.append(element("text", { x: 12, y: middle, "text-anchor": "middle", transform: `rotate(-90 12 ${middle})` }, "BRDF in 1/sr"));
  const group = element("g", { "clip-path": "url(#inside)" });
  for (const one of series) draw(group, one, { px, py, low, axis, end });
  svg.append(group);
  box.replaceChildren(svg);
  showLegend(series, box);
  tellValues(svg, box, series, "θ_half", (x) => Math.max(((x - MARGIN.left) * end) / inner.width, 0));
}

function draw(group, one, { px, py, low, axis, end }) {
  const visible = one.y.map((value, i) => [one.x[i], value]).filter(([x, value]) => value !== null && x <= 1.1 * end && (axis === "linear" || value > 0));
  if (one.points) {
    let last = -Infinity;
    let d = "";
    for (const [x, value] of visible) {
      if (px(x) - last < 6) continue;
      last = px(x);
      d += `M${(px(x) - 2.5).toFixed(1)} ${(py(value) - 2.5).toFixed(1)}h5v5h-5z`;
    }
    group.append(element("path", { class: classOf(one), d }));
    return;
  }
  const floor = axis === "log" ? low / 100 : low - 1e9;
  const d = visible.map(([x, value], i) => `${i ? "L" : "M"}${px(x).toFixed(1)} ${py(Math.max(value, floor)).toFixed(1)}`).join("");
  group.append(element("path", { class: classOf(one), d }));
}

// The legend below a plot; where a component is drawn in three channels, its dashes are shown once.
function showLegend(series, box) {
  const items = series.filter((one, i) => series.findIndex(({ label }) => label === one.label) === i).map((one) => {
    const item = document.createElement("li");
    const svg = element("svg", { viewBox: "0 0 30 12", "aria-hidden": "true" });
    const look = classOf(one.dash ? { ...one, colour: "ink" } : one);
    svg.append(element("path", { class: look, d: one.points ? "M12 3h6v6h-6z" : "M1 6H29" }));
    item.append(svg, one.label, document.createElement("b"));
    item.dataset.label = one.label;
    return item;
  });
  document.getElementById(`${box.id}-legend`).replaceChildren(...items);
}

// Says in the legend the values of all curves at the angle below the pointer, which `angle` finds from its place.
function tellValues(svg, box, series, name, angle) {
  const legend = document.getElementById(`${box.id}-legend`);
  const where = document.createElement("li");
  const say = (degrees) => {
    legend.append(where);
    where.textContent = degrees === null ? "" : `at ${name} ${degrees.toFixed(1)}°`;
    for (const item of legend.querySelectorAll("[data-label]")) {
      const values = degrees === null ? [] : series.filter(({ label }) => label === item.dataset.label).map(({ x, y }) => {
        const near = x.reduce((best, value, i) => (Math.abs(value - degrees) < Math.abs(x[best] - degrees) ? i : best), 0);
        return y[near]?.toPrecision(3) ?? "no value";
      });
      item.querySelector("b").textContent = ` ${values.join(", ")}`;
    }
  };
  svg.addEventListener("pointermove", (event) => {
    const { left, top, width } = svg.getBoundingClientRect();
    const scale = svg.viewBox.baseVal.width / width;
    say(Math.max(-90, Math.min(angle((event.clientX - left) * scale, (event.clientY - top) * scale), 90)));
  });
  svg.addEventListener("pointerleave", () => say(null));
}

// Fetches what belongs to the place of a slider and draws it, whenever the slider, a choice or the width changes.
function followSlider({ slider, panel, box, addresses, draw }) {
  const [input, place, fault, output] = [slider, box, `${panel}-fault`, `${slider}-value`].map((name) => document.getElementById(name));
  const known = new Map();
  let busy = false;

  async function show() {
    output.textContent = `${input.value}°`;
    if (busy) return;
    busy = true;
    try {
      let wanted;
      do { // the slider may move on while an answer is on its way
        wanted = input.value;
        if (!known.has(wanted)) {
          const contents = await Promise.all(addresses.map(async (address) => {
            const answer = await fetch(`${root}${address}/${wanted}`);
            const content = await answer.json();
            if (!answer.ok) throw new Error(content.detail);
            return content;
          }));
          known.set(wanted, contents.length > 1 ? { ...contents[0], both: contents } : contents[0]);
        }
      } while (wanted !== input.value);
      fault.hidden = true;
      draw(place, known.get(wanted));
    } catch (error) {
      fault.hidden = false;
      fault.textContent = error.message;
    } finally {
      busy = false;
    }
  }

  input.addEventListener("input", show);
  document.getElementById(panel).addEventListener("change", show);
  let width = 0;
  new ResizeObserver(() => {
    if (place.clientWidth === width) return;
    width = place.clientWidth;
    show();
  }).observe(place);
}

export function startProfiles(ids) {
  const draw = (box, data) => plot(box, data, choice("channel"), choice("axis"), choice("range"));
  followSlider({ slider: "theta-diff", panel: "profiles", box: "plot", addresses: ids.map((id) => `fits/${id}/profiles`), draw });
}

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

function plotPolar(box, data, kind, channel) {
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
  const seen = series.map((one) => ({ ...one, x: data.theta_out_deg }));
  tellValues(svg, box, seen, "θ_out", (x, y) => (Math.atan2(x - middle.x, middle.y - y) * 180) / Math.PI);
}

export function startPolar(id) {
  const draw = (box, data) => plotPolar(box, data, choice("polar-axis"), choice("polar-channel"));
  followSlider({ slider: "theta-in", panel: "polar", box: "polar-plot", addresses: [`fits/${id}/polar`], draw });
}
