// Converts a picture of the user into the environment that the service lights a sphere with.
import { say } from "./app.js";

const [WIDTH, HEIGHT] = [256, 128]; // Size of the sent picture in pixels.
const HEAD = `{'descr': '<f4', 'fortran_order': False, 'shape': (${HEIGHT}, ${WIDTH}, 3)}\n`; // This is the header of a .npy file.

/** Converts a picture to linear RGB in a .npy file; without a file, the message says that the picture is no panorama. @param {File} file */
export async function readPanorama(file) {
  const { width, height } = await createImageBitmap(file).catch(() => ({ width: 0, height: 0 }));
  if (!width || width !== 2 * height) return say(`${file.name} is no panorama: choose a .png or .jpg picture twice as wide as high, 360 by 180 degrees.`, true);
  const small = await createImageBitmap(file, { resizeWidth: WIDTH, resizeHeight: HEIGHT, resizeQuality: "high" });
  const context = /** @type {OffscreenCanvasRenderingContext2D} */ (new OffscreenCanvas(WIDTH, HEIGHT).getContext("2d"));
  context.drawImage(small, 0, 0);
  const levels = context.getImageData(0, 0, WIDTH, HEIGHT).data.filter((_, i) => i % 4 < 3);
  const linear = Float32Array.from(levels, (level) => (level > 10 ? ((level / 255 + 0.055) / 1.055) ** 2.4 : level / 255 / 12.92));
  return new Blob([Uint8Array.of(0x93), `NUMPY\x01\0${String.fromCharCode(HEAD.length)}\0${HEAD}`, linear]);
}
