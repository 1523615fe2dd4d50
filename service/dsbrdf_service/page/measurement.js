// A measurement, also before its fit: its sphere, profiles and values, or what is understood of a table; its fits, and a fit of it.
import { act, dateOf, download, find, json, make, remove, request, root, sendJson, setTitle, share, showPicture, stateOf, template, whenOpened } from "./app.js";
import { keepInAddress, readAddress } from "./address.js";
import { startSpheres } from "./light.js";
import { chosen, inJson, showForm } from "./options.js";
import { followPlots, place, placePlots } from "./said.js";
import { Sphere } from "./sphere.js";

/** @param {HTMLElement} main @param {string} sha256 */
export async function show(main, sha256) {
  const path = `v1/measurements/${sha256}`;
  /** @type {Measurement} */
  const known = await json(path);
  const name = known.name ?? `${sha256.slice(0, 12)}…`;
  const onGrid = known.valid_nodes > 0;
  setTitle(name);
  const size = known.size < 1e6 ? `${(known.size / 1e3).toPrecision(3)} kB` : `${(known.size / 1e6).toPrecision(3)} MB`;
  const kind = onGrid ? `${known.valid_nodes.toLocaleString("en")} values on the grid of MERL` : "a table of samples";
  main.replaceChildren(template("measurement", { name, about: `${kind} · ${size} · ${dateOf(known.created)}` }));
  act(main, "download", () => download(path));
  act(main, "share", share);
  act(main, "delete", () => remove(path, `Delete the measurement ${name}? Its fits stay, but can no longer be compared with it.`));
  const [options, seen, plots] = [find(main, ".options"), find(main, "#seen"), find(main, "#plots")];
  whenOpened(options, () => showForm(options, onGrid));
  find(main, "#its-fits").append(...(known.fits.length ? known.fits.map(fitLink) : [make("li", { className: "note" }, "There is none yet.")]));
  find(main, "#fit-it").onsubmit = async (event) => {
    event.preventDefault();
    const query = known.name ? `?${new URLSearchParams({ name })}` : "";
    const { id } = await sendJson(`v1/fits${query}`, "POST", { measurement: sha256, options: inJson(chosen(options)) });
    location.assign(new URL(`fits/${id}`, root));
  };
  if (!onGrid) return showSamples(path, options, name, seen, plots);
  const subject = { name, fit: null, measured: sha256, samples: null, parts: [] };
  placePlots(plots);
  const figure = place(seen);
  seen.append(template("sphere-controls"));
  keepInAddress();
  followPlots(plots, [subject]);
  const image = find(figure, ".fallback", HTMLImageElement);
  showPicture(image, `${path}/figures/sphere.png`).then(() => { image.hidden = find(figure, "canvas").dataset.rough !== undefined; });
  return startSpheres([new Sphere(figure, subject)], async () => undefined);
}

/** Shows what is understood of a table, and its samples, with the options that are chosen. @param {string} path @param {HTMLElement} options @param {string} name @param {HTMLElement} box @param {HTMLElement} plots */
async function showSamples(path, options, name, box, plots) {
  const file = new File([await (await request(path)).blob()], name);
  const { showTable } = await import("./table.js");
  keepInAddress();
  await showTable(box, file, options, { understood: () => {
    const query = new URLSearchParams(chosen(options, ".of-table"));
    plots.replaceChildren();
    placePlots(plots);
    readAddress();
    followPlots(plots, [{ name, fit: null, measured: null, samples: `${path}/samples.npy?${query}&`, parts: [] }]);
  } });
}

/** @param {string} id */
function fitLink(id) {
  const link = make("a", { href: new URL(`fits/${id}`, root) }, id.slice(0, 12));
  json(`v1/fits/${id}`).then((fit) => link.replaceChildren(`${dateOf(fit.created)}, ${stateOf(fit)}`));
  return make("li", {}, link);
}
