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
  document.getElementById("pictures-note").textContent = names.includes("measured")
    ? "Three lights, one exposure. A black difference is a perfect fit."
    : "The measurement is not stored any more, so the fit is shown alone.";
}

keepInAddress();
const spheres = startSpheres();
if (beside) {
  const id = beside.dataset.fit;
  startProfiles(id);
  startPolar(id);
  const [sphere] = await spheres;
  if (sphere) showPictures(id, sphere.view.pictures);
  else document.getElementById("pictures-note").textContent = "The pictures could not be drawn.";
}
