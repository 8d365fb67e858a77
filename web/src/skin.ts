/** The surface of a body with what is known at each of its points, at rest and carried along by a push. */

import type { Body } from "./body";
import { surfaceNets, type Field } from "./surface_nets";
import type { Vec3 } from "./vec";

export interface Cut {
  axis: 0 | 1 | 2 | null;
  /** Share of the grid's edge at which it cuts. */
  at: number;
}

/** A surface in voxels with what is known at each vertex, in metres. */
export interface Skin {
  positions: Float32Array;
  normals: Float32Array;
  triangles: Uint32Array;
  displacement: Float32Array;
  uncertainty: Float32Array;
}

const GRID = 64;

/** The body at rest. */
export function skinOf(body: Body, cut: Cut): Skin {
  const { field, origin, iso } = body;
  const surface = surfaceNets(cut.axis === null ? field : cutField(field, origin, cut.axis, cut.at * GRID, iso), iso);
  const { positions, normals, triangles } = surface;
  const count = positions.length / 3;
  const uncertainty = new Float32Array(count);
  for (let i = 0, at = 0; i < count; i++, at += 3) {
    for (let axis = 0; axis < 3; axis++) positions[at + axis]! += origin[axis]! + 0.5;
    uncertainty[i] = body.uncertainty(
      positions[at]!, positions[at + 1]!, positions[at + 2]!, normals[at]!, normals[at + 1]!, normals[at + 2]!,
    ); // prettier-ignore
  }
  return { positions, normals, triangles, displacement: new Float32Array(count), uncertainty };
}

/** A skin whose points have gone somewhere, in voxels. */
export function carried(skin: Skin, offsets: Float32Array, pitch: number): Skin {
  const positions = new Float32Array(skin.positions.length);
  for (let at = 0; at < positions.length; at++) positions[at] = skin.positions[at]! + offsets[at]!;
  const displacement = new Float32Array(skin.displacement.length);
  for (let i = 0, at = 0; i < displacement.length; i++, at += 3) {
    displacement[i] = pitch * Math.hypot(offsets[at]!, offsets[at + 1]!, offsets[at + 2]!);
  }
  return { ...skin, positions, displacement, normals: normalsOf(positions, skin.triangles) };
}

/** Unit normals of a mesh: those of its triangles by their areas. */
function normalsOf(places: Float32Array, triangles: Uint32Array): Float32Array {
  const normals = new Float32Array(places.length);
  for (let t = 0; t < triangles.length; t += 3) {
    const a = 3 * triangles[t]!;
    const b = 3 * triangles[t + 1]!;
    const c = 3 * triangles[t + 2]!;
    const ux = places[b]! - places[a]!;
    const uy = places[b + 1]! - places[a + 1]!;
    const uz = places[b + 2]! - places[a + 2]!;
    const vx = places[c]! - places[a]!;
    const vy = places[c + 1]! - places[a + 1]!;
    const vz = places[c + 2]! - places[a + 2]!;
    const nx = uy * vz - uz * vy;
    const ny = uz * vx - ux * vz;
    const nz = ux * vy - uy * vx;
    for (const at of [a, b, c]) {
      normals[at]! += nx;
      normals[at + 1]! += ny;
      normals[at + 2]! += nz;
    }
  }
  for (let at = 0; at < normals.length; at += 3) {
    const n = Math.hypot(normals[at]!, normals[at + 1]!, normals[at + 2]!) || 1;
    normals[at]! /= n;
    normals[at + 1]! /= n;
    normals[at + 2]! /= n;
  }
  return normals;
}

/** Empty beyond a plane, so that the surface closes there and shows what is inside. */
function cutField(field: Field, origin: Vec3, axis: 0 | 1 | 2, plane: number, iso: number): Field {
  const [nx, ny, nz] = field.size;
  const values = new Float32Array(field.values.length);
  for (let x = 0, at = 0; x < nx; x++) {
    for (let y = 0; y < ny; y++) {
      for (let z = 0; z < nz; z++, at++) {
        const place = origin[axis]! + 0.5 + (axis === 0 ? x : axis === 1 ? y : z);
        values[at] = Math.min(field.values[at]!, iso + 255 * (plane - place));
      }
    }
  }
  return { values, size: field.size };
}
