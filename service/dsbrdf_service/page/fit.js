// The page of one fit, or of two: their spheres; of one, the pictures beside it and the plots.
import { keepInAddress } from "./address.js";
import { startPolar, startProfiles } from "./plots.js";
import { startSpheres } from "./sphere.js";

const root = document.documentElement.dataset.root;
const beside = document.getElementById("beside");
const CAPTIONS = { measured: "measured", fit: "fitted", difference: "difference × 4" };

function showPictures(id, names) {
  const box = document.getElementById("pictures");
  for (const name of Object.keys(CAPTIONS).filter((caption) => names.includes(caption))) {
    const figure = document.createElement("figure");
    const image = document.createElement("img");
    const caption = document.createElement("figcaption");
    Object.assign(image, { src: `${root}fits/${id}/spheres/${name}.png`, alt: "", width: 256, height: 256 });
    caption.textContent = CAPTIONS[name];
    figure.append(image, caption);
    box.append(figure);
  }
  const note = document.getElementById("pictures-note");
  note.textContent = names.includes("measured") ? "Three lights, one exposure. A black difference is a perfect fit." : note.dataset.alone;
}

// Difference of what two spheres show, four times, and its peak signal-to-noise ratio over their pixels.
function compare([first, second]) {
  const canvas = document.querySelector("#between canvas");
  const context = canvas.getContext("2d", { willReadFrequently: true });
  const draw = () => {
    const size = first.canvas.width;
    if (second.canvas.width !== size) return;
    canvas.width = canvas.height = size;
    context.drawImage(first.canvas, 0, 0);
    context.globalCompositeOperation = "difference";
    context.drawImage(second.canvas, 0, 0);
    const { data } = context.getImageData(0, 0, size, size);
    let [sum, count] = [0, 0];
    for (let i = 0; i < data.length; i += 4) {
      if (data[i + 3] < 255) continue;
      for (const value of data.subarray(i, i + 3)) sum += value * value;
      count += 3;
    }
    const text = sum ? `${(10 * Math.log10((255 * 255 * count) / sum)).toFixed(1)} dB` : "no difference";
    document.getElementById("likeness").textContent = `As shown above: ${text} (peak signal-to-noise ratio).`;
    context.globalCompositeOperation = "lighter";
    for (const _ of [1, 2]) context.drawImage(canvas, 0, 0);
  };
  first.onpaint = second.onpaint = draw;
  draw();
}

// The same fit asked for with another name is the same fit, renamed.
async function rename(id, name) {
  const known = await (await fetch(`${root}v1/fits/${id}`)).json();
  const answer = await fetch(`${root}v1/fits?${new URLSearchParams({ name })}`, {
    method: "POST",
    headers: { "Content-Type": "application/json" },
    body: JSON.stringify({ measurement: known.measurement, options: known.options }),
  });
  if (answer.ok) location.reload();
  else alert((await answer.json()).detail);
}

keepInAddress();
document.getElementById("rename")?.addEventListener("click", ({ target }) => {
  const name = prompt("The fit's new name", document.querySelector("h1").textContent)?.trim();
  if (name) rename(target.dataset.fit, name);
});
const spheres = startSpheres();
if (beside) {
  const id = beside.dataset.fit;
  startProfiles([id]);
  startPolar(id);
  const [sphere] = await spheres;
  if (sphere) showPictures(id, sphere.view.pictures);
  else document.getElementById("pictures-note").textContent = "The pictures could not be drawn.";
}
if (!beside) {
  startProfiles([...document.querySelectorAll("figure.sphere")].map((figure) => figure.dataset.fit));
  const both = await spheres;
  if (both.every((sphere) => sphere.gl)) compare(both);
  else document.getElementById("between").hidden = true;
}
