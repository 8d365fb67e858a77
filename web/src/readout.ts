/** What is said in words and numbers: the link, the answer's figures and timings, flags, problems. */

import { css, DISPLACEMENT, UNCERTAINTY } from "./ramp";
import { make, need } from "./dom";
import type { Answer, LinkState, Problem } from "./live";
import { mm, plain } from "./units";
import type { Colouring } from "./view";

const FLAGS: Record<string, string> = {
  contact_snapped: "The contact was off the surface and was moved to the nearest point on it.",
  poisson_ratio_clamped: "Poisson's ratio above 0.49 is answered as 0.49.",
  outside_training_range: "Beyond what the model was trained on: take this as a guess.",
  not_balanced: "No balance was found under this push: take this as a guess.",
  leaves_grid: "The body is pushed out of the grid; what lies beyond is cut off.",
  support_not_seen: "No support plane was seen; its place is assumed.",
  up_unknown: "No support plane was seen: which side is held is a guess.",
  object_cut_by_border: "A part of the object lies outside the image.",
};

const LINK: Record<LinkState, string> = { connecting: "Connecting", open: "Live", lost: "Connection lost, trying again" };

/** Stages by what they belong to, in order. */
const STAGES = ["parse", "queue", "decode", "segment", "voxelize", "reconstruct", "align", "deform", "encode"];

/** Rates are those of the last second; after a pause the last one stays, softly. */
const WINDOW_MS = 1000;

export class Readout {
  readonly #notice = need("#notice");
  /** Whether the problem shown is one of the page, which no answer of the service settles. */
  #ours = false;
  #times: number[] = [];
  #pause: ReturnType<typeof setTimeout> | undefined;

  constructor(onToken: (token: string) => void) {
    need("button[aria-label=Dismiss]", this.#notice).addEventListener("click", () => this.clearProblem());
    need<HTMLFormElement>("form", this.#notice).addEventListener("submit", (event) => {
      event.preventDefault();
      onToken(need<HTMLInputElement>("#token").value);
      this.clearProblem();
    });
  }

  link(state: LinkState, model = ""): void {
    const link = need("#link");
    link.dataset.state = state;
    need("span", link).textContent = LINK[state];
    if (model || state !== "open") need(".model", link).textContent = model;
  }

  /** `pageMs` is what the page itself took to mesh and colour. */
  answer(answer: Answer, pageMs: number): void {
    if (!this.#ours) this.clearProblem();
    need("#peak").textContent = mm(answer.max_displacement_m);
    need("#mean").textContent = mm(answer.mean_displacement_m);
    need("#load-number").textContent = answer.load_number === 0 ? "0" : scientific(answer.load_number);
    need("#trip").textContent = `${answer.roundTripMs.toFixed(0)} ms`;
    this.#rate();
    this.#timing(answer, pageMs);
    need("#flags").replaceChildren(
      ...answer.flags.map((flag) => make("li", { textContent: FLAGS[flag] ?? flag.replaceAll("_", " ") })),
    );
  }

  legend(colouring: Colouring, scaleM: number): void {
    const legend = need("#legend");
    legend.hidden = colouring === "plain";
    need("#legend-name").textContent = colouring === "uncertainty" ? "Surface may lie off by" : "Displacement";
    need("i", legend).style.background = css(colouring === "uncertainty" ? UNCERTAINTY : DISPLACEMENT);
    const millimetres = scaleM * 1e3;
    need("#legend-middle").textContent = short(millimetres / 2);
    need("#legend-top").textContent = `${short(millimetres)} mm`;
  }

  problem({ title, detail, code }: Problem): void {
    this.#notice.hidden = false;
    this.#ours = code === "page";
    need("strong", this.#notice).textContent = `${title}.`;
    need("span", this.#notice).textContent = detail;
    need("form", this.#notice).hidden = code !== "unauthenticated";
  }

  clearProblem(): void {
    this.#notice.hidden = true;
  }

  #rate(): void {
    const now = performance.now();
    this.#times = [...this.#times.filter((time) => now - time < WINDOW_MS), now];
    const shown = need("#rate");
    if (this.#times.length > 2) {
      const span = now - this.#times[0]!;
      shown.textContent = `${((1e3 * (this.#times.length - 1)) / span).toFixed(0)} /s`;
      shown.classList.remove("past");
    }
    clearTimeout(this.#pause);
    this.#pause = setTimeout(() => shown.classList.add("past"), WINDOW_MS);
  }

  #timing({ timing_ms: timing, roundTripMs }: Answer, pageMs: number): void {
    const stages = STAGES.filter((stage) => (timing[stage] ?? 0) >= 0.05);
    const outside = Math.max(0, roundTripMs - (timing.total ?? 0));
    const bar = stages.map((stage) => {
      const part = make("i", { title: `${stage}: ${timing[stage]!.toFixed(1)} ms` });
      part.dataset.stage = stage;
      part.style.flexGrow = String(timing[stage]);
      return part;
    });
    const network = make("i", { title: `connection: ${outside.toFixed(1)} ms` });
    network.dataset.stage = "connection";
    network.style.flexGrow = String(outside);
    need("#timing-bar").replaceChildren(...bar, network);
    const longest = [...stages].sort((a, b) => timing[b]! - timing[a]!).slice(0, 4);
    need("#timing-text").textContent = [
      ...stages.filter((stage) => longest.includes(stage)).map((stage) => `${stage} ${timing[stage]!.toFixed(1)}`),
      `service ${(timing.total ?? 0).toFixed(1)} ms`,
      `page ${pageMs.toFixed(1)} ms`,
    ].join(" · ");
  }
}

const short = (millimetres: number): string => plain(millimetres, 2).replace(/\.?0+$/, (zeros) => (zeros.startsWith(".") ? "" : zeros));

function scientific(value: number): string {
  const power = Math.floor(Math.log10(value));
  if (power >= -2) return plain(value, 2);
  const digits = [...String(-power)].map((digit) => "⁰¹²³⁴⁵⁶⁷⁸⁹"[Number(digit)]).join("");
  return `${(value / 10 ** power).toFixed(1)}·10⁻${digits}`;
}
