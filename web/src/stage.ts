/** The room of the 3D view: renderer, camera, light, floor. Draws only when something has changed. */

import {
  Color, DirectionalLight, Group, HemisphereLight, LineBasicMaterial, LineSegments, BufferGeometry, Float32BufferAttribute,
  PerspectiveCamera, Scene, Vector3, WebGLRenderer, Spherical,
} from "three"; // prettier-ignore
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";

const FIELD_OF_VIEW = 32;
const DISTANCE = 2.35;
const ASIDE = 0.55;
const HIGHEST = 1.15;
const TURN = Math.PI / 24;

/** Below 25 frames a second the picture gets coarser while it moves; at rest it is drawn in full. */
const SLOW_MS = 40;
const COARSEST = 0.5;
const REST_MS = 220;

/** Spacings of the floor's lines in metres. */
const SPACINGS_M = [0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5];

export class Stage {
  readonly scene = new Scene();
  readonly camera = new PerspectiveCamera(FIELD_OF_VIEW, 1, 0.05, 50);
  readonly controls: OrbitControls;
  /** Pictures drawn so far. */
  drawn = 0;
  onDrawn: () => void = () => {};

  readonly #renderer: WebGLRenderer;
  readonly #floor = new Group();
  readonly #home = new Vector3(1.2, -1.9, 1.1);
  #dirty = true;
  #ratio = 1;
  #last = 0;
  #slowness = 0;
  #settle = 0;
  #size = "";

  constructor(private readonly canvas: HTMLCanvasElement) {
    this.#renderer = new WebGLRenderer({ canvas, antialias: true, alpha: true, powerPreference: "high-performance" });
    this.camera.up.set(0, 0, 1);
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.target.set(0, 0, 0.25);
    this.controls.minDistance = 0.5;
    this.controls.maxDistance = 8;
    this.controls.addEventListener("change", () => this.invalidate());
    const key = new DirectionalLight(0xffffff, 1.9);
    key.position.set(-0.6, 0.9, 1);
    // The light stands beside whoever looks.
    this.camera.add(key);
    this.scene.add(this.camera, new HemisphereLight(0xffffff, 0xb8c0c8, 1.5), this.#floor);
    new ResizeObserver(() => this.invalidate()).observe(canvas);
    canvas.addEventListener("keydown", (event) => this.#key(event));
    this.reset();
    requestAnimationFrame(this.#frame);
  }

  invalidate(): void {
    this.#dirty = true;
  }

  /** Look from beside the depth camera, at `from` in the scene, so that a force along its view is seen from the side. */
  lookFrom(from: Vector3, middle: number): void {
    this.controls.target.set(0, 0, middle);
    const away = turned(from.clone().sub(this.controls.target));
    const place = new Spherical().setFromVector3(away);
    place.set(DISTANCE, Math.min(place.phi, HIGHEST), place.theta + ASIDE).makeSafe();
    this.#home.copy(unturned(new Vector3().setFromSpherical(place))).add(this.controls.target);
    this.reset();
  }

  reset(): void {
    const narrow = this.canvas.clientWidth < this.canvas.clientHeight ? 1.25 : 1;
    const middle = this.controls.target;
    this.camera.position.copy(this.#home).sub(middle).multiplyScalar(narrow).add(middle);
    this.controls.update();
    this.invalidate();
  }

  /** Lines on the support plane; returns their spacing in metres. */
  drawFloor(edgeM: number, colour: Color): number {
    for (const old of this.#floor.children) (old as LineSegments).geometry.dispose();
    this.#floor.clear();
    const spacing = SPACINGS_M.find((step) => edgeM / step <= 16) ?? 1;
    const step = spacing / edgeM;
    const reach = 1.1;
    const places: number[] = [];
    const alphas: number[] = [];
    const point = (x: number, y: number): void => {
      places.push(x, y, 0);
      alphas.push(colour.r, colour.g, colour.b, Math.max(0, 1 - Math.hypot(x, y) / reach) ** 1.5);
    };
    const count = Math.floor(reach / step);
    for (let line = -count; line <= count; line++) {
      for (let at = -count; at < count; at++) {
        point(line * step, at * step);
        point(line * step, (at + 1) * step);
        point(at * step, line * step);
        point((at + 1) * step, line * step);
      }
    }
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new Float32BufferAttribute(places, 3));
    geometry.setAttribute("color", new Float32BufferAttribute(alphas, 4));
    this.#floor.add(new LineSegments(geometry, new LineBasicMaterial({ vertexColors: true, transparent: true, depthWrite: false })));
    this.invalidate();
    return spacing;
  }

  readonly #frame = (now: number): void => {
    requestAnimationFrame(this.#frame);
    if (!this.#dirty) {
      if (this.#ratio < 1 && this.#settle !== 0 && now > this.#settle) {
        this.#settle = 0;
        this.#draw(1);
      }
      this.#last = 0;
      return;
    }
    this.#dirty = false;
    if (this.#last !== 0) this.#adapt(now - this.#last);
    this.#last = now;
    this.#settle = now + REST_MS;
    this.#draw(this.#ratio);
  };

  #adapt(elapsed: number): void {
    this.#slowness = 0.7 * this.#slowness + 0.3 * elapsed;
    if (this.#slowness > SLOW_MS && this.#ratio > COARSEST) {
      this.#ratio = Math.max(COARSEST, this.#ratio * 0.8);
      this.#slowness = SLOW_MS;
    }
  }

  #draw(ratio: number): void {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (width === 0 || height === 0) return;
    const size = [width, height, Math.min(devicePixelRatio, 2) * ratio].join();
    if (size !== this.#size) {
      // Only then: it lays out the buffers anew.
      this.#size = size;
      this.#renderer.setDrawingBufferSize(width, height, Math.min(devicePixelRatio, 2) * ratio);
      this.camera.aspect = width / height;
      this.camera.updateProjectionMatrix();
    }
    this.#renderer.render(this.scene, this.camera);
    this.drawn++;
    this.onDrawn();
  }

  #key(event: KeyboardEvent): void {
    const offset = new Spherical().setFromVector3(turned(this.camera.position.clone().sub(this.controls.target)));
    const move: Record<string, () => void> = {
      ArrowLeft: () => (offset.theta -= TURN),
      ArrowRight: () => (offset.theta += TURN),
      ArrowUp: () => (offset.phi -= TURN),
      ArrowDown: () => (offset.phi += TURN),
      "+": () => (offset.radius = Math.max(this.controls.minDistance, offset.radius * 0.9)),
      "-": () => (offset.radius = Math.min(this.controls.maxDistance, offset.radius / 0.9)),
      Home: () => this.reset(),
    };
    const name = event.key === "=" ? "+" : event.key;
    if (!(name in move) || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    move[name]!();
    if (name === "Home") return;
    offset.makeSafe();
    this.camera.position.copy(unturned(new Vector3().setFromSpherical(offset))).add(this.controls.target);
    this.controls.update();
    this.invalidate();
  }
}

/** Three's spherical coordinates take y for up. */
const turned = (v: Vector3): Vector3 => new Vector3(v.x, v.z, -v.y);
const unturned = (v: Vector3): Vector3 => new Vector3(v.x, -v.z, v.y);
