// Decodes binary messages. mpsim/viewer/protocol.py defines their format.

export const VERSION = 1, PICTURE = 1, RADII = 2;
const HEADER = 96;

/** The content of a binary message; throws if it is not valid. */
export function decode(buffer) {
  const view = new DataView(buffer);
  if (buffer.byteLength < HEADER || view.getUint32(0, false) !== 0x4d505356) throw new Error("not a picture");
  if (view.getUint8(4) !== VERSION) throw new Error("Another version of mpsim is running. Reload the page.");
  const kind = view.getUint8(5), count = view.getUint32(12, true);
  if (buffer.byteLength !== HEADER + count * (kind === RADII ? 4 : 5)) throw new Error("picture incomplete");
  const stage = view.getUint16(6, true);
  if (kind === RADII) return { kind, stage, radii: new Float32Array(buffer, HEADER, count) };
  const float = (offset) => view.getFloat64(offset, true);
  return {
    kind, stage, count, serial: view.getUint32(8, true), frame: Number(view.getBigUint64(16, true)), time: float(24),
    walls: [float(32), float(40), float(48), float(56)], extent: [float(64), float(72)],
    usual: float(80), fastest: float(88),
    places: new Uint16Array(buffer, HEADER, 2 * count), colours: new Uint8Array(buffer, HEADER + 4 * count, count),
  };
}
