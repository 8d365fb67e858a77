/** Vectors of three and rigid transforms, rows of 4×4 as the service sends them. */

export type Vec3 = readonly [number, number, number];
export type Rigid = readonly (readonly number[])[];

export const add = (a: Vec3, b: Vec3): Vec3 => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
export const sub = (a: Vec3, b: Vec3): Vec3 => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
export const scale = (a: Vec3, s: number): Vec3 => [a[0] * s, a[1] * s, a[2] * s];
export const dot = (a: Vec3, b: Vec3): number => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const length = (a: Vec3): number => Math.hypot(a[0], a[1], a[2]);
export const cross = (a: Vec3, b: Vec3): Vec3 => [
  a[1] * b[2] - a[2] * b[1],
  a[2] * b[0] - a[0] * b[2],
  a[0] * b[1] - a[1] * b[0],
];

/** Unit vector along `a`, or `otherwise` where it has no length. */
export function unit(a: Vec3, otherwise: Vec3 = [0, 0, 1]): Vec3 {
  const n = length(a);
  return n > 1e-12 ? scale(a, 1 / n) : otherwise;
}

/** The rotation of `b_from_a` applied to a direction. */
export function rotate(bFromA: Rigid, v: Vec3): Vec3 {
  const row = (i: number): number => bFromA[i]![0]! * v[0] + bFromA[i]![1]! * v[1] + bFromA[i]![2]! * v[2];
  return [row(0), row(1), row(2)];
}

/** `b_from_a` applied to a point. */
export function transform(bFromA: Rigid, p: Vec3): Vec3 {
  return add(rotate(bFromA, p), [bFromA[0]![3]!, bFromA[1]![3]!, bFromA[2]![3]!]);
}

/** Inverse of a rigid transform, by its transpose. */
export function invert(m: Rigid): Rigid {
  const r = (i: number, j: number): number => m[j]![i]!;
  const t: Vec3 = [m[0]![3]!, m[1]![3]!, m[2]![3]!];
  const rows = [0, 1, 2].map((i) => {
    const row: Vec3 = [r(i, 0), r(i, 1), r(i, 2)];
    return [...row, -dot(row, t)];
  });
  return [...rows, [0, 0, 0, 1]];
}
