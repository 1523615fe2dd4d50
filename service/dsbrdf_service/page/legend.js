// The legend below a plot, which says the values below the pointer.
import { find, make } from "./app.js";

/** @typedef {import("./types").Curve} Curve */

/** @param {string} name @param {Record<string, string | number>} attributes @param {string} [text] */
export function svg(name, attributes, text) {
  const made = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, String(value));
  if (text !== undefined) made.textContent = text;
  return made;
}

/** @param {Curve} curve */
export const classOf = ({ points, colour, dash }) => `${points ? "point" : "curve"} c-${colour} ${dash ? `dash-${dash}` : ""}`;

/** Where a component is drawn in three channels, its dashes are shown once. @param {Curve[]} series @param {HTMLElement} box */
export function showLegend(series, box) {
  const items = series.filter((one, i) => series.findIndex(({ label }) => label === one.label) === i).map((one) => {
    const picture = svg("svg", { viewBox: "0 0 30 12", "aria-hidden": "true" });
    const look = classOf(one.dash ? { ...one, colour: "ink" } : one);
    picture.append(svg("path", { class: look, d: one.points ? "M12 3h6v6h-6z" : "M1 6H29" }));
    return make("li", { "data-label": one.label }, picture, one.label, make("b"));
  });
  find(document, `#${box.id}-legend`).replaceChildren(...items);
}

/**
 * Says in the legend the values of all curves at the angle below the pointer, which `angle` finds from its place.
 * @param {Element} picture @param {HTMLElement} box @param {Curve[]} series @param {string} name @param {(x: number, y: number) => number} angle
 */
export function tellValues(picture, box, series, name, angle) {
  const legend = find(document, `#${box.id}-legend`);
  const where = make("li");
  /** @param {number | null} degrees */
  const say = (degrees) => {
    legend.append(where);
    where.textContent = degrees === null ? "" : `at ${name} ${degrees.toFixed(1)}°`;
    for (const item of /** @type {NodeListOf<HTMLElement>} */ (legend.querySelectorAll("[data-label]"))) {
      const values = degrees === null ? [] : series.filter(({ label }) => label === item.dataset.label).map(({ x, y }) => {
        const near = x.reduce((best, value, i) => (Math.abs(value - degrees) < Math.abs(x[best] - degrees) ? i : best), 0);
        return y[near]?.toPrecision(3) ?? "no value";
      });
      find(item, "b").textContent = ` ${values.join(", ")}`;
    }
  };
  picture.addEventListener("pointermove", (event) => {
    const { clientX, clientY } = /** @type {PointerEvent} */ (event);
    const { left, top, width } = picture.getBoundingClientRect();
    const scale = /** @type {SVGSVGElement} */ (picture).viewBox.baseVal.width / width;
    say(Math.max(-90, Math.min(angle((clientX - left) * scale, (clientY - top) * scale), 90)));
  });
  picture.addEventListener("pointerleave", () => say(null));
}
