// Lists the downloads of a fit by the program that opens them.
import { download, make, openapi } from "./app.js";

// Common programs come first; formats without an entry are listed last.
const PROGRAMS = /** @type {Record<string, string>} */ ({
  bsdf: "Mitsuba 3", materialx: "Blender, Arnold, Maya", glsl: "three.js and other shaders", brdf: "BRDF Explorer", python: "NumPy, PyTorch, JAX",
  "bsdf-spectral": "pbrt-v4, spectral Mitsuba", merl: "Programs that read MERL files", components: "A spreadsheet: components", csv: "A spreadsheet: lobes", json: "dsbrdf itself, Mitsuba's plugin",
});

/** Fills the list of downloads from the formats that the API has. @param {HTMLElement} list @param {string} path of the fit */
export async function showDownloads(list, path) {
  /** @type {any[]} */
  const known = (await openapi()).paths["/v1/fits/{fit_id}/export"].get.parameters;
  const described = (/** @type {string} */ name) => String(known.find((one) => one.name === name)?.schema.description);
  const purposes = new Map([...described("format").matchAll(/`([\w-]+)`: (.*?)(?=; `|\.$)/g)].map(([, format, purpose]) => [format, purpose]));
  const formats = [...new Set([...Object.keys(PROGRAMS), ...purposes.keys()])].filter((format) => purposes.has(format));
  list.replaceChildren(...formats.map((format) => {
    const program = PROGRAMS[format] ?? format;
    const hasExample = described("example").includes(`\`${format}\``);
    const about = make("span", {}, make("strong", {}, program), make("small", {}, purposes.get(format) ?? ""));
    return make("li", {}, about, button(format, `${path}/export?format=${format}`), ...(hasExample ? [button("example scene", `${path}/export?format=${format}&example=true`, ` for ${program}`)] : []));
  }));
}

/** Makes a button that downloads a file. @param {string} text @param {string} path @param {string} [more] additional words for screen readers */
function button(text, path, more = "") {
  const made = make("button", { className: "button", type: "button" }, text, make("span", { className: "sr" }, more));
  made.onclick = () => {
    made.disabled = true;
    return download(path).finally(() => { made.disabled = false; });
  };
  return made;
}
