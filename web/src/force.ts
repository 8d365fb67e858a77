/** The direction of a force as an image shows it: an angle in the image and how steeply it goes into the scene. */

import { unit, type Vec3 } from "./vec";

export interface Angles {
  /** In the image, degrees counted from right towards up. */
  turn: number;
  /** Out of the image plane, degrees; positive away from the camera. */
  tilt: number;
}

const DEGREE = Math.PI / 180;

export function fromAngles({ turn, tilt }: Angles): Vec3 {
  const flat = Math.cos(tilt * DEGREE);
  return [flat * Math.cos(turn * DEGREE), -flat * Math.sin(turn * DEGREE), Math.sin(tilt * DEGREE)];
}

export function toAngles([x, y, z]: Vec3): Angles {
  const turn = Math.atan2(-y, x) / DEGREE;
  return { turn: Math.round(turn < 0 ? turn + 360 : turn) % 360, tilt: Math.round(Math.asin(Math.max(-1, Math.min(1, z))) / DEGREE) };
}

/**
 * A drag from the contact as a direction: the arrow lies on a dome over the contact, so that a long drag pushes
 * sideways and a short one into the scene (or out of it, where the force pulled before).
 */
export function fromDrag(du: number, dv: number, reach: number, outwards: boolean): Vec3 {
  const share = Math.hypot(du, dv) / reach;
  if (share >= 1) return unit([du, dv, 0]);
  const depth = Math.sqrt(1 - share * share);
  return unit([du / reach, dv / reach, outwards ? -depth : depth]);
}
