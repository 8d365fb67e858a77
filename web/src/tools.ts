/** What the 3D view shows: layers, colours, the cut. */

import { need } from "./dom";
import type { Colouring, Layer, View } from "./view";

/** Calls `recoloured` when the meaning of the colours has changed. */
export function listenToTools(view: View, recoloured: () => void): void {
  need("#layers").addEventListener("change", (event) => {
    const box = event.target as HTMLInputElement;
    view.layers[box.value as Layer] = box.checked;
    view.refresh();
  });
  need("#colouring").addEventListener("change", (event) => {
    view.colouring = (event.target as HTMLInputElement).value as Colouring;
    view.refresh();
    recoloured();
  });
  const at = need<HTMLInputElement>("#cut-at");
  need("#cut").addEventListener("input", (event) => {
    const { name, value } = event.target as HTMLInputElement;
    if (name === "cut") view.cut.axis = value === "" ? null : (Number(value) as 0 | 1 | 2);
    view.cut.at = Number(at.value) / 100;
    at.style.setProperty("--at", `${at.value}%`);
    at.disabled = view.cut.axis === null;
    view.rebuild();
  });
  need("#reset").addEventListener("click", () => view.stage.reset());
}
