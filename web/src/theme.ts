/** Light and dark: the system's choice until a person makes one. */

import { need } from "./dom";

type Theme = "light" | "dark";

const system = matchMedia("(prefers-color-scheme: dark)");

/** Calls `changed` at once and after every change. */
export function watchTheme(changed: () => void): void {
  const button = need<HTMLButtonElement>("#theme");
  const chosen = (): Theme | null => localStorage.getItem("theme") as Theme | null;
  const apply = (): void => {
    const theme = chosen() ?? (system.matches ? "dark" : "light");
    document.documentElement.dataset.theme = theme;
    button.textContent = theme === "dark" ? "Light" : "Dark";
    button.setAttribute("aria-label", `Switch to ${theme === "dark" ? "light" : "dark"} colours`);
    changed();
  };
  button.addEventListener("click", () => {
    localStorage.setItem("theme", document.documentElement.dataset.theme === "dark" ? "light" : "dark");
    apply();
  });
  system.addEventListener("change", apply);
  apply();
}
