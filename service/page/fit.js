// The page of one fit: its sphere, the pictures beside it, the profiles, and the buttons that copy.
import { startPolar } from "./polar.js";
import { startProfiles } from "./profiles.js";
import { startSpheres } from "./sphere.js";

const root = document.documentElement.dataset.root;
const beside = document.getElementById("beside");
const id = beside.dataset.fit;
const CAPTIONS = { measured: "measured", fit: "fitted", difference: "difference × 4" };

function showPictures(names) {
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
  document.getElementById("pictures-note").textContent = names.includes("measured")
    ? "Three lights, one exposure. A black difference is a perfect fit."
    : "The measurement is not stored any more, so the fit is shown alone.";
}

for (const button of document.querySelectorAll(".copy")) {
  button.addEventListener("click", async () => {
    try {
      await navigator.clipboard.writeText(button.parentElement.querySelector("code").textContent);
      button.textContent = "Copied";
    } catch { // not allowed, or not on https
      getSelection().selectAllChildren(button.parentElement.querySelector("code"));
      button.textContent = "Selected";
    }
  });
}
startProfiles(id);
startPolar(id);
const views = await startSpheres();
if (views.has(id)) showPictures(views.get(id).pictures);
else document.getElementById("pictures-note").textContent = "The pictures could not be drawn.";
