/** The bundled frames, each with a push worth seeing. */

import { readFrame, type Camera, type Frame } from "./frame";
import type { Vec3 } from "./vec";

export interface Sample {
  id: string;
  name: string;
  material: string;
  contact: readonly [number, number];
  forceN: Vec3;
}

export const SAMPLES: readonly Sample[] = [
  { id: "mug", name: "Mug", material: "dragon_skin_10", contact: [365, 215], forceN: [0, 1, 4] },
  { id: "bowl", name: "Bowl", material: "dragon_skin_10", contact: [260, 225], forceN: [1.6, 0.5, 0] },
  { id: "sugar_box", name: "Sugar box", material: "dragon_skin_10", contact: [385, 125], forceN: [9, 0, 4.5] },
];

const kept = new Map<string, Promise<Frame>>();

/** Raises an `Error` whose message a person can act on. */
export function loadSample(sample: Sample): Promise<Frame> {
  if (!kept.has(sample.id)) kept.set(sample.id, fetchSample(sample));
  return kept.get(sample.id)!;
}

async function fetchSample(sample: Sample): Promise<Frame> {
  const base = `${import.meta.env.BASE_URL}samples/${sample.id}`;
  const [image, camera] = await Promise.all([fetch(`${base}/depth.png`), fetch(`${base}/intrinsics.json`)]);
  if (!image.ok || !camera.ok) throw new Error(`The sample ${sample.name} is not there.`);
  const bytes = new Uint8Array(await image.arrayBuffer());
  return readFrame(sample.name, bytes, (await camera.json()) as Camera);
}
