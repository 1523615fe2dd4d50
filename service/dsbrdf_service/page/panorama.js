// Reads a panorama of one's own, 360 by 180 degrees: a picture that the browser shows.
const WIDEST = 256; // pixels

/** Linear RGB of at most WIDEST pixels in a row, each the mean of what it covers; throws what is wrong with the file. @param {File} file */
export async function readPanorama(file) {
  const bitmap = await createImageBitmap(file).catch(() => null);
  if (!bitmap) throw new Error(`The browser cannot show ${file.name}: choose a .png or .jpg file. For a panorama with more light, save it as .exr and use dsbrdf render.`);
  const { width, height } = bitmap;
  if (width !== 2 * height) throw new Error(`A panorama is twice as wide as high, 360 by 180 degrees; ${file.name} has ${width} × ${height} pixels.`);
  const context = /** @type {OffscreenCanvasRenderingContext2D} */ (new OffscreenCanvas(width, height).getContext("2d"));
  context.drawImage(bitmap, 0, 0);
  const { data } = context.getImageData(0, 0, width, height);
  const linear = Float32Array.from({ length: 256 }, (_, i) => (i > 10 ? ((i / 255 + 0.055) / 1.055) ** 2.4 : i / 255 / 12.92));
  const wide = Math.min(width, WIDEST);
  const [sums, counts] = [new Float32Array(1.5 * wide * wide), new Uint32Array(0.5 * wide * wide)];
  for (let i = 0; i < width * height; i += 1) {
    const place = Math.floor((Math.floor(i / width) * wide) / width) * wide + Math.floor(((i % width) * wide) / width);
    counts[place] += 1;
    for (let channel = 0; channel < 3; channel += 1) sums[3 * place + channel] += linear[data[4 * i + channel]];
  }
  return sums.map((sum, i) => sum / counts[Math.floor(i / 3)]);
}

/** The panorama turned by degrees: what was in front stands to the right. @param {Float32Array} pixels @param {number} degrees */
export function turned(pixels, degrees) {
  const wide = Math.sqrt(pixels.length / 1.5);
  const back = 3 * (wide - (Math.round((degrees / 360) * wide) % wide));
  const shape = [wide / 2, wide, 3];
  return { shape, values: pixels.map((_, i) => pixels[i - (i % (3 * wide)) + ((i + back) % (3 * wide))]) };
}
