/** The playground: one frame, one push, one live connection, and the views that follow them. */

import "./style.css";
import { Body, Motion } from "./body";
import { cloudOf } from "./cloud";
import { Controls } from "./controls";
import { DepthView } from "./depth_view";
import { need } from "./dom";
import { glb, ply, save } from "./download";
import { fromAngles, toAngles } from "./force";
import { inwardNormal, nearestReading, pointAt, project, type Camera, type Frame } from "./frame";
import { Live, type Answer, type Problem, type Push } from "./live";
import type { NamedMaterial } from "./material_list";
import { Readout } from "./readout";
import { SAMPLES, type Sample } from "./samples";
import { listenForFiles, showSources } from "./sources";
import { watchTheme } from "./theme";
import { listenToTools } from "./tools";
import { length, unit, type Vec3 } from "./vec";
import { View } from "./view";

const CUSTOM_MATERIAL = "dragon_skin_10";
const SETTLE_MS = 350;

class Playground {
  #frame: Frame | null = null;
  #contact: Vec3 | null = null;
  #direction: Vec3 = [0, 0, 1];
  #body: Body | null = null;
  #bodyVersion = -1;
  /** Whether the frame was refused, so that a push has to bring it again. */
  #unopened = false;
  #token: string | null = sessionStorage.getItem("token");
  #looking: ReturnType<typeof setTimeout> | undefined;

  readonly #readout = new Readout((token) => this.#useToken(token));
  readonly #view: View;
  readonly #depth: DepthView;
  readonly #controls: Controls;
  readonly #live: Live;

  constructor() {
    this.#view = new View(need<HTMLCanvasElement>("#view"), {
      pick: (contact) => this.#setContact(contact, true),
      turn: (direction) => this.#setDirection(direction),
    });
    this.#depth = new DepthView({
      contact: (u, v, done) => this.#setPixel(u, v, done),
      turn: (direction) => this.#setDirection(direction),
    });
    this.#controls = new Controls({
      force: () => this.#pushed(),
      material: () => this.#pushed(),
      turn: (angles) => this.#setDirection(fromAngles(angles), false),
      inwards: () => this.#pushInwards(),
    });
    this.#live = new Live({
      answer: (answer) => this.#answered(answer),
      problem: (problem) => this.#refused(problem),
      state: (state) => this.#readout.link(state),
      reopened: () => this.#open(),
    });
    this.#live.token = this.#token;
    this.#listenToPage();
    watchTheme(() => this.#restyle());
    showSources((sample, frame) => this.#useSample(sample, frame), (error) => this.#fail(error));
    listenForFiles((frame) => this.#useFrame(frame), (camera) => this.#useCamera(camera), (error) => this.#fail(error));
    void this.#loadMaterials();
  }

  // --- what is asked ---------------------------------------------------------------------------------------------

  #useSample(sample: Sample, frame: Frame): void {
    this.#controls.choose(sample.material);
    this.#controls.magnitude.value = length(sample.forceN);
    this.#useFrame(frame, sample.contact, unit(sample.forceN));
  }

  /** A new frame: contact in its middle, force into the surface, unless they are told. */
  #useFrame(frame: Frame, pixel?: readonly [number, number], direction?: Vec3): void {
    this.#readout.clearProblem();
    this.#frame = frame;
    this.#body = null;
    this.#bodyVersion = -1;
    this.#view.clear();
    need("#depth-stage").removeAttribute("data-empty");
    need("#empty").hidden = true;
    for (const tab of document.querySelectorAll<HTMLElement>("#tabs button")) {
      tab.setAttribute("aria-pressed", String(tab.textContent === frame.name));
    }
    this.#showCamera(frame.camera, frame.cameraGuessed);
    this.#depth.show(frame, null);
    const [u, v] = pixel ?? nearestReading(frame, frame.width / 2, frame.height / 2) ?? middleReading(frame);
    this.#contact = pointAt(frame, u, v);
    this.#direction = direction ?? inwardNormal(frame, u, v) ?? [0, 0, 1];
    this.#controls.angles = toAngles(this.#direction);
    this.#showForce();
    this.#open();
  }

  #useCamera(camera: Camera): void {
    if (!this.#frame) return;
    const pixel = this.#contact ? project(this.#frame.camera, this.#contact) : undefined;
    this.#useFrame({ ...this.#frame, camera, cameraGuessed: false }, pixel && [Math.round(pixel[0]), Math.round(pixel[1])]);
  }

  #useToken(token: string): void {
    sessionStorage.setItem("token", token);
    this.#token = token;
    this.#live.token = token;
    this.#open();
  }

  #setPixel(u: number, v: number, done: boolean): void {
    const frame = this.#frame;
    if (!frame) return;
    const reading = nearestReading(frame, u, v);
    if (!reading) {
      this.#fail(new Error("The camera has no depth reading there. Choose a place with colour."));
      return;
    }
    if (this.#contact && done) {
      const now = project(frame.camera, this.#contact);
      // The end of a gesture that has set the contact already.
      if (Math.hypot(now[0] - reading[0], now[1] - reading[1]) < 1) return this.#lookAgain();
    }
    this.#setContact(pointAt(frame, ...reading)!, done);
  }

  #setContact(contact: Vec3, done: boolean): void {
    this.#readout.clearProblem();
    this.#contact = contact;
    if (this.#body && this.#isElsewhere(contact)) {
      this.#showForce();
      if (done) this.#lookAgain();
    } else {
      this.#pushed();
    }
  }

  /** A contact on something else means another object: look for it, once the hand rests. */
  #lookAgain(): void {
    clearTimeout(this.#looking);
    this.#looking = setTimeout(() => {
      if (this.#contact && this.#body && this.#isElsewhere(this.#contact)) this.#pushed(true);
    }, SETTLE_MS);
  }

  #isElsewhere(contact: Vec3): boolean {
    const body = this.#body!;
    // Within two voxels it may be its rim, or a place that only the reconstruction has.
    const [x, y, z] = body.toVoxels(contact);
    for (const [dx, dy, dz] of AROUND) if (body.at(x + dx, y + dy, z + dz) > body.iso) return false;
    return true;
  }

  #setDirection(direction: Vec3, show = true): void {
    this.#direction = unit(direction);
    if (show) this.#controls.angles = toAngles(this.#direction);
    this.#pushed();
  }

  #pushInwards(): void {
    const { width = 0, height = 0 } = this.#frame ?? {};
    if (!this.#frame || !this.#contact || width * height === 0) return;
    this.#setDirection(inwardNormal(this.#frame, ...project(this.#frame.camera, this.#contact)) ?? [0, 0, 1]);
  }

  #push(): Push {
    const newtons = this.#controls.magnitude.value;
    const [x, y, z] = this.#direction;
    return {
      material: { young_modulus_pa: this.#controls.modulus.value, poisson_ratio: this.#controls.poisson.value },
      loads: [{ contact_m: this.#contact!, force_n: [newtons * x, newtons * y, newtons * z] }],
    };
  }

  #pushed(reconstruct = false): void {
    if (!this.#frame || !this.#contact) return;
    this.#showForce();
    // A frame that was refused is not there to be pushed.
    if (this.#unopened) return this.#open();
    const push = this.#push();
    this.#live.push(reconstruct ? { ...push, reconstruct } : push);
  }

  #open(): void {
    const frame = this.#frame;
    if (!frame || !this.#contact) return;
    this.#unopened = false;
    const camera = { ...frame.camera, width: frame.width, height: frame.height };
    this.#live.open({ camera, encoding: frame.encoding, depth: frame.bytes, push: this.#push() });
  }

  // --- what comes back -------------------------------------------------------------------------------------------

  #answered(answer: Answer): void {
    const frame = this.#frame;
    if (!frame) return;
    this.#readout.link("open", `${answer.model.name} ${answer.model.version}`);
    const began = performance.now();
    if (answer.parts.rest) {
      const body = new Body(answer);
      const cloud = cloudOf(frame, body);
      this.#view.setBody(body, cloud, answer.body !== this.#bodyVersion);
      this.#bodyVersion = answer.body;
      this.#body = body;
      this.#depth.show(frame, cloud.held);
      this.#restyle();
      for (const part of ["#floor", "#reset"]) need(part).hidden = false;
      for (const button of document.querySelectorAll<HTMLButtonElement>("#save button")) button.disabled = false;
    }
    if (!this.#body || answer.body !== this.#bodyVersion) return;
    this.#view.setMotion(new Motion(answer.parts.displacement!), answer.max_displacement_m);
    this.#showForce();
    this.#readout.answer(answer, performance.now() - began);
    this.#readout.legend(this.#view.colouring, this.#view.scaleM);
    const canvas = need("#view");
    canvas.dataset.answers = String(Number(canvas.dataset.answers ?? 0) + 1);
    canvas.setAttribute("aria-label", `3D view: ${frame.name}, peak displacement ${(answer.max_displacement_m * 1e3).toFixed(1)} mm`);
  }

  #refused(problem: Problem): void {
    this.#unopened = this.#body === null;
    this.#readout.problem(problem);
  }

  #fail(error: unknown): void {
    const detail = error instanceof Error ? error.message : String(error);
    this.#readout.problem({ title: "That did not work", detail, code: "page" });
  }

  // --- what is shown ---------------------------------------------------------------------------------------------

  #showForce(): void {
    const frame = this.#frame;
    if (!frame || !this.#contact) return;
    const pixel = project(frame.camera, this.#contact);
    this.#depth.showForce(pixel, this.#direction);
    const strength = (Math.log10(this.#controls.magnitude.value) + 2) / 5;
    this.#view.showForce(this.#contact, this.#direction, strength);
    need("#contact").textContent =
      `Contact at pixel ${pixel[0].toFixed(0)}, ${pixel[1].toFixed(0)}, ${this.#contact[2].toFixed(3)} m away`;
  }

  #restyle(): void {
    const spacing = this.#view.restyle();
    need("#floor").textContent = spacing ? `Floor grid ${(1e3 * spacing).toFixed(0)} mm` : "";
  }

  #showCamera(camera: Camera, guessed: boolean): void {
    const box = need<HTMLDetailsElement>("#camera");
    need("summary span", box).textContent = guessed
      ? "assumed; set your own"
      : `${camera.fx.toFixed(1)}, ${camera.fy.toFixed(1)}, ${camera.cx.toFixed(1)}, ${camera.cy.toFixed(1)}`;
    box.classList.toggle("guessed", guessed);
    box.open = guessed;
    for (const input of box.querySelectorAll<HTMLInputElement>("input")) {
      input.value = camera[input.dataset.of as keyof Camera].toFixed(2);
    }
  }

  #listenToPage(): void {
    const view = this.#view;
    listenToTools(view, () => {
      if (this.#body) this.#readout.legend(view.colouring, view.scaleM);
    });
    view.stage.onDrawn = () => (need("#view").dataset.drawn = String(view.stage.drawn));
    need("#save").addEventListener("click", (event) => {
      const { kind } = (event.target as HTMLElement).dataset;
      if (kind) this.#save(kind).catch((error: unknown) => this.#fail(error));
    });
    need("#camera").addEventListener("change", () => {
      const values = [...document.querySelectorAll<HTMLInputElement>("#camera input")].map(
        (input) => [input.dataset.of, Number(input.value.replace(",", "."))] as const,
      );
      if (values.some(([, value]) => !Number.isFinite(value))) this.#fail(new Error("Intrinsics are four numbers, in pixels."));
      else this.#useCamera(Object.fromEntries(values) as unknown as Camera);
    });
  }

  async #save(kind: string): Promise<void> {
    const { restSkin, deformedSkin, scaleM } = this.#view;
    if (!this.#frame || !this.#body || !restSkin || !deformedSkin) return;
    const name = `physnet-${this.#frame.name.toLowerCase().replace(/\.[a-z]+$/, "").replace(/[^a-z0-9]+/g, "-")}`;
    if (kind === "ply") save(`${name}.ply`, ply(deformedSkin, this.#body, scaleM), "application/octet-stream");
    else if (kind === "glb") save(`${name}.glb`, await glb(restSkin, deformedSkin, this.#body, scaleM), "model/gltf-binary");
    else await this.#saveNpz(`${name}.npz`);
  }

  /** The service's own archive of everything, asked once more with every output. */
  async #saveNpz(name: string): Promise<void> {
    const { camera, encoding, bytes, width, height } = this.#frame!;
    const outputs = ["reconstruction", "deformed", "probability", "displacement"];
    const request = { camera: { ...camera, width, height }, depth: { encoding }, outputs, ...this.#push() };
    const form = new FormData();
    form.set("request", new Blob([JSON.stringify(request)], { type: "application/json" }));
    form.set("depth", new Blob([bytes]), "depth");
    const reply = await fetch("/v1/deform", { method: "POST", body: form, headers: { Accept: "application/x-npz", ...this.#authorization } });
    if (reply.ok) save(name, await reply.blob(), "application/octet-stream");
    else this.#refused((await reply.json()) as Problem);
  }

  get #authorization(): Record<string, string> {
    return this.#token ? { Authorization: `Bearer ${this.#token}` } : {};
  }

  async #loadMaterials(): Promise<void> {
    try {
      const reply = await fetch("/v1/materials", { headers: this.#authorization });
      if (!reply.ok) return this.#refused((await reply.json()) as Problem);
      const { materials } = (await reply.json()) as { materials: NamedMaterial[] };
      this.#controls.fill(materials);
      this.#controls.choose(CUSTOM_MATERIAL);
    } catch {
      this.#fail(new Error("The list of materials could not be loaded. Is the service still running?"));
    }
    const wanted = SAMPLES.find((sample) => `#${sample.id}` === location.hash);
    if (wanted) need(`#tabs button[data-sample=${wanted.id}]`).click();
  }
}

/** Voxels to look around a contact for the body. */
const AROUND: readonly Vec3[] = [0, 1, 2, 3].flatMap((far): Vec3[] =>
  [[far, 0, 0], [-far, 0, 0], [0, far, 0], [0, -far, 0], [0, 0, far], [0, 0, -far]],
);

function middleReading(frame: Frame): [number, number] {
  let best = 0;
  let least = Infinity;
  for (let i = 0; i < frame.depth.length; i++) {
    if (Number.isNaN(frame.depth[i]!)) continue;
    const far = Math.hypot((i % frame.width) - frame.width / 2, Math.floor(i / frame.width) - frame.height / 2);
    if (far < least) [best, least] = [i, far];
  }
  return [best % frame.width, Math.floor(best / frame.width)];
}

new Playground();
