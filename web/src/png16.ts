/** 16-bit grey PNG to counts. A canvas would give eight bits a pixel, so the file is read here. */

const SIGNATURE = [0x89, 0x50, 0x4e, 0x47, 0x0d, 0x0a, 0x1a, 0x0a];

export interface Counts {
  width: number;
  height: number;
  values: Uint16Array;
}

export const isPng = (bytes: Uint8Array): boolean => SIGNATURE.every((value, at) => bytes[at] === value);

/** Raises an `Error` whose message a person can act on. */
export async function decodePng16(bytes: Uint8Array): Promise<Counts> {
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  let width = 0;
  let height = 0;
  const packed: Uint8Array<ArrayBuffer>[] = [];
  for (let at = 8; at + 8 <= bytes.length; ) {
    const size = view.getUint32(at);
    const kind = String.fromCharCode(...bytes.subarray(at + 4, at + 8));
    const data = at + 8;
    if (kind === "IHDR") {
      width = view.getUint32(data);
      height = view.getUint32(data + 4);
      const [depth, colour, , , interlace] = bytes.subarray(data + 8, data + 13);
      if (depth !== 16 || colour !== 0) {
        throw new Error(
          `This PNG has ${depth} bits a channel${colour === 0 ? "" : " and colour"}. A depth image has 16 bits, grey.`,
        );
      }
      if (interlace !== 0) throw new Error("Interlaced PNGs are not read here; save it without interlacing.");
      if (width * height > 64e6) throw new Error(`${width} × ${height} pixels are more than a depth camera has.`);
    } else if (kind === "IDAT") {
      packed.push(new Uint8Array(bytes.subarray(data, data + size)));
    } else if (kind === "IEND") break;
    at = data + size + 4;
  }
  if (width === 0 || packed.length === 0) throw new Error("This PNG ends before its image.");
  const rows = await inflate(packed);
  if (rows.length < height * (2 * width + 1)) throw new Error("This PNG ends before its last row.");
  return { width, height, values: unfilter(rows, width, height) };
}

async function inflate(packed: Uint8Array<ArrayBuffer>[]): Promise<Uint8Array> {
  const stream = new Blob(packed).stream().pipeThrough(new DecompressionStream("deflate"));
  try {
    return new Uint8Array(await new Response(stream).arrayBuffer());
  } catch {
    throw new Error("This PNG is damaged: its image does not unpack.");
  }
}

function unfilter(rows: Uint8Array, width: number, height: number): Uint16Array {
  const stride = 2 * width;
  const values = new Uint16Array(width * height);
  let above = new Uint8Array(stride);
  let line = new Uint8Array(stride);
  for (let y = 0; y < height; y++) {
    const start = y * (stride + 1);
    const filter = rows[start];
    for (let i = 0; i < stride; i++) {
      const left = i < 2 ? 0 : line[i - 2]!;
      const up = above[i]!;
      const corner = i < 2 ? 0 : above[i - 2]!;
      const guess =
        filter === 0 ? 0 : filter === 1 ? left : filter === 2 ? up : filter === 3 ? (left + up) >> 1 : paeth(left, up, corner);
      line[i] = rows[start + 1 + i]! + guess;
    }
    for (let x = 0; x < width; x++) values[y * width + x] = (line[2 * x]! << 8) | line[2 * x + 1]!;
    [above, line] = [line, above];
  }
  return values;
}

function paeth(left: number, up: number, corner: number): number {
  const guess = left + up - corner;
  const [a, b, c] = [Math.abs(guess - left), Math.abs(guess - up), Math.abs(guess - corner)];
  return a <= b && a <= c ? left : b <= c ? up : corner;
}
