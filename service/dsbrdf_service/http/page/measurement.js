// Shows a measurement (sphere, plots and values, or the summary of a table), its fits, and a form to fit it.
import { act, dateOf, find, json, make, nameOf, remove, request, root, save, setTitle, share, sizeOf, stateOf, template, whenOpened } from "./app.js";
import { chosen, fitStored, showForm, showTable, typedOptions } from "./options.js";
import { showPlots } from "./plots.js";
import { place, showSpheres } from "./result.js";

/** @param {HTMLElement} main @param {string} sha256 */
export async function show(main, sha256) {
  const path = `v1/measurements/${sha256}`;
  /** @type {Measurement} */
  const known = await json(path);
  const name = known.name ?? nameOf({ name: null, measurement: sha256 });
  const onGrid = known.valid_nodes > 0;
  setTitle(name);
  const kind = onGrid ? `${known.valid_nodes.toLocaleString("en")} values on the MERL grid` : "a table of samples";
  main.replaceChildren(template("measurement", { name, about: `${kind} · ${sizeOf(known)} · ${dateOf(known.created)}` }));
  act(main, "download", async () => save(await request(`${path}/content`)));
  act(main, "share", share);
  act(main, "delete", () => remove(path, `The measurement ${name} is deleted. Its fits are kept, but can no longer be compared with it.`, main));
  const options = find(main, ".options");
  whenOpened(options, () => showForm(options, true));
  find(main, "#its-fits").append(...(known.fits.length ? known.fits.map(fitLink) : [make("li", { className: "note" }, "This measurement has no fit yet.")]));
  find(main, "#fit-it").onsubmit = async (event) => {
    event.preventDefault();
    const { id } = await fitStored(known.name, sha256, typedOptions(chosen(options)));
    location.assign(new URL(`fits/${id}`, root));
  };
  const subject = { name, fit: null, measured: onGrid ? sha256 : null, samples: null, parts: [] };
  if (onGrid) return showSpheres(main, [place(main, path)], [subject]);
  const file = new File([await (await request(`${path}/content`)).blob()], name);
  await showForm(options, true); // The samples are stored, so options of a table no longer apply.
  return showTable(find(main, "#seen"), file, options, { understood: () => showPlots(main, [{ ...subject, samples: `${path}/samples.npy?` }]) });
}

/** @param {string} id */
function fitLink(id) {
  const link = make("a", { href: new URL(`fits/${id}`, root) }, "Loading…");
  json(`v1/fits/${id}`).then((fit) => link.replaceChildren(`${dateOf(fit.created)}, ${stateOf(fit)}`));
  return make("li", {}, link);
}
