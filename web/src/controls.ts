/** Sliders of force and material, beside the list of named materials. */

import { need } from "./dom";
import type { Angles } from "./force";
import { capital, MaterialList, type NamedMaterial, title } from "./material_list";
import { Slider } from "./slider";
import { plain, si } from "./units";

const degrees = (value: number): string => `${value.toFixed(0)}°`;

/** 12° of the text "12°"; signs and points as typed. */
const number = (text: string): number | null => {
  const value = parseFloat(text.replace(",", ".").replace("−", "-"));
  return Number.isFinite(value) ? value : null;
};

interface Listeners {
  force(): void;
  material(): void;
  turn(angles: Angles): void;
  inwards(): void;
}

export class Controls {
  readonly magnitude: Slider;
  readonly modulus: Slider;
  readonly poisson: Slider;
  readonly #turn: Slider;
  readonly #tilt: Slider;
  readonly #list: MaterialList;

  constructor(private readonly listeners: Listeners) {
    const turned = (): void => listeners.turn({ turn: this.#turn.value, tilt: this.#tilt.value });
    this.magnitude = new Slider({
      id: "magnitude", label: "Magnitude", min: 0.01, max: 1000, log: true, value: 10,
      format: (value) => si(value, "N"), input: () => listeners.force(),
    }); // prettier-ignore
    this.#turn = new Slider({
      id: "turn", label: "Direction in the image", min: 0, max: 360, step: 1, value: 0, format: degrees, parse: number,
      input: turned,
    }); // prettier-ignore
    this.#tilt = new Slider({
      id: "tilt", label: "Away from the camera", min: -90, max: 90, step: 1, value: 0, format: degrees, parse: number,
      input: turned,
    }); // prettier-ignore
    this.modulus = new Slider({
      id: "modulus", label: "Stiffness, Young's modulus", min: 1e3, max: 1e12, log: true, value: 1e6,
      format: (value) => si(value, "Pa"), input: () => this.#custom(),
    }); // prettier-ignore
    this.poisson = new Slider({
      id: "poisson", label: "Poisson's ratio", min: 0, max: 0.5, step: 0.01, value: 0.45, format: (value) => value.toFixed(2),
      parse: number, input: () => this.#custom(),
    }); // prettier-ignore
    need("#force-sliders").append(this.magnitude.element, this.#turn.element, this.#tilt.element);
    need("#material-sliders").append(this.modulus.element, this.poisson.element);
    this.#list = new MaterialList((name) => {
      this.choose(name);
      listeners.material();
    });
    need("#inwards").addEventListener("click", () => listeners.inwards());
  }

  /** Show a direction that came from elsewhere. */
  set angles({ turn, tilt }: Angles) {
    this.#turn.value = turn;
    this.#tilt.value = tilt;
  }

  /** Offer these materials. */
  fill(materials: readonly NamedMaterial[]): void {
    this.#list.fill(materials);
  }

  /** Take a named material's numbers; an unknown name changes nothing. */
  choose(name: string): void {
    const entry = this.#list.choose(name);
    this.modulus.mark(entry ? entry.young_modulus_range_pa : null);
    const about = entry ? `${capital(entry.description)}. ${entry.source}` : "";
    Object.assign(need("#material-about"), { textContent: about, title: about });
    if (!entry) return;
    this.modulus.value = entry.young_modulus_pa;
    this.poisson.value = entry.poisson_ratio;
  }

  /** Its numbers were changed by hand: it is that material only within its range. */
  #custom(): void {
    const entry = this.#list.chosen;
    if (entry) {
      const [low, high] = entry.young_modulus_range_pa;
      const e = this.modulus.value;
      if (e < low * 0.99 || e > high * 1.01 || this.poisson.value !== entry.poisson_ratio) {
        this.#list.choose("");
        need("#material-about").textContent = `Custom, from ${title(entry.name)} (${si(low, "Pa", 2)} to ${si(high, "Pa", 2)}, ν ${plain(entry.poisson_ratio, 2)})`;
      }
    }
    this.listeners.material();
  }
}
