/** Where frames come from: the samples, the file dialogue, and whatever is dropped on the page. */

import { make, need } from "./dom";
import { readFrame, type Camera, type Frame } from "./frame";
import { DEPTH } from "./ramp";
import { loadSample, SAMPLES, type Sample } from "./samples";

type Fail = (error: unknown) => void;

const THUMBNAIL = 4;

/** Tabs above the depth image and pictures in the empty view. */
export function showSources(use: (sample: Sample, frame: Frame) => void, fail: Fail): void {
  for (const sample of SAMPLES) {
    const take = (): void => void loadSample(sample).then((frame) => use(sample, frame), fail);
    const tab = make("button", { type: "button", textContent: sample.name, onclick: take });
    tab.dataset.sample = sample.id;
    tab.setAttribute("aria-pressed", "false");
    need("#tabs").append(tab);
    const canvas = make("canvas", { width: 160, height: 120 });
    const card = make("button", { type: "button", onclick: take }, canvas, sample.name);
    need("#gallery").append(card);
    loadSample(sample).then((frame) => drawThumbnail(canvas, frame), fail);
  }
}

/** Files from the dialogue and from anywhere on the page; a JSON file among them is the camera. */
export function listenForFiles(use: (frame: Frame) => void, useCamera: (camera: Camera) => void, fail: Fail): void {
  const take = async (files: File[]): Promise<void> => {
    const json = files.find((file) => /\.json$/i.test(file.name));
    const image = files.find((file) => file !== json);
    const camera = json ? readCamera(await json.text()) : undefined;
    if (image) use(await readFrame(image.name, new Uint8Array(await image.arrayBuffer()), camera));
    else if (camera) useCamera(camera);
  };
  const input = need<HTMLInputElement>("#file");
  input.addEventListener("change", () => {
    take([...(input.files ?? [])]).catch(fail);
    input.value = "";
  });
  const drop = need("#drop");
  const carriesFiles = (event: DragEvent): boolean => event.dataTransfer?.types.includes("Files") ?? false;
  addEventListener("dragenter", (event) => {
    if (carriesFiles(event)) drop.hidden = false;
  });
  addEventListener("dragover", (event) => event.preventDefault());
  addEventListener("dragleave", (event) => {
    if (event.relatedTarget === null) drop.hidden = true;
  });
  addEventListener("drop", (event) => {
    event.preventDefault();
    drop.hidden = true;
    take([...(event.dataTransfer?.files ?? [])]).catch(fail);
  });
}

/** Raises an `Error` whose message a person can act on. */
function readCamera(text: string): Camera {
  let found: Partial<Record<keyof Camera, unknown>>;
  try {
    found = JSON.parse(text) as typeof found;
  } catch {
    throw new Error("The intrinsics file is not JSON.");
  }
  const { fx, fy, cx, cy } = found;
  const camera = { fx: Number(fx), fy: Number(fy), cx: Number(cx), cy: Number(cy) };
  if (Object.values(camera).some((value) => !Number.isFinite(value))) {
    throw new Error("The intrinsics file needs the numbers fx, fy, cx and cy.");
  }
  return camera;
}

function drawThumbnail(canvas: HTMLCanvasElement, frame: Frame): void {
  const context = canvas.getContext("2d")!;
  const image = context.createImageData(canvas.width, canvas.height);
  for (let y = 0; y < canvas.height; y++) {
    for (let x = 0; x < canvas.width; x++) {
      const z = frame.depth[y * THUMBNAIL * frame.width + x * THUMBNAIL]!;
      if (Number.isNaN(z)) continue;
      const entry = 3 * Math.max(0, Math.min(255, Math.round((255 * (z - 0.36)) / 0.54)));
      image.data.set([DEPTH[entry]!, DEPTH[entry + 1]!, DEPTH[entry + 2]!, 255], 4 * (y * canvas.width + x));
    }
  }
  context.putImageData(image, 0, 0);
}
