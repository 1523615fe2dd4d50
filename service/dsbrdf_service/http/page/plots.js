// Plots as SVG of measured points, the fit and its components: profiles over theta_half at one theta_diff, and values in
// the plane of incidence for one direction of the light. The legend shows values at the angle that pointer or keys choose.
import { askArray, fill, find, json, LABELS, make, readAddress, template, whenSeen, words } from "./app.js";

/** @type {Plot[]} */
const PLOTS = [{
  id: "profiles", name: "theta-diff", lead: "", title: "Profiles", axis: "θ_diff", line: "Values over θ_half, averaged over φ_diff.",
  slider: { max: 89, step: 1, defaultValue: 0 }, along: "half", start: 0, about: "over theta_half at theta_diff",
}, {
  id: "plane", name: "theta-in", lead: "polar-", title: "Plane of incidence", axis: "θ_in", line: "The dashed line is the direction of the light.",
  slider: { max: 85, step: 5, defaultValue: 45 }, along: "out", start: -90, about: "in the plane of incidence for light at",
}];

const CHANNELS = ["red", "green", "blue"];
const MARGIN = { left: 62, right: 14, top: 12, bottom: 42 };
const HEIGHT = 340;
const MIN_MARK_DISTANCE_PX = 6; // Marks closer to the previous mark are left out.

/** @param {string} name @param {Record<string, string | number>} attributes @param {(Node | string)[]} content */
function svg(name, attributes, ...content) {
  const made = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, String(value));
  made.append(...content);
  return made;
}

/** Whether all channels are equal, as of a table with one column of values. @param {Values} values */
const isGrey = ({ fit, measured }) => [fit, measured].every((channels) => !channels || channels.every((one) => String(one) === String(channels[0])));

/** Returns the points and curves of a plot. In one channel, a component has its own colour, and a band for the range of its albedo. @param {Drawing} drawing @returns {Curve[]} */
function curvesOf({ all, subjects, channel }) {
  const several = all.length > 1;
  const shown = channel !== "all" ? [Number(channel)] : all.every(isGrey) ? [0] : [0, 1, 2];
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
      ...(measured ? [{ label: lead + (subjects[i].samples ? `samples within ${MAX_SAMPLE_DISTANCE_DEG}°` : "measured"), colour, points: true, x: at, y: measured[c] }] : []),
      ...components,
      ...(fit ? [{ label: `${lead}fit`, colour, x, y: fit[c] }] : []),
    ];
  }));
}

/** Returns the bounds of the axes. @param {Plot} kind @param {Drawing} drawing @param {Curve[]} curves */
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

/** Returns round numbers up to the end of an axis. @param {number} low @param {number} high @param {string} axis */
function ticksOf(low, high, axis) {
  const power = 10 ** Math.floor(Math.log10(high));
  if (axis === "linear") {
    const step = power * ([0.1, 0.2, 0.5, 1].find((factor) => factor * power >= high / 6) ?? 2);
    return Array.from({ length: Math.floor(high / step) + 1 }, (_, i) => i * step);
  }
  const ticks = Array.from({ length: 36 }, (_, i) => (power * [5, 2, 1][i % 3]) / 10 ** Math.floor(i / 3)).filter((tick) => tick >= low && tick <= high);
  const powers = ticks.filter((tick) => Number.isInteger(Number(Math.log10(tick).toFixed(6))));
  return powers.length < 2 ? ticks : powers;
}

/** @param {HTMLElement} panel @param {Plot} kind @param {Drawing} drawing */
function plot(panel, kind, drawing) {
  const { axis, place } = drawing;
  const width = Math.max(find(panel, ".plot").clientWidth, 280);
  const curves = curvesOf(drawing);
  const { start, end, low, high } = limits(kind, drawing, curves);
  const [left, right, top, bottom] = [MARGIN.left, width - MARGIN.right, MARGIN.top, HEIGHT - MARGIN.bottom];
  const scale = axis === "log" ? Math.log : Number;
  const px = (/** @type {number} */ degrees) => left + ((right - left) * (degrees - start)) / (end - start);
  const py = (/** @type {number} */ value) => bottom - ((bottom - top) * (scale(Math.max(value, low / 100)) - scale(low))) / (scale(high) - scale(low));
  const clip = svg("clipPath", { id: `inside-${panel.id}` }, svg("rect", { x: left, y: top, width: right - left, height: bottom - top }));
  const picture = svg("svg", { viewBox: `0 0 ${width} ${HEIGHT}`, role: "img", tabindex: 0, "aria-label": `BRDF ${kind.about} ${place} degrees, ${axis} axis` }, clip);
  const step = [0.5, 1, 2, 5, 10, 15, 30].find((candidate) => (end - start) / candidate <= (width < 500 ? 6 : 12)) ?? 30;
  for (let degrees = start; degrees <= end + 1e-9; degrees += step) {
    picture.append(svg("path", { class: "grid", d: `M${px(degrees)} ${top}V${bottom}` }), svg("text", { x: px(degrees), y: bottom + 18, "text-anchor": "middle" }, `${degrees}°`));
  }
  for (const tick of ticksOf(low, high, axis)) {
    const text = tick !== 0 && (tick < 0.01 || tick >= 1e4) ? tick.toExponential(0).replace("e+", "e") : String(Number(tick.toPrecision(3)));
    picture.append(svg("path", { class: "grid", d: `M${left} ${py(tick)}H${right}` }), svg("text", { x: left - 8, y: py(tick) + 4, "text-anchor": "end" }, text));
  }
  const cursor = svg("path", { class: "light" });
  const group = svg("g", { "clip-path": `url(#inside-${panel.id})` }, cursor);
  for (const { x, y, band, points, ...one } of curves) {
    const places = (factor = 1) => y.flatMap((value, i) => (value !== null && (axis === "linear" || value > 0) ? [[px(x[i]), py(value * factor)]] : []));
    if (band) group.append(svg("path", { class: `band c-${one.colour}`, d: `${line([...places(band[0]), ...places(band[1]).reverse()])}Z` }));
    group.append(svg("path", { class: classOf({ points, ...one }), d: points ? squares(places()) : line(places()) }));
  }
  picture.append(
    svg("path", { class: "axis", d: `M${left} ${top}V${bottom}H${right}` }),
    svg("text", { x: (left + right) / 2, y: HEIGHT - 6, "text-anchor": "middle" }, `θ_${kind.along}`),
    svg("text", { x: 12, y: (top + bottom) / 2, "text-anchor": "middle", transform: `rotate(-90 12 ${(top + bottom) / 2})` }, "BRDF [1/sr]"),
    ...(start < 0 ? [svg("path", { class: "light", d: `M${px(-place)} ${top}V${bottom}` })] : []),
    group,
  );
  find(panel, ".plot").replaceChildren(picture);
  let told = Math.max(start, 0);
  const tell = (/** @type {number} */ degrees) => {
    told = Math.min(Math.max(degrees, start), end);
    cursor.setAttribute("d", `M${px(told)} ${top}V${bottom}`);
    showLegend(panel, curves, kind.along, told);
  };
  picture.onpointermove = (event) => {
    const box = picture.getBoundingClientRect();
    tell(start + ((end - start) * (((event.clientX - box.left) * width) / box.width - left)) / (right - left));
  };
  picture.onkeydown = ({ key }) => {
    if (key === "ArrowLeft" || key === "ArrowRight") tell(told + ((key === "ArrowLeft" ? -1 : 1) * (end - start)) / 90);
  };
  picture.onpointerleave = picture.onblur = () => {
    cursor.removeAttribute("d");
    showLegend(panel, curves, kind.along);
  };
  showLegend(panel, curves, kind.along);
}

const classOf = (/** @type {{points?: boolean, colour: string, dash?: string}} */ { points, colour, dash }) => `${points ? "point" : "curve"} c-${colour} ${dash ? `dash-${dash}` : ""}`;

const line = (/** @type {number[][]} */ places) => (places.length ? `M${places.map(([x, y]) => `${x.toFixed(1)} ${y.toFixed(1)}`).join("L")}` : "");

/** Returns small squares at some of the places. @param {number[][]} places */
function squares(places) {
  let last = [-Infinity, 0];
  return places.flatMap(([x, y]) => {
    if (Math.hypot(x - last[0], y - last[1]) < MIN_MARK_DISTANCE_PX) return [];
    last = [x, y];
    return `M${(x - 2.5).toFixed(1)} ${(y - 2.5).toFixed(1)}h5v5h-5z`;
  }).join("");
}

/** Shows the legend; the three channels of a component share an entry. @param {HTMLElement} panel @param {Curve[]} curves @param {string} along @param {number} [degrees] where values are told */
function showLegend(panel, curves, along, degrees) {
  const rank = (/** @type {Curve} */ { points, part }) => (points ? 0 : part ? 2 : 1);
  const items = [...new Set([...curves].sort((a, b) => rank(a) - rank(b)).map(({ label }) => label))].map((label) => {
    const same = curves.filter((one) => one.label === label);
    const look = svg("path", { class: classOf(same[0].dash ? { ...same[0], colour: "ink" } : same[0]), d: same[0].points ? "M12 3h6v6h-6z" : "M1 6H29" });
    const values = same.map(({ x, y }) => {
      const far = x.map((value) => Math.abs(value - Number(degrees)));
      return y[far.indexOf(Math.min(...far))]?.toPrecision(3) ?? "no value";
    });
    return make("li", { "data-label": label }, svg("svg", { viewBox: "0 0 30 12", "aria-hidden": "true" }, look), label, make("b", {}, degrees === undefined ? "" : ` ${values.join(", ")}`));
  });
  find(panel, ".legend").replaceChildren(...items, make("li", {}, degrees === undefined ? "" : `at θ_${along} ${degrees.toFixed(1)}°`));
}

/** Fetches and draws the values at the place of a slider, whenever the slider, a choice or the width changes. @param {HTMLElement} panel @param {Subject[]} subjects @param {(Sample[] | null)[]} read samples of tables */
function followSlider(panel, subjects, read) {
  const kind = /** @type {Plot} */ (PLOTS.find(({ id }) => id === panel.id));
  const slider = find(panel, "input", HTMLInputElement);
  /** @type {Map<number, Values[]>} */
  const known = new Map();
  const samples = read.find(Boolean);
  const choice = (/** @type {string} */ name) => find(panel, `select[name$=${name}]`, HTMLSelectElement).value;
  let turns = 0;
  let shown = Promise.resolve();
  const show = async () => {
    const place = Number(slider.value);
    const all = known.get(place) ?? await Promise.all(subjects.map((one, i) => valuesAt(one, read[i], kind.along, place, subjects.length < 2)));
    known.set(place, all);
    fill(panel, { near: samples && !all.some(({ measured }) => measured?.[0].length) ? `There are no samples here; most are at ${mostAt(samples, kind.along)}°.` : "" });
    plot(panel, kind, { all, subjects, place, channel: choice("channel"), axis: choice("axis"), range: choice("range") });
  };
  panel.oninput = async () => {
    find(panel, "output").textContent = `${slider.value}°`;
    const turn = turns += 1;
    await shown.catch(() => undefined);
    if (turn === turns) await (shown = show()); // Only one drawing runs at a time; then the last change is drawn.
  };
  if (samples && !location.hash.includes(`${slider.name}=`)) slider.value = slider.defaultValue = String(mostAt(samples, kind.along));
  new ResizeObserver(() => panel.dispatchEvent(new Event("input"))).observe(find(panel, ".plot"));
}

/** Inserts plots into a view with the choices in the address, and draws them when they are scrolled into view. @param {HTMLElement} main @param {Subject[]} subjects one, or two with one plot */
export function showPlots(main, subjects) {
  const box = find(main, "#plots");
  box.replaceChildren();
  const bands = subjects.length < 2 && subjects[0].parts.length ? "With a single channel, bands show the ranges of the components." : "";
  for (const { id, name, lead, title, axis, line, slider } of PLOTS.slice(0, 3 - subjects.length)) {
    const panel = find(template("plot", { title, axis, line, bands }), "section");
    panel.id = id;
    Object.assign(find(panel, "input", HTMLInputElement), { ...slider, name, ariaLabel: `${name.replace("-", "_")} in degrees` });
    for (const choice of panel.querySelectorAll("select")) choice.name = lead + choice.name;
    find(panel, ".range").hidden = id === "plane";
    if (subjects.length > 1) find(panel, "[value=all]", HTMLOptionElement).remove(); // A plot of two fits shows one channel.
    box.append(panel);
  }
  readAddress();
  whenSeen(box, () => startPlots(box, subjects));
}

/** Draws the plots in a box. @param {HTMLElement} box @param {Subject[]} subjects */
async function startPlots(box, subjects) {
  const read = await Promise.all(subjects.map(({ samples }) => (samples ? samplesOf(samples) : null)));
  for (const panel of box.querySelectorAll("section")) followSlider(panel, subjects, read);
}

const MAX_SAMPLE_DISTANCE_DEG = 3; // Samples farther from the angle of a slider are hidden.
const MAX_SAMPLES = 4000;
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
function mostAt(samples, along) {
  const counts = Array.from({ length: 18 }, (_, i) => samples.filter((one) => isNear(one, along, 5 * i)).length);
  return 5 * counts.indexOf(Math.max(...counts));
}

/** Whether a sample is shown at a place of a slider. @param {Sample} one @param {"half" | "out"} along @param {number} place */
function isNear(one, along, place) {
  return along === "half" ? Math.abs(one.diff - place) <= MAX_SAMPLE_DISTANCE_DEG : Math.abs(one.light - place) <= MAX_SAMPLE_DISTANCE_DEG && one.aside <= MAX_SAMPLE_DISTANCE_DEG;
}

/** Fetches samples of a table, at most MAX_SAMPLES. @param {string} path @returns {Promise<Sample[]>} */
async function samplesOf(path) {
  const table = await askArray(`${path}max_samples=${MAX_SAMPLES}`); // A sample has nine numbers.
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
async function valuesAt({ fit, measured, parts }, samples, along, place, withParts) {
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
