/**
 * A surface through a field of values: one vertex in each cell that the surface crosses, at the mean of its crossings
 * (Gibson, "Constrained elastic surface nets", 1998). Smooth where the field is, and closed: beyond its sides is 0.
 */

/** Values on a lattice, indexed [x, y, z] with z fastest. */
export interface Field {
  values: Float32Array;
  size: readonly [number, number, number];
}

export interface Surface {
  /** Places in steps of the lattice, value (0, 0, 0) at the origin. */
  positions: Float32Array;
  /** Unit normals towards lower values. */
  normals: Float32Array;
  triangles: Uint32Array;
}

/** Lattice steps from a cell's first corner to its others; bit 0 is z, bit 1 is y, bit 2 is x. */
const EDGES: readonly (readonly [number, number])[] = [
  [0, 1], [2, 3], [4, 5], [6, 7],
  [0, 2], [1, 3], [4, 6], [5, 7],
  [0, 4], [1, 5], [2, 6], [3, 7],
]; // prettier-ignore

export function surfaceNets(field: Field, iso: number): Surface {
  // One layer of zeros around closes the surface.
  const [nx, ny, nz] = [field.size[0] + 2, field.size[1] + 2, field.size[2] + 2];
  const [sx, sy] = [ny * nz, nz];
  const padded = new Float32Array(nx * sx);
  for (let x = 0; x < field.size[0]; x++) {
    for (let y = 0; y < field.size[1]; y++) {
      const from = (x * field.size[1] + y) * field.size[2];
      padded.set(field.values.subarray(from, from + field.size[2]), (x + 1) * sx + (y + 1) * sy + 1);
    }
  }
  const steps = [0, 1, sy, sy + 1, sx, sx + 1, sx + sy, sx + sy + 1];
  const vertexOf = new Int32Array(nx * sx);
  const places: number[] = [];
  const normals: number[] = [];
  const triangles: number[] = [];
  const corner = new Float32Array(8);

  for (let x = 0; x < nx - 1; x++) {
    for (let y = 0; y < ny - 1; y++) {
      for (let z = 0, at = x * sx + y * sy; z < nz - 1; z++, at++) {
        let inside = 0;
        for (let c = 0; c < 8; c++) {
          const value = padded[at + steps[c]!]!;
          corner[c] = value;
          if (value > iso) inside |= 1 << c;
        }
        if (inside === 0 || inside === 255) continue;
        let [px, py, pz, count] = [0, 0, 0, 0];
        for (const [a, b] of EDGES) {
          if (((inside >> a) & 1) === ((inside >> b) & 1)) continue;
          const t = (iso - corner[a]!) / (corner[b]! - corner[a]!);
          const axis = a ^ b;
          px += (a >> 2) + (axis === 4 ? t : 0);
          py += ((a >> 1) & 1) + (axis === 2 ? t : 0);
          pz += (a & 1) + (axis === 1 ? t : 0);
          count++;
        }
        vertexOf[at] = places.length / 3;
        places.push(x + px / count - 1, y + py / count - 1, z + pz / count - 1);
        const [c0, c1, c2, c3, c4, c5, c6, c7] = corner as unknown as number[];
        const gx = c0! + c1! + c2! + c3! - c4! - c5! - c6! - c7!;
        const gy = c0! + c1! + c4! + c5! - c2! - c3! - c6! - c7!;
        const gz = c0! + c2! + c4! + c6! - c1! - c3! - c5! - c7!;
        const n = Math.hypot(gx, gy, gz) || 1;
        normals.push(gx / n, gy / n, gz / n);
        // A quad around each crossed edge at the cell's first corner; the three cells beside it have been visited.
        const solid = inside & 1;
        if (((inside >> 4) & 1) !== solid && y > 0 && z > 0) {
          quad(triangles, vertexOf, at, at - sy, at - sy - 1, at - 1, solid === 0);
        }
        if (((inside >> 2) & 1) !== solid && x > 0 && z > 0) {
          quad(triangles, vertexOf, at, at - 1, at - sx - 1, at - sx, solid === 0);
        }
        if (((inside >> 1) & 1) !== solid && x > 0 && y > 0) {
          quad(triangles, vertexOf, at, at - sx, at - sx - sy, at - sy, solid === 0);
        }
      }
    }
  }
  return {
    positions: Float32Array.from(places),
    normals: Float32Array.from(normals),
    triangles: Uint32Array.from(triangles),
  };
}

function quad(out: number[], vertexOf: Int32Array, a: number, b: number, c: number, d: number, flip: boolean): void {
  const [i, j, k, l] = [vertexOf[a]!, vertexOf[b]!, vertexOf[c]!, vertexOf[d]!];
  if (flip) out.push(i, k, j, i, l, k);
  else out.push(i, j, k, i, k, l);
}
