/** Sliders of force and material, and the list of named materials. */

import { make, need } from "./dom";
import type { Angles } from "./force";
import { Slider } from "./slider";
import { plain, si } from "./units";

export interface NamedMaterial {
  name: string;
  young_modulus_pa: number;
  poisson_ratio: number;
  young_modulus_range_pa: [number, number];
  description: string;
  source: string;
  category?: string;
}

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
  readonly #select = need<HTMLSelectElement>("#material");
  #materials = new Map<string, NamedMaterial>();

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
    this.#select.addEventListener("change", () => {
      this.choose(this.#select.value);
      listeners.material();
    });
    need("#inwards").addEventListener("click", () => listeners.inwards());
  }

  /** Show a direction that came from elsewhere. */
  set angles({ turn, tilt }: Angles) {
    this.#turn.value = turn;
    this.#tilt.value = tilt;
  }

  /** The list, softest first, by category where the service tells them. */
  fill(materials: readonly NamedMaterial[]): void {
    this.#materials = new Map(materials.map((entry) => [entry.name, entry]));
    const groups = new Map<string, NamedMaterial[]>();
    for (const entry of [...materials].sort((a, b) => a.young_modulus_pa - b.young_modulus_pa)) {
      const group = entry.category ?? "";
      groups.set(group, [...(groups.get(group) ?? []), entry]);
    }
    const softness = (entries: NamedMaterial[]): number => entries[Math.floor(entries.length / 2)]!.young_modulus_pa;
    const ordered = [...groups].sort(([, a], [, b]) => softness(a) - softness(b));
    this.#select.replaceChildren(
      make("option", { value: "", textContent: "Custom" }),
      ...ordered.flatMap(([group, entries]) => {
        const options = entries.map((entry) =>
          make("option", { value: entry.name, textContent: `${title(entry.name)} · ${si(entry.young_modulus_pa, "Pa", 2)}` }),
        );
        return group ? [make("optgroup", { label: title(group) }, ...options)] : options;
      }),
    );
  }

  /** Take a named material's numbers; an unknown name changes nothing. */
  choose(name: string): void {
    const entry = this.#materials.get(name);
    this.#select.value = entry ? name : "";
    this.modulus.mark(entry ? entry.young_modulus_range_pa : null);
    const about = entry ? `${capital(entry.description)}. ${entry.source}` : "";
    Object.assign(need("#material-about"), { textContent: about, title: about });
    if (!entry) return;
    this.modulus.value = entry.young_modulus_pa;
    this.poisson.value = entry.poisson_ratio;
  }

  /** Its numbers were changed by hand: it is that material only within its range. */
  #custom(): void {
    const entry = this.#materials.get(this.#select.value);
    if (entry) {
      const [low, high] = entry.young_modulus_range_pa;
      const e = this.modulus.value;
      if (e < low * 0.99 || e > high * 1.01 || this.poisson.value !== entry.poisson_ratio) {
        this.#select.value = "";
        need("#material-about").textContent = `Custom, from ${title(entry.name)} (${si(low, "Pa", 2)} to ${si(high, "Pa", 2)}, ν ${plain(entry.poisson_ratio, 2)})`;
      }
    }
    this.listeners.material();
  }
}

const capital = (text: string): string => text.charAt(0).toUpperCase() + text.slice(1);
const title = (name: string): string => capital(name.replaceAll("_", " "));
