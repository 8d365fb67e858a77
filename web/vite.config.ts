// Builds into service/web, which ships and is served at `/` and `/web/`. Nothing is loaded from elsewhere at run time.

import { createHash } from "node:crypto";
import { cpSync, mkdirSync, readFileSync, readdirSync, writeFileSync } from "node:fs";
import { join, relative, sep } from "node:path";
import { defineConfig, type Plugin } from "vite";

const HERE = import.meta.dirname;
const FRAMES = join(HERE, "..", "examples", "frames");
const OUT = join(HERE, "..", "service", "web");
const SAMPLES = ["mug", "bowl", "sugar_box"];
const SERVICE = process.env.PHYSNET_URL ?? "http://127.0.0.1:8000";

/** Every file the build is made of, as `tests/e2e/test_playground_build.py` counts them too. */
function sourceFiles(folder = HERE): string[] {
  return readdirSync(folder, { withFileTypes: true }).flatMap((entry) => {
    if (entry.name === "node_modules" || entry.name.startsWith(".")) return [];
    const path = join(folder, entry.name);
    return entry.isDirectory() ? sourceFiles(path) : [path];
  });
}

function sourcesDigest(): string {
  const hash = createHash("sha256");
  const named = sourceFiles().map((path) => [relative(HERE, path).split(sep).join("/"), path] as const);
  for (const [name, path] of named.sort(([a], [b]) => (a < b ? -1 : 1))) {
    hash.update(`${name}\0`).update(readFileSync(path)).update("\0");
  }
  return hash.digest("hex");
}

/** The sample frames, their licence, and what the build was made of. */
function shipped(): Plugin {
  return {
    name: "physnet-shipped",
    apply: "build",
    closeBundle() {
      for (const name of SAMPLES) {
        mkdirSync(join(OUT, "samples", name), { recursive: true });
        for (const file of ["depth.png", "intrinsics.json"]) {
          cpSync(join(FRAMES, name, file), join(OUT, "samples", name, file));
        }
      }
      cpSync(join(FRAMES, "LICENCE-6dof-graspnet.txt"), join(OUT, "samples", "LICENCE-6dof-graspnet.txt"));
      const three = JSON.parse(readFileSync(join(HERE, "node_modules", "three", "package.json"), "utf8"));
      cpSync(join(HERE, "node_modules", "three", "LICENSE"), join(OUT, "assets", "LICENCE-three.txt"));
      const made = { sources_sha256: sourcesDigest(), three: three.version };
      writeFileSync(join(OUT, "build.json"), `${JSON.stringify(made, null, 1)}\n`);
    },
  };
}

export default defineConfig({
  base: "/web/",
  build: { outDir: OUT, emptyOutDir: true, target: "es2023", chunkSizeWarningLimit: 700, modulePreload: { polyfill: false } },
  plugins: [shipped()],
  server: { proxy: { "/v1": { target: SERVICE, ws: true }, "/readyz": SERVICE, "/web/samples": SERVICE } },
});
