/** A depth frame: the file as it came, for the service, and its metres, for the eye. */

import { decodeNpy, isNpy } from "./npy";
import { decodePng16, isPng } from "./png16";
import { cross, dot, scale, sub, unit, type Vec3 } from "./vec";

/** Pinhole intrinsics in pixels; pixel centres at integer coordinates, as in OpenCV and ROS. */
export interface Camera {
  fx: number;
  fy: number;
  cx: number;
  cy: number;
}

export interface Frame {
  name: string;
  encoding: "png16" | "npy";
  bytes: Uint8Array<ArrayBuffer>;
  width: number;
  height: number;
  /** Metres row by row, NaN where there is no reading. */
  depth: Float32Array;
  camera: Camera;
  /** Whether the camera is a guess that a person should set right. */
  cameraGuessed: boolean;
}

const INTEGER_UNIT_M = 0.001;
const SEARCH_PX = 12;

/** Focal length of the common depth cameras' usual mode (55° wide) in widths of the image. */
const USUAL_FOCAL = 0.96;

/** Raises an `Error` whose message a person can act on. */
export async function readFrame(name: string, bytes: Uint8Array<ArrayBuffer>, camera?: Camera): Promise<Frame> {
  const png = isPng(bytes);
  if (!png && !isNpy(bytes)) throw new Error(`${name} is neither a PNG nor a NumPy file.`);
  const image = png ? await decodePng16(bytes) : decodeNpy(bytes);
  const { width, height, values } = image;
  const unitM = values instanceof Uint16Array ? INTEGER_UNIT_M : 1;
  const depth = new Float32Array(width * height);
  let readings = 0;
  for (let i = 0; i < depth.length; i++) {
    const metres = values[i]! * unitM;
    const valid = Number.isFinite(metres) && metres > 0;
    depth[i] = valid ? metres : NaN;
    if (valid) readings++;
  }
  if (readings === 0) throw new Error(`${name} holds no depth reading at all.`);
  const focal = USUAL_FOCAL * width;
  const guess: Camera = { fx: focal, fy: focal, cx: (width - 1) / 2, cy: (height - 1) / 2 };
  const encoding = png ? "png16" : "npy";
  return { name, encoding, bytes, width, height, depth, camera: camera ?? guess, cameraGuessed: !camera };
}

/** A pixel's point in the camera frame, metres; null without a reading. */
export function pointAt(frame: Frame, u: number, v: number): Vec3 | null {
  const x = Math.round(u);
  const y = Math.round(v);
  if (x < 0 || y < 0 || x >= frame.width || y >= frame.height) return null;
  const z = frame.depth[y * frame.width + x]!;
  if (Number.isNaN(z)) return null;
  const { fx, fy, cx, cy } = frame.camera;
  return [((u - cx) * z) / fx, ((v - cy) * z) / fy, z];
}

/** The nearest pixel with a reading, within a finger's breadth. */
export function nearestReading(frame: Frame, u: number, v: number): [number, number] | null {
  let best: [number, number] | null = null;
  let least = (SEARCH_PX + 0.5) ** 2;
  for (let y = Math.round(v) - SEARCH_PX; y <= v + SEARCH_PX; y++) {
    for (let x = Math.round(u) - SEARCH_PX; x <= u + SEARCH_PX; x++) {
      const far = (x - u) ** 2 + (y - v) ** 2;
      if (far < least && pointAt(frame, x, y)) {
        least = far;
        best = [x, y];
      }
    }
  }
  return best;
}

export function project(camera: Camera, p: Vec3): [number, number] {
  return [camera.cx + (camera.fx * p[0]) / p[2], camera.cy + (camera.fy * p[1]) / p[2]];
}

/** Unit normal of the depth surface at a pixel, away from the surface into the body; null at the rim of the readings. */
export function inwardNormal(frame: Frame, u: number, v: number): Vec3 | null {
  const here = pointAt(frame, u, v);
  if (!here) return null;
  for (const step of [5, 3, 2]) {
    const [left, right] = [pointAt(frame, u - step, v), pointAt(frame, u + step, v)];
    const [up, down] = [pointAt(frame, u, v - step), pointAt(frame, u, v + step)];
    if (!left || !right || !up || !down) continue;
    // Across an edge of the object the difference is no tangent.
    const far = 0.04 * here[2];
    if ([left, right, up, down].some((p) => Math.abs(p[2] - here[2]) > far)) continue;
    const normal = unit(cross(sub(right, left), sub(down, up)));
    return dot(normal, here) < 0 ? scale(normal, -1) : normal;
  }
  return null;
}
