// The page of one fit: its progress, why it failed, or the result.
import { dateOf, download, fill, find, json, link, make, nameOf, pause, Problem, request, root, sendJson, share, showPicture, template, whenSeen } from "./app.js";
import { keepInAddress } from "./address.js";
import { prepare, startSpheres } from "./light.js";
import { componentTable, followPlots, place, placePlots, showDownloads, showMetrics, showOptions, showWarnings, verdict } from "./said.js";
import { Sphere } from "./sphere.js";

/** @typedef {import("./types").Fit} Fit */
const FIGURES = /** @type {[string, string][]} */ ([
  ["parameters", "Height over theta_diff and directional albedo of each component"],
  ["residual", "Difference of fit and measurement over theta_half and theta_diff"],
]);
const FAULTS = {
  input: "The measurement or the options do not allow a fit.",
  compute: "The computation failed or met a limit of the service.",
  system: "The process of the fit was lost; the same request runs again.",
};

/** @param {HTMLElement} main @param {string} id */
export async function show(main, id) {
  const asked = json(`v1/fits/${id}`);
  main.replaceChildren(template("fit", { name: "A fit" }));
  const figure = place(find(main, "#seen"), template("sphere"));
  find(main, "#seen").append(template("sphere-controls"));
  placePlots(find(main, "#plots"), false);
  prepare();
  const fallback = find(figure, ".fallback", HTMLImageElement);
  const picture = showPicture(fallback, `v1/fits/${id}/figures/sphere.png`).then(() => { fallback.hidden = find(figure, "canvas").dataset.painted !== undefined; }, () => undefined);
  /** @type {Fit} */
  const fit = await asked;
  if (fit.status !== "succeeded") return follow(main, fit);
  return showResult(main, fit, figure, picture);
}

/** @param {HTMLElement} main @param {Fit} fit @param {HTMLElement} figure @param {Promise<unknown>} picture */
async function showResult(main, fit, figure, picture) {
  const name = nameOf(fit);
  const path = `v1/fits/${fit.id}`;
  const labels = fit.components.map(({ label }) => label);
  document.title = `${name} – dsbrdf`;
  const { amplitude, center } = fit.model;
  const [lobes, rings] = [amplitude[0][0].length, center[0][0].filter(Boolean).length];
  const model = `The model has ${lobes} ${lobes === 1 ? "lobe" : "lobes"}${rings ? ` (${rings} ${rings === 1 ? "ring" : "rings"})` : ""}.`;
  fill(main, { name, model, verdict: verdict(fit), about: `${labels.map((label) => label.replace("_", " ")).join(", ") || "no light"} · ${dateOf(fit.created)}` });
  link(main, { compare: `.#with=${fit.id}`, measurement: `measurements/${fit.measurement}` });
  showWarnings(find(main, "#warnings"), fit.warnings);
  find(main, "#components").replaceChildren(componentTable(fit, name));
  showMetrics(find(main, ".metrics"), fit);
  showOptions(find(main, "#options"), fit);
  act(main, fit);
  const stored = await json(`v1/measurements/${fit.measurement}`).catch((error) => (error.status === 404 ? null : Promise.reject(error)));
  const measured = stored?.valid_nodes ? fit.measurement : null;
  const subject = { name, fit: fit.id, measured, samples: stored && !measured ? `${path}/samples.npy` : null, labels };
  const sphere = new Sphere(figure, subject);
  keepInAddress();
  find(main, "a[data-link=measurement]").hidden = !stored;
  if (stored) offerFigures(main, path, Boolean(measured));
  await startSpheres([sphere], async () => { await picture; find(figure, ".fallback").hidden = false; });
  followPlots(find(main, "#plots"), [subject]); // not before: what is below has its place now
  whenSeen(find(main, ".downloads"), () => showDownloads(find(main, ".downloads"), (format) => download(`${path}/export?format=${format}`)));
  await showPictures(main, path, labels, Boolean(measured));
  if (!measured) find(main, "#pictures-note").textContent = stored ? "The measurement is a table of samples: they are in the plots below." : "The measurement is not stored any more: the fit is shown alone.";
}

/** Shows the parts of one picture of spheres. @param {HTMLElement} main @param {string} path @param {string[]} labels @param {boolean} measured */
async function showPictures(main, path, labels, measured) {
  const names = [...(measured ? ["measured", "fitted", "difference × 4"] : ["fitted"]), ...labels.map((label) => label.replace("_", " "))];
  const note = find(main, "#pictures-note");
  const all = make("img", { alt: "" });
  try {
    await showPicture(all, `${path}/figures/spheres.png`);
  } catch (error) {
    note.textContent = `The pictures could not be drawn. ${/** @type {Error} */ (error).message}`;
    return;
  }
  const size = all.naturalHeight;
  find(main, "#pictures").append(...names.map((name, i) => {
    const canvas = make("canvas", { width: size, height: size, "aria-hidden": "true" });
    canvas.getContext("2d")?.drawImage(all, i * size, 0, size, size, 0, 0, size, size);
    return make("figure", {}, canvas, make("figcaption", {}, name));
  }));
  note.textContent = measured ? "Three lights, one exposure. A black difference is a perfect fit." : "";
}

/** @param {HTMLElement} main @param {string} path @param {boolean} onGrid */
function offerFigures(main, path, onGrid) {
  find(main, "#figures").hidden = false;
  const lobes = /** @type {[string, string][]} */ ([["lobes", "The lobes of the model and their sum, in the red channel"]]);
  for (const [selector, figures] of /** @type {[string, [string, string][]][]} */ ([["#figures details", FIGURES], ...(onGrid ? [["#model-lobes", lobes]] : [])])) {
    const details = find(main, selector, HTMLDetailsElement);
    details.addEventListener("toggle", () => {
      if (details.querySelector("figure")) return;
      for (const [name, meaning] of figures) {
        const image = make("img", { alt: meaning, width: 1056, height: 326 });
        const caption = make("figcaption", {}, "It is being drawn…");
        details.append(make("figure", { className: "drawn" }, image, caption));
        showPicture(image, `${path}/figures/${name}.svg`).then(() => { caption.textContent = meaning; }, (error) => { caption.textContent = error.message; });
      }
    });
  }
}

/** @param {HTMLElement} main @param {Fit} fit */
function act(main, fit) {
  /** @param {string} name @param {() => unknown} call */
  const on = (name, call) => {
    find(main, `[data-act=${name}]`).onclick = async () => {
      try {
        await call();
      } catch (error) {
        fill(main, { done: /** @type {Error} */ (error).message });
      }
    };
  };
  on("rename", async () => {
    const name = prompt("The fit's new name", nameOf(fit))?.trim();
    if (!name) return;
    await sendJson(`v1/fits/${fit.id}`, "PATCH", { name });
    fill(main, { name, done: "Renamed." });
    document.title = `${name} – dsbrdf`;
  });
  on("share", () => share(main));
  on("delete", async () => {
    if (!confirm(`Delete this fit of ${nameOf(fit)}? Its measurement stays.`)) return;
    await request(`v1/fits/${fit.id}?only=delete`, { method: "DELETE" });
    location.assign(root);
  });
}

/** Follows a fit to its end, or says how it ended. @param {HTMLElement} main @param {Fit} fit */
async function follow(main, fit) {
  const name = fit.name ?? `Fit of ${nameOf(fit)}`;
  document.title = `${name}: ${fit.status} – dsbrdf`;
  main.replaceChildren(template("unfinished", { name }));
  const [bar, cancel, fault] = [find(main, "#bar", HTMLProgressElement), find(main, "#cancel"), find(main, "#fault")];
  cancel.onclick = () => request(`v1/fits/${fit.id}?only=cancel`, { method: "DELETE" }).catch((error) => {
    fault.hidden = error.status === 409; // it has just ended
    fault.textContent = error.message;
  });
  /** @param {Fit} now */
  const tell = (now) => {
    const unfinished = now.status === "accepted" || now.status === "running";
    bar.hidden = cancel.hidden = !unfinished;
    bar.value = now.progress;
    fault.hidden = !now.error;
    fault.textContent = now.error?.message ?? "";
    const states = /** @type {Record<string, string>} */ ({ accepted: "Waiting for its turn", running: "Fitting", cancelled: "This fit was cancelled." });
    fill(main, { state: states[now.status] ?? "", note: now.error ? FAULTS[now.error.origin] : unfinished ? "The page shows the result when it is there. You may leave: the fit goes on." : "" });
    return unfinished;
  };
  let now = fit;
  while (tell(now)) {
    try {
      for await (const event of events(`v1/fits/${fit.id}/events`)) {
        now = { ...now, ...event };
        tell(now);
      }
    } catch (error) {
      if (error instanceof Problem && error.status) throw error; // it is gone
      await pause(3000);
    }
  }
  if (now.status === "succeeded") await show(main, fit.id);
}

/** The data of server-sent events. @param {string} path @returns {AsyncGenerator<any>} */
async function* events(path) {
  const answer = await request(path, { headers: { Accept: "text/event-stream" } });
  const reader = /** @type {ReadableStream<Uint8Array>} */ (answer.body).getReader();
  const decoder = new TextDecoder();
  let text = "";
  for (;;) {
    const { done, value } = await reader.read();
    if (done) return;
    text += decoder.decode(value, { stream: true });
    const whole = text.split(/\r?\n\r?\n/);
    text = whole.pop() ?? "";
    for (const event of whole) {
      const data = event.split(/\r?\n/).filter((line) => line.startsWith("data:")).map((line) => line.slice(5)).join("\n");
      if (data) yield JSON.parse(data);
    }
  }
}
