// A measurement, also before its fit: its sphere, profiles and values, its fits, and a fit of it.
import { dateOf, download, fill, find, json, link, make, request, root, sendJson, share, showPicture, template, whenOpened } from "./app.js";
import { keepInAddress } from "./address.js";
import { prepare, startSpheres } from "./light.js";
import { chosen, inJson, showForm } from "./options.js";
import { followPlots, place, placePlots } from "./said.js";
import { Sphere } from "./sphere.js";

/** @typedef {import("./types").Measurement} Measurement */

/** @param {HTMLElement} main @param {string} sha256 */
export async function show(main, sha256) {
  /** @type {Measurement} */
  const known = await json(`v1/measurements/${sha256}`);
  const name = known.name ?? `${sha256.slice(0, 12)}…`;
  const onGrid = known.valid_nodes > 0;
  document.title = `${name} – dsbrdf`;
  const size = `${(known.size / 1e6).toPrecision(3)} MB`;
  const about = `${onGrid ? `${known.valid_nodes} values on the grid of MERL` : "a table of samples"} · ${size} · ${dateOf(known.created)}`;
  main.replaceChildren(template("measurement", { name, about }));
  whenOpened(find(main, ".options"), () => showForm(find(main, ".options")));
  act(main, known);
  find(main, "#its-fits").append(...(known.fits.length ? known.fits : [null]).map((id) => (id ? fitLink(id) : make("li", { className: "note" }, "There is none yet."))));
  const [seen, plots] = [find(main, "#seen"), find(main, "#plots")];
  const subject = { name, fit: null, measured: onGrid ? sha256 : null, samples: onGrid ? null : `v1/measurements/${sha256}/samples.npy`, labels: [] };
  placePlots(plots, false);
  if (!onGrid) {
    seen.append(make("p", { className: "note" }, "Of a table of samples there is no sphere before its fit."));
    keepInAddress();
    followPlots(plots, [subject]);
    return;
  }
  const figure = place(seen, template("sphere"));
  seen.append(template("sphere-controls"));
  prepare();
  keepInAddress();
  followPlots(plots, [subject]);
  const image = find(figure, ".fallback", HTMLImageElement);
  showPicture(image, `v1/measurements/${sha256}/figures/sphere.png`).then(() => { image.hidden = find(figure, "canvas").dataset.painted !== undefined; }, () => undefined);
  await startSpheres([new Sphere(figure, subject)], async () => undefined);
}

/** @param {string} id */
function fitLink(id) {
  const anchor = make("a", { "data-link": "fit" }, id.slice(0, 12));
  const item = make("li", {}, anchor);
  link(item, { fit: `fits/${id}` });
  json(`v1/fits/${id}`).then((fit) => { anchor.textContent = `${dateOf(fit.created)}, ${fit.likeness ?? (fit.status === "succeeded" ? "fitted" : fit.status)}`; }, () => undefined);
  return item;
}

/** @param {HTMLElement} main @param {Measurement} known */
function act(main, { sha256, name }) {
  const path = `v1/measurements/${sha256}`;
  const form = find(main, "#fit-it", HTMLFormElement);
  const fault = find(form, ".fault");
  /** @param {Error} error */
  const say = (error) => fill(main, { done: error.message });
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    fault.hidden = true;
    try {
      const query = name ? `?${new URLSearchParams({ name })}` : "";
      const answer = await sendJson(`v1/fits${query}`, "POST", { measurement: sha256, options: inJson(chosen(find(form, ".options"))) });
      location.assign(new URL(`fits/${(await answer.json()).id}`, root));
    } catch (error) {
      fault.hidden = false;
      fault.textContent = /** @type {Error} */ (error).message;
    }
  });
  find(main, "[data-act=download]").onclick = () => download(path).catch(say);
  find(main, "[data-act=share]").onclick = () => share(main);
  find(main, "[data-act=delete]").onclick = () => {
    if (!confirm(`Delete the measurement ${name ?? ""}? Its fits stay, without what they were fitted to.`)) return;
    request(path, { method: "DELETE" }).then(() => location.assign(root), say);
  };
}
