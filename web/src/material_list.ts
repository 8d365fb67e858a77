/** The list of named materials, and the search above it. */

import { make, need } from "./dom";
import { si } from "./units";

export interface NamedMaterial {
  name: string;
  young_modulus_pa: number;
  poisson_ratio: number;
  young_modulus_range_pa: [number, number];
  description: string;
  source: string;
  category?: string;
}

/** Rows that the list opens to while somebody searches. */
const ROWS = 7;

export class MaterialList {
  readonly #select = need<HTMLSelectElement>("#material");
  readonly #search = need<HTMLInputElement>("#material-search");
  #groups: [string, NamedMaterial[]][] = [];
  #materials = new Map<string, NamedMaterial>();
  #chosen = "";

  constructor(chosen: (name: string) => void) {
    const take = (name: string): void => {
      this.#search.value = "";
      chosen(name);
      this.#show();
    };
    this.#select.addEventListener("change", () => {
      if (!this.#search.value) take(this.#select.value);
    });
    // Opened by a search, it is walked with the arrow keys: only a click or Enter takes one.
    this.#select.addEventListener("click", () => {
      if (this.#search.value && this.#select.value) take(this.#select.value);
    });
    this.#select.addEventListener("keydown", (event) => {
      if (!this.#search.value || (event.key !== "Enter" && event.key !== "Escape")) return;
      event.preventDefault();
      take(event.key === "Enter" && this.#select.value ? this.#select.value : this.#chosen);
      this.#search.focus();
    });
    this.#search.addEventListener("input", () => this.#show());
    this.#search.addEventListener("keydown", (event) => {
      const first = this.#search.value ? this.#select.querySelector<HTMLOptionElement>("option:not([disabled])") : null;
      if (event.key === "Enter" && first) take(first.value);
      else if (event.key === "Escape") take(this.#chosen);
      else if (event.key === "ArrowDown" && first) {
        this.#select.value = first.value;
        this.#select.focus();
      } else return;
      event.preventDefault();
    });
  }

  /** The materials, softest first, by category where the service tells them. */
  fill(materials: readonly NamedMaterial[]): void {
    this.#materials = new Map(materials.map((entry) => [entry.name, entry]));
    const groups = new Map<string, NamedMaterial[]>();
    for (const entry of [...materials].sort((a, b) => a.young_modulus_pa - b.young_modulus_pa)) {
      const group = entry.category ?? "";
      groups.set(group, [...(groups.get(group) ?? []), entry]);
    }
    const softness = (entries: NamedMaterial[]): number => entries[Math.floor(entries.length / 2)]!.young_modulus_pa;
    this.#groups = [...groups].sort(([, a], [, b]) => softness(a) - softness(b));
    this.#search.placeholder = `Search ${materials.length} materials`;
    this.#show();
  }

  /** The one that is chosen; null for numbers of one's own. */
  get chosen(): NamedMaterial | null {
    return this.#materials.get(this.#chosen) ?? null;
  }

  /** Choose by name; a name that is not in the list stands for numbers of one's own. */
  choose(name: string): NamedMaterial | null {
    this.#chosen = this.#materials.has(name) ? name : "";
    if (!this.#search.value) this.#select.value = this.#chosen;
    return this.chosen;
  }

  /** All of the list, closed; or, while somebody searches, what fits, opened. */
  #show(): void {
    const words = this.#search.value.toLowerCase().split(/[\s_]+/).filter(Boolean);
    const fits = (entry: NamedMaterial): boolean => {
      const text = `${entry.name.replaceAll("_", " ")} ${entry.category ?? ""} ${entry.description}`.toLowerCase();
      return words.every((word) => text.includes(word));
    };
    const groups = this.#groups.map(([group, entries]) => [group, entries.filter(fits)] as const).filter(([, found]) => found.length);
    const options = groups.flatMap(([group, entries]) => {
      const found = entries.map((entry) =>
        make("option", { value: entry.name, textContent: `${title(entry.name)} · ${si(entry.young_modulus_pa, "Pa", 2)}` }),
      );
      return group ? [make("optgroup", { label: title(group) }, ...found)] : found;
    });
    if (!words.length) this.#select.replaceChildren(make("option", { value: "", textContent: "Custom" }), ...options);
    else if (options.length) this.#select.replaceChildren(...options);
    else this.#select.replaceChildren(make("option", { value: "", disabled: true, textContent: "No material is called that" }));
    this.#select.size = words.length ? Math.max(2, Math.min(ROWS, this.#select.querySelectorAll("option, optgroup").length)) : 0;
    this.#select.value = words.length ? "" : this.#chosen;
  }
}

export const capital = (text: string): string => text.charAt(0).toUpperCase() + text.slice(1);
export const title = (name: string): string => capital(name.replaceAll("_", " "));
