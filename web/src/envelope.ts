/** Binary messages of /v1/live: `head_length: uint32, head: JSON, parts…`, little-endian. */

export type PartArray = Uint8Array | Int16Array;

export interface Part {
  array: PartArray;
  shape: number[];
  origin: [number, number, number];
  scale: number;
}

interface Described {
  dtype: "uint8" | "int16";
  shape: number[];
  origin: [number, number, number];
  scale: number;
  offset: number;
}

export function pack(head: object, parts: Record<string, Uint8Array> = {}): Uint8Array<ArrayBuffer> {
  const lengths = Object.fromEntries(Object.entries(parts).map(([name, bytes]) => [name, bytes.length]));
  const text = new TextEncoder().encode(JSON.stringify({ ...head, parts: lengths }));
  const total = 4 + text.length + Object.values(lengths).reduce((sum, n) => sum + n, 0);
  const out = new Uint8Array(total);
  new DataView(out.buffer).setUint32(0, text.length, true);
  out.set(text, 4);
  let at = 4 + text.length;
  for (const bytes of Object.values(parts)) {
    out.set(bytes, at);
    at += bytes.length;
  }
  return out;
}

/** The head and its parts, as views into the message. */
export function unpack<Head>(message: ArrayBuffer): { head: Head; parts: Record<string, Part> } {
  const size = new DataView(message).getUint32(0, true);
  const head = JSON.parse(new TextDecoder().decode(new Uint8Array(message, 4, size))) as Head & {
    parts: Record<string, Described>;
  };
  const parts: Record<string, Part> = {};
  for (const [name, { dtype, shape, origin, scale, offset }] of Object.entries(head.parts)) {
    const count = shape.reduce((product, side) => product * side, 1);
    const at = 4 + size + offset;
    const array = dtype === "uint8" ? new Uint8Array(message, at, count) : new Int16Array(message, at, count);
    parts[name] = { array, shape, origin, scale };
  }
  return { head, parts };
}
