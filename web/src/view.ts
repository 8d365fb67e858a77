/** The 3D view: what was measured, the body at rest and the body under the push. */

import {
  BufferAttribute, BufferGeometry, Color, DoubleSide, DynamicDrawUsage, Mesh, MeshLambertMaterial, Points, PointsMaterial, Raycaster,
  ShaderMaterial, Vector2, Vector3,
} from "three"; // prettier-ignore
import { Arrow } from "./arrow";
import type { Body, Motion } from "./body";
import type { Cloud } from "./cloud";
import { DISPLACEMENT, UNCERTAINTY, type Ramp } from "./ramp";
import { carried, skinOf, type Cut, type Skin } from "./skin";
import { Stage } from "./stage";
import { rotate, type Vec3 } from "./vec";

export type Layer = "observed" | "reconstructed" | "deformed";
export type Colouring = "displacement" | "uncertainty" | "plain";

const GRID = 64;
const ROUND = [1, 1.5, 2, 3, 4, 5, 6, 8];

export class View {
  readonly stage: Stage;
  layers: Record<Layer, boolean> = { observed: true, reconstructed: true, deformed: true };
  colouring: Colouring = "displacement";
  cut: Cut = { axis: null, at: 0.5 };
  body: Body | null = null;
  motion: Motion | null = null;
  restSkin: Skin | null = null;
  deformedSkin: Skin | null = null;
  /** Top of the colour scale in metres. */
  scaleM = 0;

  readonly #arrow: Arrow;
  readonly #solid = new MeshLambertMaterial({ vertexColors: true, side: DoubleSide });
  readonly #ghost = ghostMaterial();
  readonly #rest = new Mesh(new BufferGeometry(), this.#ghost);
  readonly #deformed = new Mesh(new BufferGeometry(), this.#solid);
  readonly #points = new Points(new BufferGeometry(), new PointsMaterial({ size: 1.7, sizeAttenuation: false, vertexColors: true }));
  #cloud: Cloud | null = null;
  #plain = new Color();
  #peakM = 0;
  /** How far each point of the skin has gone, in voxels. */
  #offsets = new Float32Array();

  constructor(
    private readonly canvas: HTMLCanvasElement,
    listeners: { pick(contact: Vec3): void; turn(direction: Vec3): void },
  ) {
    this.stage = new Stage(canvas);
    for (const mesh of [this.#points, this.#deformed, this.#rest]) {
      mesh.frustumCulled = false;
      this.stage.scene.add(mesh);
    }
    this.#rest.renderOrder = 2;
    this.#arrow = new Arrow(this.stage, canvas, (d) => {
      if (this.body) listeners.turn(rotate(this.body.cameraFromGrid, [d.x, d.y, d.z]));
    });
    this.#listen(listeners.pick);
  }

  /** Take the colours of the page. */
  restyle(): number {
    const style = getComputedStyle(this.canvas);
    const colour = (name: string): Color => new Color(style.getPropertyValue(name).trim());
    this.#arrow.colour = style.getPropertyValue("--force").trim();
    this.#plain = colour("--clay");
    this.#ghost.uniforms.colour!.value = colour("--ghost");
    this.#paintPoints();
    this.#recolour();
    return this.body ? this.stage.drawFloor(this.body.edge, colour("--floor")) : 0;
  }

  /** A new body; `look` at it from beside the camera, where it is another one. */
  setBody(body: Body, cloud: Cloud, look: boolean): void {
    this.body = body;
    this.motion = null;
    this.#cloud = cloud;
    this.#points.geometry.dispose();
    this.#points.geometry = new BufferGeometry();
    this.#points.geometry.setAttribute("position", new BufferAttribute(cloud.places, 3));
    this.rebuild();
    if (look) {
      let top = 0;
      for (let i = 2; i < this.restSkin!.positions.length; i += 3) top = Math.max(top, this.restSkin!.positions[i]!);
      this.stage.lookFrom(this.#place(body.toVoxels([0, 0, 0])), (0.5 * top) / GRID);
    }
  }

  setMotion(motion: Motion, peakM: number): void {
    this.motion = motion;
    this.#peakM = peakM;
    this.#buildDeformed();
  }

  clear(): void {
    this.body = this.motion = this.restSkin = this.deformedSkin = null;
    this.#arrow.show(new Vector3(), new Vector3(0, 0, -1), 0, false);
    for (const mesh of [this.#points, this.#deformed, this.#rest]) mesh.visible = false;
    this.stage.invalidate();
  }

  /** After the cut has moved. */
  rebuild(): void {
    if (!this.body) return;
    this.restSkin = skinOf(this.body, this.cut);
    this.#offsets = new Float32Array(this.restSkin.positions.length);
    fill(this.#rest.geometry, this.restSkin);
    this.#buildDeformed();
  }

  /** After a layer or the colouring has changed. */
  refresh(): void {
    const { observed, reconstructed, deformed } = this.layers;
    const both = deformed && this.deformedSkin !== null;
    this.#points.visible = observed && this.body !== null;
    this.#deformed.visible = both;
    this.#rest.visible = reconstructed && this.restSkin !== null;
    this.#rest.material = both ? this.#ghost : (this.#solid as never);
    this.#recolour();
  }

  showForce(contact: Vec3 | null, direction: Vec3, strength: number): void {
    if (!this.body || !contact) return;
    const [x, y, z] = rotate(this.body.gridFromCamera, direction);
    this.#arrow.show(this.#place(this.body.toVoxels(contact)), new Vector3(x, y, z), strength, true);
  }

  #buildDeformed(): void {
    if (this.body && this.motion && this.restSkin) {
      this.motion.carry(this.restSkin.positions, this.#offsets, this.body.pitch);
      this.deformedSkin = carried(this.restSkin, this.#offsets, this.body.pitch);
      fill(this.#deformed.geometry, this.deformedSkin);
    } else {
      this.deformedSkin = null;
    }
    this.refresh();
  }

  #recolour(): void {
    const { body } = this;
    if (!body) return;
    const ramp = this.colouring === "uncertainty" ? UNCERTAINTY : DISPLACEMENT;
    this.scaleM = this.colouring === "uncertainty" ? roundUp(3 * body.pitch) : roundUp(this.#peakM);
    for (const [mesh, skin] of [[this.#rest, this.restSkin], [this.#deformed, this.deformedSkin]] as const) {
      if (!skin) continue;
      const shown = this.colouring === "plain" ? null : skin[this.colouring];
      paint(mesh.geometry, shown, this.scaleM, ramp, this.#plain);
    }
    this.stage.invalidate();
  }

  #place([x, y, z]: Vec3): Vector3 {
    return new Vector3(x / GRID - 0.5, y / GRID - 0.5, z / GRID);
  }

  /** What belongs to the object darker than what does not. */
  #paintPoints(): void {
    if (!this.#cloud) return;
    const style = getComputedStyle(this.canvas);
    const [other, own] = ["--around", "--measured"].map((name) => new Color(style.getPropertyValue(name).trim())) as [Color, Color];
    const colours = new Float32Array(this.#cloud.places.length);
    this.#cloud.own.forEach((mine, i) => (mine ? own : other).toArray(colours, 3 * i));
    this.#points.geometry.setAttribute("color", new BufferAttribute(colours, 3));
    // On a phone's width the same pixels lie closer.
    this.#points.material.size = this.canvas.clientWidth < 600 ? 1 : 1.7;
  }

  /** A click on the body, not the end of a turn, moves the contact there. */
  #listen(pick: (contact: Vec3) => void): void {
    let down: [number, number] | null = null;
    this.canvas.addEventListener("pointerdown", (event) => (down = [event.offsetX, event.offsetY]));
    this.canvas.addEventListener("pointerup", (event) => {
      if (!down || !this.body || Math.hypot(event.offsetX - down[0], event.offsetY - down[1]) > 4) return;
      const at = new Vector2((event.offsetX / this.canvas.clientWidth) * 2 - 1, 1 - (event.offsetY / this.canvas.clientHeight) * 2);
      const caster = new Raycaster();
      caster.setFromCamera(at, this.stage.camera);
      const moved = this.#deformed.visible;
      const hit = caster.intersectObject(moved ? this.#deformed : this.#rest)[0];
      if (!hit) return;
      const place: Vec3 = [(hit.point.x + 0.5) * GRID, (hit.point.y + 0.5) * GRID, hit.point.z * GRID];
      const u = new Float64Array(3);
      // The push is on the body at rest: back to where this material came from.
      if (moved) this.motion?.at(...place, u);
      const { pitch } = this.body;
      pick(this.body.toCamera([place[0] - u[0]! / pitch, place[1] - u[1]! / pitch, place[2] - u[2]! / pitch]));
    });
  }
}

/** A round number not below the value. */
export function roundUp(value: number): number {
  if (!(value > 0)) return 0.001;
  const power = 10 ** Math.floor(Math.log10(value));
  return (ROUND.find((step) => step * power >= value * 0.999) ?? 10) * power;
}

function fill(geometry: BufferGeometry, skin: Skin): void {
  const places = new Float32Array(skin.positions.length);
  for (let at = 0; at < places.length; at += 3) {
    places[at] = skin.positions[at]! / GRID - 0.5;
    places[at + 1] = skin.positions[at + 1]! / GRID - 0.5;
    places[at + 2] = skin.positions[at + 2]! / GRID;
  }
  if (geometry.index?.array !== skin.triangles) {
    // Another mesh: the old buffers are freed.
    geometry.dispose();
    geometry.setIndex(new BufferAttribute(skin.triangles, 1));
    for (const name of ["position", "normal", "color"]) geometry.deleteAttribute(name);
  }
  put(geometry, "position", places);
  put(geometry, "normal", skin.normals);
  geometry.boundingSphere = null;
}

function paint(geometry: BufferGeometry, values: Float32Array | null, scaleM: number, ramp: Ramp, plain: Color): void {
  const count = geometry.getAttribute("position").count;
  const colours = new Float32Array(3 * count);
  for (let i = 0; i < count; i++) {
    const entry = values ? 3 * Math.min(255, Math.round((255 * values[i]!) / scaleM)) : 0;
    for (let c = 0; c < 3; c++) {
      colours[3 * i + c] = values ? LINEAR[ramp[entry + c]!]! : c === 0 ? plain.r : c === 1 ? plain.g : plain.b;
    }
  }
  put(geometry, "color", colours);
}

/** New values in the buffer there is, or in a new one. */
function put(geometry: BufferGeometry, name: string, values: Float32Array): void {
  const kept = geometry.getAttribute(name) as BufferAttribute | undefined;
  if (kept?.array.length === values.length) {
    kept.copyArray(values);
    kept.needsUpdate = true;
  } else {
    geometry.setAttribute(name, new BufferAttribute(values, 3).setUsage(DynamicDrawUsage));
  }
}

/** sRGB bytes to linear light. */
const LINEAR = Float32Array.from({ length: 256 }, (_, i) => {
  const s = i / 255;
  return s <= 0.04045 ? s / 12.92 : ((s + 0.055) / 1.055) ** 2.4;
});

/** Its rim shows, its middle hardly: what is behind stays visible. */
function ghostMaterial(): ShaderMaterial {
  return new ShaderMaterial({
    uniforms: { colour: { value: new Color() } },
    transparent: true,
    depthWrite: false,
    vertexShader: `varying float facing;
      void main() {
        vec4 seen = modelViewMatrix * vec4(position, 1.0);
        facing = abs(dot(normalize(normalMatrix * normal), normalize(-seen.xyz)));
        gl_Position = projectionMatrix * seen;
      }`,
    fragmentShader: `uniform vec3 colour;
      varying float facing;
      void main() {
        gl_FragColor = vec4(colour, 0.05 + 0.55 * pow(1.0 - facing, 2.5));
        #include <colorspace_fragment>
      }`,
  });
}
