/** The depth image as points around the object, and which of its pixels belong to it. */

import type { Body } from "./body";
import type { Frame } from "./frame";

const GRID = 64;
const MOST_POINTS = 60_000;

/** Points kept around the object: shares of the grid's edge from its middle and above the floor. */
const AROUND = 0.95;
const BELOW = -0.05;
const ABOVE = 1.1;

export interface Cloud {
  /** Of each pixel, whether the service took it for the object. */
  held: Uint8Array;
  /** Places in edges of the grid, its middle on the floor at the origin. */
  places: Float32Array;
  /** Of each place, whether it is the object's. */
  own: Uint8Array;
}

export function cloudOf(frame: Frame, body: Body): Cloud {
  const { width, height, depth, camera } = frame;
  const [r0, r1, r2] = body.gridFromCamera.map((row) => row.map((value) => value / body.edge)) as [number[], number[], number[]];
  const [a0, a1, a2, a3] = r0 as [number, number, number, number];
  const [b0, b1, b2, b3] = r1 as [number, number, number, number];
  const [c0, c1, c2, c3] = r2 as [number, number, number, number];
  const step = Math.max(1, Math.ceil(Math.sqrt((width * height) / MOST_POINTS / 4)));
  const held = new Uint8Array(width * height);
  const places: number[] = [];
  const own: number[] = [];
  for (let v = 0, i = 0; v < height; v++) {
    const across = (v - camera.cy) / camera.fy;
    for (let u = 0; u < width; u++, i++) {
      const z = depth[i]!;
      if (!(z > 0)) continue;
      const x = ((u - camera.cx) / camera.fx) * z;
      const y = across * z;
      const px = a0 * x + a1 * y + a2 * z + a3 - 0.5;
      const py = b0 * x + b1 * y + b2 * z + b3 - 0.5;
      const pz = c0 * x + c1 * y + c2 * z + c3;
      if (px * px + py * py > AROUND * AROUND || pz < BELOW || pz > ABOVE) continue;
      const mine = body.sees(Math.floor((px + 0.5) * GRID), Math.floor((py + 0.5) * GRID), Math.floor(pz * GRID));
      if (mine) held[i] = 1;
      if (u % step || v % step || (!mine && (u / step + v / step) % 2)) continue;
      places.push(px, py, pz);
      own.push(mine ? 1 : 0);
    }
  }
  return { held, places: Float32Array.from(places), own: Uint8Array.from(own) };
}
