// Blocks of numbers from the server: uint32 header length, JSON header, float32 arrays (docs/page.md).

/**
 * @param {ArrayBuffer} buffer
 * @returns {{header: object, arrays: Object<string, Float32Array>, shapes: Object<string, number[]>}}
 */
export function unpack(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  const arrays = {};
  const shapes = {};
  let place = 4 + length;
  for (const { name, shape } of header.arrays) {
    const count = shape.reduce((product, size) => product * size, 1);
    arrays[name] = new Float32Array(buffer, place, count);
    shapes[name] = shape;
    place += 4 * count;
  }
  return { header, arrays, shapes };
}
