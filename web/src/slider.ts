/** A labelled slider with its number beside it, which can be typed as well. */

import { make } from "./dom";
import { parseSi } from "./units";

export interface SliderOptions {
  id: string;
  label: string;
  min: number;
  max: number;
  /** Equal steps of the slider are equal factors. */
  log?: boolean;
  /** Without it the slider has a thousand steps. */
  step?: number;
  value: number;
  format(value: number): string;
  /** From typed text; by default an SI number. */
  parse?(text: string): number | null;
  input(value: number): void;
}

const STEPS = 1000;

export class Slider {
  readonly element: HTMLElement;
  readonly #range: HTMLInputElement;
  readonly #typed: HTMLInputElement;
  #value: number;

  constructor(private readonly options: SliderOptions) {
    const { id, label } = options;
    const steps = options.step ? (options.max - options.min) / options.step : STEPS;
    this.#range = make("input", { type: "range", id, min: "0", max: String(steps), step: "1" });
    this.#typed = make("input", { type: "text", className: "typed", inputMode: "decimal", autocomplete: "off", spellcheck: false });
    this.#typed.setAttribute("aria-label", `${label}, typed`);
    this.element = make("div", { className: "slider" }, make("label", { htmlFor: id, textContent: label }), this.#typed, this.#range);
    this.#value = options.value;
    this.#range.addEventListener("input", () => this.#take(this.#fromShare(Number(this.#range.value) / steps)));
    this.#typed.addEventListener("focus", () => this.#typed.select());
    this.#typed.addEventListener("change", () => {
      const typed = (options.parse ?? parseSi)(this.#typed.value);
      if (typed === null) this.#show();
      else this.#take(Math.min(options.max, Math.max(options.min, typed)));
    });
    this.#show();
  }

  get value(): number {
    return this.#value;
  }

  /** Set without telling anybody. */
  set value(value: number) {
    this.#value = value;
    this.#show();
  }

  /** Mark a stretch of the track, such as the range of a material; null for none. */
  mark(range: readonly [number, number] | null): void {
    const [low, high] = range ? range.map((value) => this.#share(value)) : [0, 0];
    this.#range.style.setProperty("--low", `${100 * low!}%`);
    this.#range.style.setProperty("--high", `${100 * high!}%`);
  }

  #take(value: number): void {
    this.#value = value;
    this.#show();
    this.options.input(value);
  }

  #share(value: number): number {
    const { min, max, log } = this.options;
    const share = log ? Math.log(value / min) / Math.log(max / min) : (value - min) / (max - min);
    return Math.min(1, Math.max(0, share));
  }

  #fromShare(share: number): number {
    const { min, max, log } = this.options;
    return log ? min * (max / min) ** share : min + share * (max - min);
  }

  #show(): void {
    const text = this.options.format(this.#value);
    this.#range.value = String(Math.round(this.#share(this.#value) * Number(this.#range.max)));
    this.#range.style.setProperty("--at", `${100 * this.#share(this.#value)}%`);
    this.#range.setAttribute("aria-valuetext", text);
    this.#typed.value = text;
  }
}
