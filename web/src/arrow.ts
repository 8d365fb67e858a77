/** The force in the 3D view: an arrow whose tip is on the contact and whose tail can be dragged. */

import { ConeGeometry, CylinderGeometry, Group, Mesh, MeshBasicMaterial, MeshLambertMaterial, Plane, Raycaster, SphereGeometry, Vector2, Vector3 } from "three";
import type { Stage } from "./stage";

const LENGTH = 0.42;
const REACH_PX = 24;

export class Arrow {
  readonly #group = new Group();
  readonly #material = new MeshLambertMaterial({ emissiveIntensity: 0.45 });
  readonly #through = new MeshBasicMaterial({ transparent: true, opacity: 0.3, depthTest: false });
  readonly #direction = new Vector3(0, 0, -1);

  /** `onTurn` gets the new direction in the scene while the tail is dragged. */
  constructor(
    private readonly stage: Stage,
    private readonly canvas: HTMLCanvasElement,
    onTurn: (direction: Vector3) => void,
  ) {
    // Built along +y with its tip at the origin.
    const head = new ConeGeometry(0.022, 0.08, 32).translate(0, -0.04, 0);
    const shaft = new CylinderGeometry(0.0065, 0.0065, LENGTH - 0.08, 16).translate(0, -0.08 - (LENGTH - 0.08) / 2, 0);
    const tail = new SphereGeometry(0.015, 24, 16).translate(0, -LENGTH, 0);
    for (const geometry of [head, shaft, tail]) {
      const hidden = new Mesh(geometry, this.#through);
      hidden.renderOrder = 5;
      this.#group.add(new Mesh(geometry, this.#material), hidden);
    }
    this.#group.visible = false;
    stage.scene.add(this.#group);
    this.#listen(onTurn);
  }

  show(contact: Vector3, direction: Vector3, strength: number, visible: boolean): void {
    this.#group.visible = visible;
    this.#group.position.copy(contact);
    this.#direction.copy(direction);
    this.#group.quaternion.setFromUnitVectors(new Vector3(0, 1, 0), direction);
    // Longer and a little thicker with the force, so that the slider is felt.
    this.#group.scale.set(0.8 + 0.5 * strength, 0.65 + 0.6 * strength, 0.8 + 0.5 * strength);
    this.stage.invalidate();
  }

  set colour(css: string) {
    this.#material.color.set(css);
    this.#material.emissive.set(css);
    this.#through.color.set(css);
  }

  get #tail(): Vector3 {
    return this.#direction.clone().multiplyScalar(-LENGTH * this.#group.scale.y).add(this.#group.position);
  }

  /** Whether a place on the canvas, in CSS pixels, is on the tail. */
  #isOnTail(x: number, y: number): boolean {
    const at = this.#tail.project(this.stage.camera);
    const { clientWidth, clientHeight } = this.canvas;
    const [u, v] = [((at.x + 1) / 2) * clientWidth, ((1 - at.y) / 2) * clientHeight];
    return this.#group.visible && Math.hypot(u - x, v - y) < REACH_PX;
  }

  #listen(onTurn: (direction: Vector3) => void): void {
    const plane = new Plane();
    let dragging = false;
    this.canvas.addEventListener(
      "pointerdown",
      (event) => {
        if (!this.#isOnTail(event.offsetX, event.offsetY)) return;
        // Before the orbit gets it.
        event.stopImmediatePropagation();
        this.canvas.setPointerCapture(event.pointerId);
        plane.setFromNormalAndCoplanarPoint(this.stage.camera.getWorldDirection(new Vector3()), this.#tail);
        dragging = true;
      },
      { capture: true },
    );
    this.canvas.addEventListener("pointermove", (event) => {
      if (!dragging) {
        this.canvas.style.cursor = this.#isOnTail(event.offsetX, event.offsetY) ? "grab" : "";
        return;
      }
      const { clientWidth, clientHeight } = this.canvas;
      const at = new Vector2((event.offsetX / clientWidth) * 2 - 1, 1 - (event.offsetY / clientHeight) * 2);
      const caster = new Raycaster();
      caster.setFromCamera(at, this.stage.camera);
      const tail = caster.ray.intersectPlane(plane, new Vector3());
      if (tail) onTurn(this.#group.position.clone().sub(tail).normalize());
    });
    for (const end of ["pointerup", "pointercancel"] as const) {
      this.canvas.addEventListener(end, () => (dragging = false));
    }
  }
}
