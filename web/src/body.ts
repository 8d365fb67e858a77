/** The object in its grid: the reconstructed body, where it was seen, and how the present push moves it. */

import type { Part } from "./envelope";
import type { Answer } from "./live";
import type { Field } from "./surface_nets";
import { invert, transform, type Rigid, type Vec3 } from "./vec";

const GRID = 64;
const NOTHING = -32768;

/** Voxels along the edge of a cell of the displacement field. */
const COARSE = 2;

/** The width over which an ideal step reads as a slope, in voxels: less than that cannot be told from none. */
const SHARPEST = 1;
const LARGEST_SPREAD = 8;

/** Repetitions of y = x + u(y); the damping lets it end where the material is pressed to a third. */
const ROUNDS = 12;
const DAMPING = 0.7;
const CLOSE = 0.03;

export class Body {
  readonly pitch: number;
  readonly cameraFromGrid: Rigid;
  readonly gridFromCamera: Rigid;
  /** Occupancy probability, 0 to 255, on the whole grid. */
  readonly rest: Float32Array;
  /** The same around the body alone, from the voxel `origin` on. */
  readonly field: Field;
  readonly origin: Vec3;
  readonly iso: number;
  readonly observed: Uint8Array | null;

  constructor(answer: Answer) {
    this.pitch = answer.grid.voxel_size_m;
    this.cameraFromGrid = answer.grid.camera_from_grid;
    this.gridFromCamera = invert(this.cameraFromGrid);
    this.iso = 255 * answer.threshold;
    const part = answer.parts.rest!;
    this.rest = spread(part);
    this.field = { values: Float32Array.from(part.array), size: part.shape as [number, number, number] };
    this.origin = part.origin;
    this.observed = (answer.parts.observed?.array as Uint8Array | undefined) ?? null;
  }

  /** Edge of the grid in metres. */
  get edge(): number {
    return GRID * this.pitch;
  }

  /** A point of the camera frame in voxels, voxel (i, j, k) from i to i + 1. */
  toVoxels(point: Vec3): Vec3 {
    const [x, y, z] = transform(this.gridFromCamera, point);
    return [x / this.pitch, y / this.pitch, z / this.pitch];
  }

  toCamera([x, y, z]: Vec3): Vec3 {
    return transform(this.cameraFromGrid, [x * this.pitch, y * this.pitch, z * this.pitch]);
  }

  /** Whether the camera saw the object in a voxel. */
  sees(i: number, j: number, k: number): boolean {
    if (!this.observed || i < 0 || j < 0 || k < 0 || i >= GRID || j >= GRID || k >= GRID) return false;
    const bit = (i * GRID + j) * GRID + k;
    return ((this.observed[bit >> 3]! >> (bit & 7)) & 1) === 1;
  }

  /** Probability at a place in voxels. */
  at(x: number, y: number, z: number): number {
    return trilinear(this.rest, GRID, GRID, GRID, x - 0.5, y - 0.5, z - 0.5);
  }

  /**
   * How far the surface may lie from where it is drawn, in metres: half the width over which the probability passes
   * from none to all along the normal, beyond the width that an ideal step has on this grid.
   */
  uncertainty(x: number, y: number, z: number, nx: number, ny: number, nz: number): number {
    const drop = (this.at(x - nx / 2, y - ny / 2, z - nz / 2) - this.at(x + nx / 2, y + ny / 2, z + nz / 2)) / 255;
    const width = Math.min(LARGEST_SPREAD, 1 / Math.max(drop, 0.01));
    return 0.5 * this.pitch * Math.max(0, width - SHARPEST);
  }
}

/** How the present push moves the body. */
export class Motion {
  readonly #cells: Float32Array;
  readonly #size: [number, number, number];
  readonly #origin: Vec3;

  constructor(part: Part) {
    this.#size = part.shape.slice(1) as [number, number, number];
    this.#origin = part.origin;
    this.#cells = extrapolated(part.array as Int16Array, this.#size, part.scale);
  }

  /** Displacement in metres of the material now at a place in voxels; into `out`. */
  at(x: number, y: number, z: number, out: Float64Array): void {
    const [nx, ny, nz] = this.#size;
    const cx = clamp((x - this.#origin[0]) / COARSE - 0.5, nx - 1);
    const cy = clamp((y - this.#origin[1]) / COARSE - 0.5, ny - 1);
    const cz = clamp((z - this.#origin[2]) / COARSE - 0.5, nz - 1);
    const ix = Math.min(cx | 0, nx - 2);
    const iy = Math.min(cy | 0, ny - 2);
    const iz = Math.min(cz | 0, nz - 2);
    const fx = cx - ix;
    const fy = cy - iy;
    const fz = cz - iz;
    let at = (ix * ny + iy) * nz + iz;
    const count = nx * ny * nz;
    const cells = this.#cells;
    for (let axis = 0; axis < 3; axis++, at += count) {
      const near = mix(mix(cells[at]!, cells[at + 1]!, fz), mix(cells[at + nz]!, cells[at + nz + 1]!, fz), fy);
      const next = at + ny * nz;
      const far = mix(mix(cells[next]!, cells[next + 1]!, fz), mix(cells[next + nz]!, cells[next + nz + 1]!, fz), fy);
      out[axis] = mix(near, far, fx);
    }
  }

  /**
   * Where the points of the body at rest have gone: y = x + u(y), since u is told of the material now at y. Solved by
   * damped repetition from `offsets`, the answer to the push before, which then holds this one's.
   *
   * Args:
   *   places: Points at rest in voxels, x y z.
   *   offsets: How far each has gone, in voxels; all zero for a start.
   *   pitch: Edge of a voxel in metres.
   */
  carry(places: Float32Array, offsets: Float32Array, pitch: number): void {
    const u = new Float64Array(3);
    for (let at = 0; at < places.length; at += 3) {
      let dx = offsets[at]!;
      let dy = offsets[at + 1]!;
      let dz = offsets[at + 2]!;
      for (let round = 0; round < ROUNDS; round++) {
        this.at(places[at]! + dx, places[at + 1]! + dy, places[at + 2]! + dz, u);
        const [ex, ey, ez] = [u[0]! / pitch - dx, u[1]! / pitch - dy, u[2]! / pitch - dz];
        dx += DAMPING * ex;
        dy += DAMPING * ey;
        dz += DAMPING * ez;
        if (Math.abs(ex) + Math.abs(ey) + Math.abs(ez) < CLOSE) break;
      }
      offsets[at] = dx;
      offsets[at + 1] = dy;
      offsets[at + 2] = dz;
    }
  }
}

const mix = (a: number, b: number, t: number): number => a + (b - a) * t;
const clamp = (value: number, high: number): number => (value < 0 ? 0 : value > high ? high : value);

/** A part around the body on the whole grid. */
function spread(part: Part): Float32Array {
  const whole = new Float32Array(GRID ** 3);
  const [nx, ny, nz] = part.shape as [number, number, number];
  const [ox, oy, oz] = part.origin;
  for (let x = 0; x < nx; x++) {
    for (let y = 0; y < ny; y++) {
      const from = (x * ny + y) * nz;
      whole.set(part.array.subarray(from, from + nz), ((x + ox) * GRID + y + oy) * GRID + oz);
    }
  }
  return whole;
}

/** The field in metres, continued beyond the body from its nearest cells, so that it can be asked at the surface. */
function extrapolated(stored: Int16Array, [nx, ny, nz]: [number, number, number], scale: number): Float32Array {
  const count = nx * ny * nz;
  const cells = new Float32Array(3 * count);
  let empty: number[] = [];
  const known = new Uint8Array(count);
  for (let at = 0; at < count; at++) {
    if (stored[at] === NOTHING) {
      empty.push(at);
      continue;
    }
    known[at] = 1;
    for (let axis = 0; axis < 3; axis++) cells[axis * count + at] = stored[axis * count + at]! * scale;
  }
  for (let pass = 0; empty.length > 0 && pass < nx + ny + nz; pass++) {
    const still: number[] = [];
    const reached: number[] = [];
    for (const at of empty) {
      const z = at % nz;
      const y = Math.floor(at / nz) % ny;
      const x = Math.floor(at / (ny * nz));
      let [sx, sy, sz, n] = [0, 0, 0, 0];
      const take = (other: number): void => {
        if (!known[other]) return;
        sx += cells[other]!;
        sy += cells[count + other]!;
        sz += cells[2 * count + other]!;
        n++;
      };
      if (x > 0) take(at - ny * nz);
      if (x < nx - 1) take(at + ny * nz);
      if (y > 0) take(at - nz);
      if (y < ny - 1) take(at + nz);
      if (z > 0) take(at - 1);
      if (z < nz - 1) take(at + 1);
      if (n === 0) {
        still.push(at);
        continue;
      }
      cells[at] = sx / n;
      cells[count + at] = sy / n;
      cells[2 * count + at] = sz / n;
      reached.push(at);
    }
    for (const at of reached) known[at] = 1;
    if (reached.length === 0) break;
    empty = still;
  }
  return cells;
}

/** Values between lattice points; 0 beyond the lattice. */
function trilinear(values: Float32Array, nx: number, ny: number, nz: number, x: number, y: number, z: number): number {
  const ix = Math.floor(x);
  const iy = Math.floor(y);
  const iz = Math.floor(z);
  if (ix < -1 || iy < -1 || iz < -1 || ix >= nx || iy >= ny || iz >= nz) return 0;
  const fx = x - ix;
  const fy = y - iy;
  const fz = z - iz;
  const at = (ix * ny + iy) * nz + iz;
  if (ix >= 0 && iy >= 0 && iz >= 0 && ix < nx - 1 && iy < ny - 1 && iz < nz - 1) {
    const next = at + ny * nz;
    const near = mix(mix(values[at]!, values[at + 1]!, fz), mix(values[at + nz]!, values[at + nz + 1]!, fz), fy);
    const far = mix(mix(values[next]!, values[next + 1]!, fz), mix(values[next + nz]!, values[next + nz + 1]!, fz), fy);
    return mix(near, far, fx);
  }
  let sum = 0;
  for (let c = 0; c < 8; c++) {
    const [dx, dy, dz] = [c >> 2, (c >> 1) & 1, c & 1];
    const [px, py, pz] = [ix + dx, iy + dy, iz + dz];
    if (px < 0 || py < 0 || pz < 0 || px >= nx || py >= ny || pz >= nz) continue;
    const weight = (dx ? fx : 1 - fx) * (dy ? fy : 1 - fy) * (dz ? fz : 1 - fz);
    sum += weight * values[(px * ny + py) * nz + pz]!;
  }
  return sum;
}
