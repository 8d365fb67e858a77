/** Colour ramps, each rising evenly in lightness contrast so that equal steps look equal; 256 entries of sRGB. */

export type Ramp = Uint8ClampedArray;

function ramp(...stops: string[]): Ramp {
  const rgb = stops.map((hex) => [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16)));
  const out = new Uint8ClampedArray(256 * 3);
  for (let i = 0; i < 256; i++) {
    const place = (i / 255) * (rgb.length - 1);
    const low = Math.min(Math.floor(place), rgb.length - 2);
    for (let c = 0; c < 3; c++) out[3 * i + c] = rgb[low]![c]! + (place - low) * (rgb[low + 1]![c]! - rgb[low]![c]!);
  }
  return out;
}

/** Near to far. */
export const DEPTH = ramp("#f3f7f4", "#b9dcd8", "#76b7c2", "#3f8aa8", "#2b5c88", "#223460", "#161a35");

/** Unmoved material is grey: what moves stands out. */
export const DISPLACEMENT = ramp("#b4bdc5", "#8dbcc0", "#e6c768", "#ef8f3c", "#d7432b", "#8a1538");

export const UNCERTAINTY = ramp("#b4bdc5", "#a3a7d0", "#9379d6", "#7c41c9", "#551a8b");

export const css = (colours: Ramp): string =>
  `linear-gradient(to right, ${[0, 51, 102, 153, 204, 255]
    .map((i) => `rgb(${colours[3 * i]} ${colours[3 * i + 1]} ${colours[3 * i + 2]})`)
    .join(", ")})`;
