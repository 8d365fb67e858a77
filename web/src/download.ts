/** The result as files, by three.js's own writers: PLY in the camera's frame for robots, glTF upright for viewers. */

import { BufferAttribute, BufferGeometry, Color, DoubleSide, Mesh, MeshStandardMaterial, Scene, SRGBColorSpace } from "three";
import { GLTFExporter } from "three/examples/jsm/exporters/GLTFExporter.js";
import { PLYExporter } from "three/examples/jsm/exporters/PLYExporter.js";
import type { Body } from "./body";
import { DISPLACEMENT } from "./ramp";
import { rotate, type Vec3 } from "./vec";
import type { Skin } from "./skin";

type Change = (v: Vec3) => Vec3;

export function save(name: string, data: BlobPart, type: string): void {
  const url = URL.createObjectURL(new Blob([data], { type }));
  const link = document.createElement("a");
  link.href = url;
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(url), 10_000);
}

/** Binary PLY of one surface: metres in the camera frame, normals, colour, displacement and uncertainty in metres. */
export function ply(skin: Skin, body: Body, scaleM: number): ArrayBuffer {
  const mesh = meshOf(skin, (v) => body.toCamera(v), (v) => rotate(body.cameraFromGrid, v));
  // The exporter's own colours would be floats, which not every reader of PLY takes for colours.
  mesh.geometry.setAttribute("screen", new BufferAttribute(Uint8Array.from(coloursOf(skin, scaleM).flat()), 3));
  const customPropertyMapping = { screen: ["red", "green", "blue"], displacement: ["displacement"], uncertainty: ["uncertainty"] };
  return new PLYExporter().parse(mesh, () => {}, { binary: true, littleEndian: true, customPropertyMapping })!;
}

/** Binary glTF with the nodes `reconstruction` and `deformed`: metres, y up, standing on y = 0. */
export async function glb(rest: Skin, deformed: Skin, body: Body, scaleM: number): Promise<ArrayBuffer> {
  const scene = new Scene();
  scene.userData = { camera_from_grid: body.cameraFromGrid, voxel_size_m: body.pitch };
  const upright: Change = ([x, y, z]) => [(x - 32) * body.pitch, z * body.pitch, (32 - y) * body.pitch];
  for (const [name, skin] of [["reconstruction", rest], ["deformed", deformed]] as const) {
    const mesh = meshOf(skin, upright, ([x, y, z]) => [x, z, -y]);
    const linear = coloursOf(skin, scaleM).flatMap(([red, green, blue]) =>
      [...new Color().setRGB(red / 255, green / 255, blue / 255, SRGBColorSpace).toArray(), 1].map((share) => Math.round(255 * share)),
    );
    mesh.geometry.setAttribute("color", new BufferAttribute(Uint8Array.from(linear), 4, true));
    mesh.name = name;
    scene.add(mesh);
  }
  return (await new GLTFExporter().parseAsync(scene, { binary: true })) as ArrayBuffer;
}

/** Of each point, as screens show them. */
function coloursOf(skin: Skin, scaleM: number): Vec3[] {
  return Array.from(skin.displacement, (moved) => {
    const entry = 3 * Math.min(255, Math.round((255 * moved) / scaleM));
    return [DISPLACEMENT[entry]!, DISPLACEMENT[entry + 1]!, DISPLACEMENT[entry + 2]!];
  });
}

function meshOf(skin: Skin, place: Change, turn: Change): Mesh {
  const changed = (vectors: Float32Array, change: Change): BufferAttribute => {
    const out = new Float32Array(vectors.length);
    for (let at = 0; at < out.length; at += 3) out.set(change([vectors[at]!, vectors[at + 1]!, vectors[at + 2]!]), at);
    return new BufferAttribute(out, 3);
  };
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", changed(skin.positions, place));
  geometry.setAttribute("normal", changed(skin.normals, turn));
  geometry.setAttribute("displacement", new BufferAttribute(skin.displacement, 1));
  geometry.setAttribute("uncertainty", new BufferAttribute(skin.uncertainty, 1));
  geometry.setIndex(new BufferAttribute(skin.triangles, 1));
  return new Mesh(geometry, new MeshStandardMaterial({ vertexColors: true, metalness: 0, roughness: 0.9, side: DoubleSide }));
}
