/** The depth image: colours for metres, the contact to set, the arrow of the force to drag. */

import { need, svg } from "./dom";
import { fromDrag } from "./force";
import type { Frame } from "./frame";
import { DEPTH } from "./ramp";
import type { Vec3 } from "./vec";

/** Length of an arrow that lies in the image, and how near its head is taken hold of: shares of the image's width. */
const REACH = 0.15;
const HOLD = 0.035;
const CLICK_PX = 5;

interface Listeners {
  /** A new contact; `done` at the end of the gesture. */
  contact(u: number, v: number, done: boolean): void;
  turn(direction: Vec3): void;
}

export class DepthView {
  readonly #canvas = need<HTMLCanvasElement>("#depth");
  readonly #overlay = need<SVGSVGElement>("#depth-overlay");
  readonly #stage = need("#depth-stage");
  #frame: Frame | null = null;
  #contact: readonly [number, number] | null = null;
  #direction: Vec3 = [0, 0, 1];

  constructor(private readonly listeners: Listeners) {
    this.#listen();
  }

  /** Draw a frame; of the object, whose pixels `held` marks, the colours show the shape, the rest turns grey. */
  show(frame: Frame, held: Uint8Array | null): void {
    this.#frame = frame;
    const { width, height, depth } = frame;
    const whole = usualRange(depth);
    const range = held ? usualRange(depth.filter((_, i) => held[i])) : whole;
    Object.assign(this.#canvas, { width, height });
    this.#overlay.setAttribute("viewBox", `0 0 ${width} ${height}`);
    this.#stage.style.aspectRatio = `${width} / ${height}`;
    const context = this.#canvas.getContext("2d")!;
    const image = context.createImageData(width, height);
    const pixels = image.data;
    for (let i = 0; i < depth.length; i++) {
      const z = depth[i]!;
      if (Number.isNaN(z)) continue;
      const other = held !== null && held[i] === 0;
      const [near, far] = other ? whole : range;
      const entry = 3 * Math.max(0, Math.min(255, Math.round((255 * (z - near)) / (far - near))));
      for (let c = 0; c < 3; c++) pixels[4 * i + c] = other ? 168 - 0.1 * entry : DEPTH[entry + c]!;
      pixels[4 * i + 3] = other ? 120 : 255;
    }
    context.putImageData(image, 0, 0);
    need("#depth-range").textContent = `${held ? "Object " : ""}${range[0].toFixed(2)} to ${range[1].toFixed(2)} m`;
  }

  /** The force as it is now. */
  showForce(contact: readonly [number, number] | null, direction: Vec3): void {
    this.#contact = contact;
    this.#direction = direction;
    this.#overlay.replaceChildren();
    if (!contact || !this.#frame) return;
    const w = this.#frame.width;
    const [u, v] = contact;
    const [hu, hv] = this.#head();
    const length = Math.hypot(hu - u, hv - v);
    const thick = w / 160;
    if (length > 2 * thick) {
      const [eu, ev] = [(hu - u) / length, (hv - v) / length];
      const back = Math.min(length * 0.6, 4.5 * thick);
      const [bu, bv] = [hu - back * eu, hv - back * ev];
      const side = back * 0.5;
      this.#overlay.append(
        svg("line", { class: "halo", x1: u, y1: v, x2: bu, y2: bv, "stroke-width": thick * 2.2 }),
        svg("line", { class: "shaft", x1: u, y1: v, x2: bu, y2: bv, "stroke-width": thick }),
        svg("path", { class: "head", d: `M${hu} ${hv} L${bu - side * ev} ${bv + side * eu} L${bu + side * ev} ${bv - side * eu} Z` }),
      );
    }
    this.#overlay.append(
      svg("circle", { class: "ring", cx: u, cy: v, r: 2.6 * thick, "stroke-width": thick }),
      // As on paper: a dot is an arrow's point coming, a cross its feathers going.
      ...(Math.abs(direction[2]) > 0.5 ? depthSign(u, v, thick, direction[2] > 0) : []),
    );
  }

  #head(): [number, number] {
    const reach = REACH * (this.#frame?.width ?? 0);
    const [u, v] = this.#contact ?? [0, 0];
    return [u + reach * this.#direction[0], v + reach * this.#direction[1]];
  }

  #listen(): void {
    const stage = this.#stage;
    let turning = false;
    let start: [number, number] | null = null;
    let outwards = false;
    const at = (event: PointerEvent): [number, number] => {
      const box = this.#canvas.getBoundingClientRect();
      const zoom = (this.#frame?.width ?? 1) / box.width;
      return [(event.clientX - box.left) * zoom, (event.clientY - box.top) * zoom];
    };
    stage.addEventListener("pointerdown", (event) => {
      if (!this.#frame || event.button !== 0) return;
      const [u, v] = at(event);
      const [hu, hv] = this.#head();
      const width = this.#frame.width;
      stage.setPointerCapture(event.pointerId);
      const onHead = this.#contact !== null && Math.hypot(u - hu, v - hv) < HOLD * width;
      outwards = onHead && this.#direction[2] < 0;
      if (!onHead) this.listeners.contact(u, v, false);
      turning = onHead;
      start = [event.clientX, event.clientY];
    });
    stage.addEventListener("pointermove", (event) => {
      if (!start || !this.#frame || !this.#contact) return;
      if (!turning && Math.hypot(event.clientX - start[0], event.clientY - start[1]) < CLICK_PX) return;
      turning = true;
      const [u, v] = at(event);
      const [cu, cv] = this.#contact;
      this.listeners.turn(fromDrag(u - cu, v - cv, REACH * this.#frame.width, outwards));
    });
    stage.addEventListener("pointerup", () => {
      if (start && this.#contact) this.listeners.contact(...this.#contact, true);
      start = null;
    });
    stage.addEventListener("pointercancel", () => (start = null));
    stage.addEventListener("keydown", (event) => this.#key(event));
  }

  #key(event: KeyboardEvent): void {
    const moves: Record<string, readonly [number, number]> = {
      ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1],
    }; // prettier-ignore
    const move = moves[event.key];
    if (!this.#frame || !move || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    const { width, height } = this.#frame;
    const step = event.shiftKey ? 1 : Math.max(2, Math.round(width / 128));
    const [u, v] = this.#contact ?? [width / 2, height / 2];
    const clamp = (value: number, size: number): number => Math.max(0, Math.min(size - 1, value));
    this.listeners.contact(clamp(u + step * move[0], width), clamp(v + step * move[1], height), true);
  }
}

/** From near to far, without the few readings that lie far off the others. */
function usualRange(depth: Float32Array): [number, number] {
  const sample: number[] = [];
  const step = Math.max(1, Math.floor(depth.length / 5000));
  for (let i = 0; i < depth.length; i += step) if (!Number.isNaN(depth[i]!)) sample.push(depth[i]!);
  sample.sort((a, b) => a - b);
  const near = sample[Math.floor(0.01 * sample.length)] ?? 0;
  const far = sample[Math.floor(0.99 * sample.length)] ?? 1;
  return [near, Math.max(far, near + 0.01)];
}

function depthSign(u: number, v: number, thick: number, away: boolean): SVGElement[] {
  if (!away) return [svg("circle", { class: "head", cx: u, cy: v, r: thick })];
  const d = 1.4 * thick;
  return [svg("path", { class: "cross", d: `M${u - d} ${v - d} L${u + d} ${v + d} M${u - d} ${v + d} L${u + d} ${v - d}`, "stroke-width": thick * 0.8 })];
}
