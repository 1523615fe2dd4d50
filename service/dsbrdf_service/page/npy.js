// Arrays as .npy files, in which the API takes and gives many numbers.

/**
 * A .npy file of little-endian numbers.
 * @param {number[]} shape @param {Float32Array | Float64Array} values
 */
export function toNpy(shape, values) {
  const type = `<f${values.BYTES_PER_ELEMENT}`;
  const text = `{'descr': '${type}', 'fortran_order': False, 'shape': (${shape.join(", ")}${shape.length === 1 ? "," : ""}), }`;
  const head = text.padEnd(Math.ceil((text.length + 11) / 64) * 64 - 11) + "\n";
  const start = [0x93, ...new TextEncoder().encode("NUMPY"), 1, 0, head.length & 255, head.length >> 8];
  return new Blob([new Uint8Array(start), head, /** @type {ArrayBuffer} */ (values.buffer)]);
}

/** The values of a .npy file, in the order of their memory; float16 as the bits. @param {ArrayBuffer} file */
export function fromNpy(file) {
  const [low, high] = new Uint8Array(file, 8, 2);
  const start = 10 + low + 256 * high;
  const type = /'descr': '<f(\d)'/.exec(new TextDecoder("latin1").decode(file.slice(10, start)))?.[1];
  if (type === "2") return new Uint16Array(file, start);
  return type === "4" ? new Float32Array(file, start) : Float64Array.from(new Float64Array(file.slice(start)));
}
