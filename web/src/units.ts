/** Numbers as people write them. */

const PREFIXES: readonly (readonly [number, string])[] = [[1e9, "G"], [1e6, "M"], [1e3, "k"], [1, ""], [1e-3, "m"], [1e-6, "µ"]];

/** Three figures and a prefix: 264000 Pa as "264 kPa". */
export function si(value: number, unit: string, figures = 3): string {
  if (value === 0) return `0 ${unit}`;
  const [factor, prefix] = PREFIXES.find(([f]) => Math.abs(value) >= f * 0.9995) ?? PREFIXES.at(-1)!;
  return `${plain(value / factor, figures)} ${prefix}${unit}`;
}

/** Metres as millimetres. */
export const mm = (metres: number, digits = 1): string => `${(metres * 1e3).toFixed(digits)} mm`;

export function plain(value: number, figures = 3): string {
  const digits = Math.max(0, figures - 1 - Math.floor(Math.log10(Math.abs(value) || 1)));
  return value.toFixed(Math.min(6, digits));
}

/** "1.2 MPa", "120k" or "0,3" as a number in the base unit; null where it is none. */
export function parseSi(text: string): number | null {
  const found = /^\s*([+-]?[\d.,]+(?:e[+-]?\d+)?)\s*([GMkmµu]?)/.exec(text);
  if (!found) return null;
  const number = Number(found[1]!.replace(",", "."));
  const prefix = found[2] === "u" ? "µ" : found[2]!;
  const factor = PREFIXES.find(([, p]) => p === prefix)![0];
  return Number.isFinite(number) ? number * factor : null;
}
