/** NumPy's `.npy` to a depth image: two dimensions of uint16, float32 or float64. */

export interface Image {
  width: number;
  height: number;
  values: Uint16Array | Float32Array | Float64Array;
}

export const isNpy = (bytes: Uint8Array): boolean =>
  bytes[0] === 0x93 && String.fromCharCode(...bytes.subarray(1, 6)) === "NUMPY";

/** Raises an `Error` whose message a person can act on. */
export function decodeNpy(bytes: Uint8Array): Image {
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  const wide = bytes[6]! >= 2;
  const start = wide ? 12 : 10;
  const end = start + (wide ? view.getUint32(8, true) : view.getUint16(8, true));
  const header = new TextDecoder("latin1").decode(bytes.subarray(start, end));
  const type = /'descr':\s*'([^']+)'/.exec(header)?.[1] ?? "";
  const shape = (/'shape':\s*\(([^)]*)\)/.exec(header)?.[1] ?? "").split(",").map(Number).filter((n) => n > 0);
  if (shape.length !== 2) {
    throw new Error(`This array has the shape (${shape.join(", ")}). A depth image has two sides: rows and columns.`);
  }
  if (/'fortran_order':\s*True/.test(header)) throw new Error("This array is stored column by column; save it in C order.");
  const [height, width] = shape as [number, number];
  const data = bytes.slice(end);
  const make: Record<string, () => Image["values"]> = {
    "<u2": () => new Uint16Array(data.buffer, 0, width * height),
    "<f4": () => new Float32Array(data.buffer, 0, width * height),
    "<f8": () => new Float64Array(data.buffer, 0, width * height),
  };
  if (!(type in make)) throw new Error(`Depth of type ${type || "unknown"} is not read: save it as uint16 or float32.`);
  try {
    return { width, height, values: make[type]!() };
  } catch {
    throw new Error("This array ends before its last row.");
  }
}
