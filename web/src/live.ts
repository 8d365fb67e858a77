/** The one connection. Latest wins here too: while two questions are under way, only the newest further one is kept. */

import { pack, unpack, type Part } from "./envelope";
import type { Rigid, Vec3 } from "./vec";

/** An RFC 9457 problem document. */
export interface Problem {
  title: string;
  detail: string;
  code: string;
  field?: string;
}

export interface Material {
  young_modulus_pa: number;
  poisson_ratio: number;
}

/** What changes while the frame stays. */
export interface Push {
  material: Material;
  loads: [{ contact_m: Vec3; force_n: Vec3; patch_radius_m?: number | null }];
  uncertainty_samples?: number;
  reconstruct?: boolean;
}

/** What opens a frame: a push on a depth image. */
export interface Opening {
  camera: object;
  encoding: string;
  depth: Uint8Array;
  push: Push;
}

export interface AnswerHead {
  frame: number;
  body: number;
  model: { name: string; version: string };
  grid: { voxel_size_m: number; camera_from_grid: Rigid };
  threshold: number;
  max_displacement_m: number;
  mean_displacement_m: number;
  load_number: number;
  flags: string[];
  timing_ms: Record<string, number>;
}

export interface Answer extends AnswerHead {
  parts: Record<string, Part>;
  roundTripMs: number;
}

export type LinkState = "connecting" | "open" | "lost";

interface Listeners {
  answer(answer: Answer): void;
  problem(problem: Problem): void;
  state(state: LinkState): void;
  /** The frame has to be sent again on a new connection. */
  reopened(): void;
}

const UNDER_WAY = 2;
const RETRY_MS = [500, 1000, 2000, 4000, 8000];

export class Live {
  #socket: WebSocket | null = null;
  #frame = 0;
  #retries = 0;
  #sent = new Map<number, number>();
  #waiting: Push | null = null;
  #opening: Opening | null = null;
  #token: string | null = null;

  constructor(private readonly listeners: Listeners) {
    this.#connect();
  }

  set token(token: string | null) {
    this.#token = token;
  }

  /** Send a frame, with whatever is under way forgotten. */
  open(opening: Opening): void {
    this.#waiting = null;
    this.#opening = opening;
    this.#flush();
  }

  /** Ask about the body in the frame. */
  push(push: Push): void {
    if (this.#opening) {
      this.#opening = { ...this.#opening, push };
    } else {
      // A search for the object must not get lost when a newer push takes its place.
      const reconstruct = push.reconstruct || this.#waiting?.reconstruct;
      this.#waiting = reconstruct ? { ...push, reconstruct } : push;
    }
    this.#flush();
  }

  #connect(): void {
    this.listeners.state("connecting");
    const url = new URL("/v1/live", location.href);
    url.protocol = url.protocol.replace("http", "ws");
    const socket = new WebSocket(url);
    socket.binaryType = "arraybuffer";
    socket.onopen = () => {
      this.#retries = 0;
      this.listeners.state("open");
      if (this.#opening) this.#flush();
      else this.listeners.reopened();
    };
    socket.onmessage = ({ data }) => this.#receive(data as ArrayBuffer | string);
    socket.onclose = () => {
      this.#sent.clear();
      this.listeners.state("lost");
      setTimeout(() => this.#connect(), RETRY_MS[Math.min(this.#retries++, RETRY_MS.length - 1)]);
    };
    this.#socket = socket;
  }

  #flush(): void {
    const socket = this.#socket;
    if (socket?.readyState !== WebSocket.OPEN) return;
    if (this.#opening) {
      const { camera, encoding, depth, push } = this.#opening;
      const { reconstruct: _, ...rest } = push;
      this.#opening = null;
      this.#waiting = null;
      const request = { camera, depth: { encoding }, ...rest };
      socket.send(pack({ frame: this.#next(), request, token: this.#token }, { depth }));
    } else if (this.#waiting && this.#sent.size < UNDER_WAY) {
      const push = this.#waiting;
      this.#waiting = null;
      socket.send(JSON.stringify({ frame: this.#next(), push, token: this.#token }));
    }
  }

  #next(): number {
    this.#sent.set(++this.#frame, performance.now());
    return this.#frame;
  }

  #receive(data: ArrayBuffer | string): void {
    if (typeof data === "string") {
      const { frame, problem } = JSON.parse(data) as { frame: number | null; problem?: Problem };
      if (frame === null) this.#sent.clear();
      else this.#sent.delete(frame);
      if (problem) this.listeners.problem(problem);
    } else {
      const { head, parts } = unpack<AnswerHead>(data);
      const roundTripMs = performance.now() - (this.#sent.get(head.frame) ?? performance.now());
      this.#sent.delete(head.frame);
      this.listeners.answer({ ...head, parts, roundTripMs });
    }
    this.#flush();
  }
}
