// Reads a panorama of one's own, 360 by 180 degrees: a picture that the browser shows.
export const [WIDTH, HEIGHT] = [256, 128];

/** Linear RGB of WIDTH by HEIGHT pixels, each the mean of what it covers; throws what is wrong with the file. @param {File} file */
export async function readPanorama(file) {
  const bitmap = await createImageBitmap(file).catch(() => null);
  if (!bitmap) throw new Error(`The browser cannot show ${file.name}: choose a .png or .jpg file. For a panorama with more light, save it as .exr and use dsbrdf render.`);
  const { width, height } = bitmap;
  if (width !== 2 * height) throw new Error(`A panorama is twice as wide as high, 360 by 180 degrees; ${file.name} has ${width} × ${height} pixels.`);
  const context = /** @type {OffscreenCanvasRenderingContext2D} */ (new OffscreenCanvas(width, height).getContext("2d"));
  context.drawImage(bitmap, 0, 0);
  const { data } = context.getImageData(0, 0, width, height);
  const linear = Float32Array.from({ length: 256 }, (_, i) => (i > 10 ? ((i / 255 + 0.055) / 1.055) ** 2.4 : i / 255 / 12.92));
  return shrink(width, height, (i, channel) => linear[data[4 * i + channel]]);
}

/** @param {number} width @param {number} height @param {(pixel: number, channel: number) => number} values */
function shrink(width, height, values) {
  const result = new Float32Array(3 * WIDTH * HEIGHT);
  /** @param {number} i @param {number} count @param {number} size */
  const range = (i, count, size) => [Math.floor((i * size) / count), Math.max(Math.ceil(((i + 1) * size) / count), 1)];
  for (let row = 0; row < HEIGHT; ++row) {
    const [top, bottom] = range(row, HEIGHT, height);
    for (let column = 0; column < WIDTH; ++column) {
      const [left, right] = range(column, WIDTH, width);
      for (let channel = 0; channel < 3; ++channel) {
        let sum = 0;
        for (let y = top; y < bottom; ++y) for (let x = left; x < right; ++x) sum += values(y * width + x, channel);
        result[3 * (row * WIDTH + column) + channel] = sum / ((bottom - top) * (right - left));
      }
    }
  }
  return result;
}

/** The panorama turned by degrees: what was in front stands to the right. @param {Float32Array} panorama @param {number} degrees */
export function turned(panorama, degrees) {
  const columns = Math.round((degrees / 360) * WIDTH) % WIDTH;
  const result = new Float32Array(panorama.length);
  for (let start = 0; start < result.length; start += 3 * WIDTH) {
    const line = panorama.subarray(start, start + 3 * WIDTH);
    result.set(line.subarray(0, 3 * (WIDTH - columns)), start + 3 * columns);
    result.set(line.subarray(3 * (WIDTH - columns)), start);
  }
  return result;
}
