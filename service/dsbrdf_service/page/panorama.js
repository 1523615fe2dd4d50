// Reads a panorama of one's own, 360 by 180 degrees: a Radiance .hdr file, or a picture that the browser shows.
export const [WIDTH, HEIGHT] = [256, 128];

/** @typedef {(pixel: number, channel: number) => number} Pixels */

/** Linear RGB of WIDTH by HEIGHT pixels, each the mean of what it covers; throws what is wrong with the file. @param {File} file */
export async function readPanorama(file) {
  const bytes = new Uint8Array(await file.arrayBuffer());
  const isRadiance = String.fromCharCode(...bytes.subarray(0, 2)) === "#?";
  const { width, height, values } = isRadiance ? radiance(bytes) : await picture(file);
  if (width !== 2 * height) throw new Error(`A panorama is twice as wide as high, 360 by 180 degrees; ${file.name} has ${width} × ${height} pixels.`);
  return shrink(width, height, values);
}

/** @param {File} file */
async function picture(file) {
  const bitmap = await createImageBitmap(file).catch(() => null);
  if (!bitmap) throw new Error(`${file.name} is no picture that the browser can show, and no .hdr file.`);
  const { width, height } = bitmap;
  const context = /** @type {OffscreenCanvasRenderingContext2D} */ (new OffscreenCanvas(width, height).getContext("2d"));
  context.drawImage(bitmap, 0, 0);
  const { data } = context.getImageData(0, 0, width, height);
  const linear = Float32Array.from({ length: 256 }, (_, i) => (i > 10 ? ((i / 255 + 0.055) / 1.055) ** 2.4 : i / 255 / 12.92));
  return { width, height, values: /** @type {Pixels} */ ((i, channel) => linear[data[4 * i + channel]]) };
}

/** Four bytes a pixel: three mantissas and an exponent, which stand in rows of their own where they are run-length encoded. @param {Uint8Array} bytes */
function radiance(bytes) {
  const head = new TextDecoder("latin1").decode(bytes.subarray(0, 4096));
  const size = /\n\n-Y (\d+) \+X (\d+)\n/.exec(head);
  if (!size) throw new Error("The .hdr file has no head with -Y height +X width.");
  const [height, width] = size.slice(1).map(Number);
  if (width * height > 1 << 26) throw new Error(`The .hdr file has ${width} × ${height} pixels; it may have 8192 × 4096.`);
  const pixels = new Uint8Array(4 * width * height);
  let at = size.index + size[0].length;
  for (let row = 0; row < height; ++row) {
    const line = pixels.subarray(4 * width * row, 4 * width * (row + 1));
    if (bytes[at] !== 2 || bytes[at + 1] !== 2 || bytes[at + 2] * 256 + bytes[at + 3] !== width) {
      line.set(bytes.subarray(at, at + 4 * width));
      at += 4 * width;
      continue;
    }
    at += 4;
    for (let part = 0; part < 4; ++part) {
      for (let x = 0; x < width;) {
        const count = bytes[at++];
        const repeats = count > 128;
        const end = x + (repeats ? count - 128 : count);
        if (!count || end > width) throw new Error(`Row ${row} of the .hdr file is damaged.`);
        for (; x < end; ++x) line[4 * x + part] = bytes[repeats ? at : at++];
        if (repeats) ++at;
      }
    }
  }
  if (at > bytes.length) throw new Error("The .hdr file is cut off.");
  return { width, height, values: /** @type {Pixels} */ ((i, channel) => pixels[4 * i + channel] * 2 ** (pixels[4 * i + 3] - 136)) };
}

/** @param {number} width @param {number} height @param {Pixels} values */
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
