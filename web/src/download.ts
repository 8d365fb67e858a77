/** The result as files: PLY in the camera's frame for robots, glTF standing upright for viewers. */

import type { Body } from "./body";
import { DISPLACEMENT } from "./ramp";
import { rotate, type Vec3 } from "./vec";
import type { Skin } from "./skin";

export function save(name: string, data: BlobPart, type: string): void {
  const url = URL.createObjectURL(new Blob([data], { type }));
  const link = document.createElement("a");
  link.href = url;
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(url), 10_000);
}

const colourOf = (skin: Skin, i: number, scaleM: number): [number, number, number] => {
  const entry = 3 * Math.min(255, Math.round((255 * skin.displacement[i]!) / scaleM));
  return [DISPLACEMENT[entry]!, DISPLACEMENT[entry + 1]!, DISPLACEMENT[entry + 2]!];
};

/** Binary PLY of one surface: metres in the camera frame, normals, colour, displacement and uncertainty in metres. */
export function ply(skin: Skin, body: Body, scaleM: number): ArrayBuffer {
  const vertices = skin.positions.length / 3;
  const faces = skin.triangles.length / 3;
  const floats = ["x", "y", "z", "nx", "ny", "nz"].map((name) => `property float ${name}`);
  const header = [
    "ply", "format binary_little_endian 1.0", "comment PhysNet: camera frame, metres",
    `element vertex ${vertices}`, ...floats,
    "property uchar red", "property uchar green", "property uchar blue",
    "property float displacement", "property float uncertainty",
    `element face ${faces}`, "property list uchar int vertex_indices", "end_header", "",
  ].join("\n"); // prettier-ignore
  const text = new TextEncoder().encode(header);
  const out = new ArrayBuffer(text.length + 35 * vertices + 13 * faces);
  new Uint8Array(out).set(text);
  const view = new DataView(out, text.length);
  let at = 0;
  const float = (value: number): void => {
    view.setFloat32(at, value, true);
    at += 4;
  };
  for (let i = 0; i < vertices; i++) {
    const place = Array.from(skin.positions.subarray(3 * i, 3 * i + 3)) as unknown as Vec3;
    const normal = Array.from(skin.normals.subarray(3 * i, 3 * i + 3)) as unknown as Vec3;
    [...body.toCamera(place), ...rotate(body.cameraFromGrid, normal)].forEach(float);
    for (const c of colourOf(skin, i, scaleM)) view.setUint8(at++, c);
    float(skin.displacement[i]!);
    float(skin.uncertainty[i]!);
  }
  for (let f = 0; f < faces; f++) {
    view.setUint8(at++, 3);
    for (let c = 0; c < 3; c++, at += 4) view.setInt32(at, skin.triangles[3 * f + c]!, true);
  }
  return out;
}

/** Binary glTF with the nodes `reconstruction` and `deformed`: metres, y up, standing on y = 0. */
export function glb(rest: Skin, deformed: Skin, body: Body, scaleM: number): ArrayBuffer {
  const chunks: ArrayBufferView<ArrayBuffer>[] = [];
  const bufferViews: object[] = [];
  const accessors: object[] = [];
  let length = 0;
  const put = (array: Float32Array<ArrayBuffer> | Uint32Array<ArrayBuffer> | Uint8Array<ArrayBuffer>, accessor: object, target: number): number => {
    bufferViews.push({ buffer: 0, byteOffset: length, byteLength: array.byteLength, target });
    accessors.push({ bufferView: bufferViews.length - 1, ...accessor });
    chunks.push(array);
    length += array.byteLength; // Always a multiple of four here.
    return accessors.length - 1;
  };
  const mesh = (name: string, skin: Skin): object => {
    const count = skin.positions.length / 3;
    const places = new Float32Array(3 * count);
    const normals = new Float32Array(3 * count);
    const colours = new Uint8Array(4 * count);
    const [low, high] = [[Infinity, Infinity, Infinity], [-Infinity, -Infinity, -Infinity]];
    for (let i = 0; i < count; i++) {
      const [x, y, z] = skin.positions.subarray(3 * i, 3 * i + 3);
      const place = [(x! - 32) * body.pitch, z! * body.pitch, (32 - y!) * body.pitch];
      places.set(place, 3 * i);
      normals.set([skin.normals[3 * i]!, skin.normals[3 * i + 2]!, -skin.normals[3 * i + 1]!], 3 * i);
      // glTF's vertex colours are linear light.
      colours.set([...colourOf(skin, i, scaleM).map((c) => 255 * (c / 255) ** 2.2), 255], 4 * i);
      for (let axis = 0; axis < 3; axis++) {
        low[axis] = Math.min(low[axis]!, places[3 * i + axis]!);
        high[axis] = Math.max(high[axis]!, places[3 * i + axis]!);
      }
    }
    const attributes = {
      POSITION: put(places, { componentType: 5126, count, type: "VEC3", min: low, max: high }, 34962),
      NORMAL: put(normals, { componentType: 5126, count, type: "VEC3" }, 34962),
      COLOR_0: put(colours, { componentType: 5121, normalized: true, count, type: "VEC4" }, 34962),
      _DISPLACEMENT: put(new Float32Array(skin.displacement), { componentType: 5126, count, type: "SCALAR" }, 34962),
      _UNCERTAINTY: put(new Float32Array(skin.uncertainty), { componentType: 5126, count, type: "SCALAR" }, 34962),
    };
    const indices = put(new Uint32Array(skin.triangles), { componentType: 5125, count: skin.triangles.length, type: "SCALAR" }, 34963);
    return { name, primitives: [{ attributes, indices, material: 0 }] };
  };
  const meshes = [mesh("reconstruction", rest), mesh("deformed", deformed)];
  const document = {
    asset: { version: "2.0", generator: "PhysNet playground" },
    scene: 0,
    scenes: [{ nodes: [0, 1] }],
    nodes: [{ name: "reconstruction", mesh: 0 }, { name: "deformed", mesh: 1 }],
    meshes,
    materials: [{ pbrMetallicRoughness: { metallicFactor: 0, roughnessFactor: 0.9 }, doubleSided: true }],
    buffers: [{ byteLength: length }],
    bufferViews,
    accessors,
    extras: { camera_from_grid: body.cameraFromGrid, voxel_size_m: body.pitch },
  };
  let text = JSON.stringify(document);
  text += " ".repeat(-new TextEncoder().encode(text).length & 3);
  const json = new TextEncoder().encode(text);
  const out = new ArrayBuffer(28 + json.length + length);
  const head = new DataView(out);
  [0x46546c67, 2, out.byteLength, json.length, 0x4e4f534a].forEach((word, i) => head.setUint32(4 * i, word, true));
  new Uint8Array(out, 20).set(json);
  let at = 20 + json.length;
  head.setUint32(at, length, true);
  head.setUint32(at + 4, 0x004e4942, true);
  at += 8;
  for (const chunk of chunks) {
    new Uint8Array(out, at, chunk.byteLength).set(new Uint8Array(chunk.buffer, chunk.byteOffset, chunk.byteLength));
    at += chunk.byteLength;
  }
  return out;
}
