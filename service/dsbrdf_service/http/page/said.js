// What is said of a fit beside its sphere: components, metrics, options, downloads; and where spheres and plots are.
import { download, find, json, make, nameOf, openapi, optionsOf, sentenceOf, showPicture, stateOf, template, whenOpened, whenSeen, words } from "./app.js";
import { readAddress } from "./address.js";
import { startSpheres } from "./light.js";
import { LABELS, Sphere } from "./sphere.js";

/** @param {number} share */
const percent = (share) => `${Number((100 * share).toPrecision(3))} %`;
/** @param {number} value */
const three = (value) => String(Number(value.toPrecision(3)));

// Name, title, how the value is written, what it means; the most telling first.
/** @type {[string, string, (value: number) => string, string][]} */
const METRICS = [
  ["psnr", "picture", (value) => `${value.toFixed(1)} dB`, "Peak signal-to-noise ratio of spheres of fit and measurement under three lights."],
  ["relative_rms", "values", percent, "Root mean square error of the values, relative to their size."],
  ["relative_rms_left_out", "values left out", percent, "The same error, at samples that were left out of the fit."],
  ["albedo_error", "albedo", percent, "Mean error of the albedo: of all the light that is reflected."],
  ["symmetric_floor", "reciprocal floor", percent, "The error of the best model that obeys reciprocity."],
  ["floor", "bivariate floor", percent, "The error of the best model without φ_diff."],
  ["excess", "values / floor", (value) => value.toFixed(3), "Error of the values divided by the bivariate floor; below 1, the fit is better than any model without φ_diff."],
  ["male", "logarithm", (value) => value.toFixed(4), "Mean absolute logarithmic error, which counts dark parts as well."],
  ["ssim", "structure", (value) => value.toFixed(4), "Structural similarity of the two spheres; 1 is equal."],
];

// Of a component: property, title, how a value is written.
/** @type {[string, string, (value: number) => string][]} */
const NUMBERS = [
  ["light_share", "light", (value) => `${Math.round(100 * value)} %`],
  ["color", "colour", (value) => value.toFixed(2)],
  ["albedo", "albedo", (value) => value.toFixed(3)],
  ["half_width_deg", "half width", (value) => `${three(value)}°`],
  ["height", "height in 1/sr", three],
];

// Of a surface of a component: the same.
/** @type {[string, string, (value: number) => string][]} */
const OF_SURFACES = [["alpha", "alpha", three], ["kappa", "kappa", three], ["f0", "F0", three], ["f90", "F90", three]];

/** @param {(string | HTMLElement)[]} title @param {string} value @param {string} meaning */
function row(title, value, meaning) {
  return make("div", {}, make("dt", {}, make("span", {}, ...title), make("strong", {}, value)), make("dd", {}, meaning));
}

/** A row of a table whose first cell is its head, or a row of heads. @param {(Node | string | number)[]} cells @param {boolean} [heads] */
export const tableRow = (cells, heads = false) => make("tr", {}, ...cells.map((cell, i) => {
  const isHead = cell !== "" && (heads || i === 0);
  return make(isHead ? "th" : "td", isHead ? { scope: heads ? "col" : "row" } : {}, cell instanceof Node ? cell : String(cell));
}));

/** Fills the table of the components. @param {HTMLElement} table @param {Component[]} components */
function showComponents(table, components) {
  if (!components.length) return table.append(tableRow(["There are none: the fit is black."]));
  const heads = components.map(({ label }) => make("span", { className: `name c-part-${LABELS.indexOf(label)}` }, words(label)));
  const rows = NUMBERS.map(([property, title, write]) => [title, ...components.map((part) => {
    const swatch = make("span", { className: "swatch", style: `background: color(srgb-linear ${part.color.join(" ")})` });
    const cell = valuesCell(Object({ ...part, height: part.lobe.height[0] })[property], Object(part.ranges)[property], write);
    if (property === "color") cell.prepend(swatch);
    return cell;
  })]);
  const most = Math.max(...components.map(({ surfaces }) => surfaces.length));
  for (let i = 0; i < most; i += 1) {
    for (const [property, title, write] of OF_SURFACES) {
      const cells = components.map(({ surfaces: { [i]: surface } }) => (surface ? valuesCell(Object(surface)[property], Object(surface)[`${property}_range`], write) : ""));
      rows.push([most > 1 ? `${title}, surface ${i + 1}` : title, ...cells]);
    }
  }
  return table.append(tableRow(["", ...heads], true), ...rows.map((cells) => tableRow(cells)));
}

/** One value or several, with their ranges. @param {number | number[] | null} value @param {any} range @param {(value: number) => string} write */
function valuesCell(value, range, write) {
  const values = [value].flat();
  const ranges = [range].flat(values.length > 1 ? 1 : 0);
  return make("span", {}, ...values.flatMap((one, i) => [numberCell(one, ranges[i], values.length, write), " "]));
}

/** A number with its range: beside it, or under the pointer where there are several. @param {number | null} value @param {Interval | null | undefined} range @param {number} several @param {(value: number) => string} write */
function numberCell(value, range, several, write) {
  if (value === null) return "–";
  const text = range ? `${write(range[0])} to ${write(range[1])}` : "";
  return make("span", { title: text && `${text} with a probability of 90 %` }, write(value), ...(text && several === 1 ? [make("small", {}, ` (${text})`)] : []));
}

/** Sentences that matter before a fit is used. @param {string[]} sentences */
export const warningsOf = (sentences) => sentences.map((sentence) => make("p", { className: "warning" }, sentence));

/** Fills the list of downloads from the formats that the API has. @param {HTMLElement} list @param {string} path of the fit */
export async function showDownloads(list, path) {
  /** @type {any[]} */
  const known = (await openapi()).paths["/v1/fits/{fit_id}/export"].get.parameters;
  const { schema } = known.find((one) => one.name === "format");
  const purposes = [...String(schema.description).matchAll(/`([\w-]+)`: (.*?)(?=; `|\.$)/g)];
  list.replaceChildren(...purposes.map(([, format, purpose]) => {
    const button = make("button", { className: "button", type: "button" }, format);
    button.onclick = async () => {
      button.disabled = true;
      await download(`${path}/export?format=${format}`).finally(() => { button.disabled = false; });
    };
    return make("li", {}, button, make("span", { className: "note" }, purpose));
  }));
}

/** The measurement of a fit, if it is still stored. @param {Fit} fit @returns {Promise<Measurement | null>} */
export const storedOf = ({ measurement }) => json(`v1/measurements/${measurement}`).catch((error) => (error.status === 404 ? null : Promise.reject(error)));

/** What a sphere and the plots show of a fit. @param {Fit} fit @param {Measurement | null} stored @returns {Subject} */
export function subjectOf(fit, stored) {
  const onGrid = Boolean(stored?.valid_nodes);
  return { name: nameOf(fit), fit: fit.id, measured: onGrid ? fit.measurement : null, samples: stored && !onGrid ? `v1/fits/${fit.id}/samples.npy?` : null, parts: fit.components };
}

/** A sphere's place in a part of a view, with the picture of a fit or a measurement meanwhile. @param {HTMLElement} part @param {string} [path] */
export function place(part, path) {
  find(part, ".place").prepend(template("sphere"));
  if (path) showPicture(find(part, ".fallback", HTMLImageElement), `${path}/figures/sphere.png`).catch(() => undefined);
  return find(part, "figure.sphere");
}

/** @type {Plot[]} */
export const PLOTS = [{
  id: "profiles", name: "theta-diff", lead: "", title: "Profiles", axis: "θ_diff", line: "Values over θ_half, averaged over φ_diff.",
  slider: { max: 89, step: 1, defaultValue: 0 }, along: "half", start: 0, about: "over theta_half at theta_diff",
}, {
  id: "plane", name: "theta-in", lead: "polar-", title: "Plane of incidence", axis: "θ_in", line: "The dashed line is where the light comes from.",
  slider: { max: 85, step: 5, defaultValue: 45 }, along: "out", start: -90, about: "in the plane of incidence for light at",
}];

/** Puts plots into a view, as the address says, and draws them when they are about to be seen. @param {HTMLElement} main @param {Subject[]} subjects one, or two with one plot */
export function showPlots(main, subjects) {
  const box = find(main, "#plots");
  box.replaceChildren();
  for (const { id, name, lead, title, axis, line, slider } of PLOTS.slice(0, 3 - subjects.length)) {
    const panel = find(template("plot", { title, axis, line }), "section");
    panel.id = id;
    Object.assign(find(panel, "input", HTMLInputElement), { ...slider, name, ariaLabel: `${name.replace("-", "_")} in degrees` });
    for (const choice of panel.querySelectorAll("select")) choice.name = lead + choice.name;
    find(panel, ".range").hidden = id === "plane";
    if (subjects.length > 1) find(panel, "[value=all]", HTMLOptionElement).remove(); // one channel of both
    box.append(panel);
  }
  readAddress();
  whenSeen(box, async () => (await import("./plots.js")).startPlots(box, subjects));
}

/** Shows spheres in their places, which share the light, and their plots. @param {HTMLElement} main @param {HTMLElement[]} figures @param {Subject[]} subjects @param {Promise<string | undefined>} [source] GLSL of the fit that is on its way */
export async function showSpheres(main, figures, subjects, source) {
  find(main, "#seen").append(template("sphere-controls"));
  const spheres = figures.map((figure, i) => new Sphere(figure, subjects[i], source)); // their boxes are in the address too
  showPlots(main, subjects);
  await startSpheres(spheres);
}

/** Says what is known of a fit beside its sphere. @param {HTMLElement} box @param {Fit} fit */
export function showSide(box, fit) {
  box.append(template("side", { verdict: stateOf(fit) }));
  const known = METRICS.filter(([name]) => typeof fit.metrics?.[name] === "number");
  const metrics = known.map(([name, title, write, meaning]) => row([`${title} `, make("code", {}, name)], write(Number(fit.metrics?.[name])), meaning));
  find(box, ".metrics").append(...(known.length ? metrics : [row(["This fit has no metrics."], "", "")]));
  find(box, ".warnings").append(...warningsOf(fit.warnings));
  showComponents(find(box, ".components"), fit.components);
  find(box, ".scroll").setAttribute("aria-label", `Components of ${nameOf(fit)}`);
  find(box, ".remarks").append(...fit.components.flatMap((part) => part.remarks).filter((remark) => !fit.warnings.includes(remark)).map((remark) => make("p", { className: "note" }, remark)));
  const [options, meanings] = [find(box, ".fitted-by"), find(box, ".meanings")];
  whenOpened(options, async () => {
    const described = optionsOf(await openapi());
    options.replaceChildren(...Object.entries(fit.options).map(([name, value]) => row([make("code", {}, name)], String(value ?? "none"), sentenceOf(described[name].description))));
  });
  whenOpened(meanings, async () => {
    const { ComponentDocument, ComponentLobe, SurfaceDocument } = (await openapi()).components.schemas;
    const described = { ...ComponentDocument.properties, ...ComponentLobe.properties, ...SurfaceDocument.properties };
    meanings.replaceChildren(...[...NUMBERS, ...OF_SURFACES].map(([property, title]) => row([title], "", described[property].description)));
  });
}
