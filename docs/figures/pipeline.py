"""Draw the pictures of the pipeline's pages from a bundled frame, with the very functions that serve.

    python docs/figures/pipeline.py [--out docs/images/pipeline]

Run it again when models or stages change: `make figures`.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from matplotlib.axes import Axes  # noqa: E402
from matplotlib.colors import ListedColormap  # noqa: E402
from matplotlib.figure import Figure  # noqa: E402

from service.core.alignment import HORIZONTAL_FILL, VERTICAL_FILL, body_grid, resample  # noqa: E402
from service.core.camera import make_intrinsics, pixel_to_point  # noqa: E402
from service.core.covering import cover  # noqa: E402
from service.core.depth import decode_depth  # noqa: E402
from service.core.materials import material_named  # noqa: E402
from service.core.messages import DeformRequest, EncodedImage, Load, Observation  # noqa: E402
from service.core.segmentation import segment  # noqa: E402
from service.core.voxels import voxelize, voxelize_points  # noqa: E402
from service.inference.registry import Models, load_models  # noqa: E402
from service.picture.raycast import view_from_camera  # noqa: E402
from service.picture.shading import solid, voxels  # noqa: E402
from service.pipeline import Pipeline  # noqa: E402
from service.settings import default_models_directory  # noqa: E402

FRAME = ROOT / "examples/frames/mug"
PRESS_PX = (365.0, 215.0)
FORCE_N = (0.0, 1.0, 4.0)
MATERIAL = "dragon_skin_10"

PANEL_PX = 420
DPI = 100
INK, FAINT, FORCE = "#22262b", "#7a828c", "#d3122f"
OBSERVED = np.array([0.96, 0.68, 0.30], np.float32)
BODY = np.array([0.66, 0.75, 0.86], np.float32)
FREE, UNKNOWN = "#e8f1ea", "#9aa3ad"


def main() -> int:
    """Write one picture for each stage."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "docs/images/pipeline")
    given = parser.parse_args()
    for path in draw(load_models(default_models_directory(), threads=2), given.out):
        print(path)
    return 0


def draw(models: Models, out: Path) -> list[Path]:
    """All pictures of one frame on its way through the pipeline."""
    out.mkdir(parents=True, exist_ok=True)
    known = json.loads((FRAME / "intrinsics.json").read_text("utf-8"))
    camera = make_intrinsics(*(known[name] for name in ("fx", "fy", "cx", "cy", "width", "height")))
    image = EncodedImage("png16", (FRAME / "depth.png").read_bytes())
    depth_m = decode_depth(image.encoding, image.data, image.unit_m, camera.width, camera.height)
    contact_m = pixel_to_point(*PRESS_PX, depth_m, camera)
    found = segment(depth_m, camera, contact_m=contact_m)
    assert found.support is not None
    view = voxelize(found.points, depth_m, camera, found.support.normal, found.support.offset_m)
    seen = models.reconstruction(view)
    cut = models.reconstruction.manifest.threshold
    rough = cover(seen > cut, view.observed)
    grid = body_grid(rough, view.grid)
    probability = resample(seen, view.grid, grid)
    occupancy = cover(probability > cut, voxelize_points(found.points, grid))
    pictures = {
        "decode": _decode(image, depth_m, found.pixels),
        "segment": _segment(depth_m, found, camera),
        "voxelize": _voxelize(view),
        "reconstruct": _reconstruct(view, seen, rough, cut),
        "align": _align(view, rough, grid, occupancy),
        "deform": _deform(models, camera, image),
    }
    paths = []
    for name, picture in pictures.items():
        paths.append(out / f"{name}.png")
        if isinstance(picture, bytes):
            paths[-1].write_bytes(picture)
        else:
            picture.savefig(paths[-1], format="png", dpi=DPI)
    return paths


def _figure(panels: int) -> tuple[Figure, list[Axes]]:
    gap, bar = 44, 44  # a colour bar and its numbers stand beside a panel
    width, height = panels * PANEL_PX + (panels - 1) * gap + bar + 12, PANEL_PX + 48
    figure = Figure(figsize=(width / DPI, height / DPI), dpi=DPI, facecolor="white")
    axes = []
    for panel in range(panels):
        axis = figure.add_axes(
            ((12 + panel * (PANEL_PX + gap)) / width, 10 / height, PANEL_PX / width, PANEL_PX / height)
        )
        axis.set_axis_off()
        axes.append(axis)
    return figure, axes


def _bar(figure: Figure, beside: Axes, shown: Any) -> None:
    """A colour bar in the gap beside a panel, which keeps its size."""
    box = beside.get_position()
    axis = figure.add_axes((box.x1 + 0.006, box.y0 + 0.1 * box.height, 0.009, 0.8 * box.height))
    figure.colorbar(shown, cax=axis).ax.tick_params(labelsize=8, colors=INK, length=2)


def _title(axis: Axes, text: str) -> None:
    axis.set_title(text, fontsize=11, color=FAINT, loc="left", pad=5)


def _near(depth_m: np.ndarray) -> np.ndarray:
    """Depth as colour: near red, far blue, no reading grey."""
    known = np.isfinite(depth_m)
    low, high = np.percentile(depth_m[known], [1, 95])
    near = np.clip((high - np.where(known, depth_m, high)) / (high - low), 0, 1)
    colour = cv2.applyColorMap(np.round(15 + 225 * near).astype(np.uint8), cv2.COLORMAP_TURBO)[..., ::-1] / 255.0
    return np.where(known[..., None], colour, 0.85)


def _around(pixels: np.ndarray, *axes: Axes) -> None:
    """Show a square about the object, twice as wide."""
    rows, columns = np.nonzero(pixels)
    half = max(np.ptp(rows), np.ptp(columns))
    u, v = (columns.min() + columns.max()) / 2, (rows.min() + rows.max()) / 2
    for axis in axes:
        axis.set_xlim(u - half, u + half)
        axis.set_ylim(v + half, v - half)


def _decode(image: EncodedImage, depth_m: np.ndarray, pixels: np.ndarray) -> Figure:
    counts = cv2.imdecode(np.frombuffer(image.data, np.uint8), cv2.IMREAD_UNCHANGED)
    figure, (left, right) = _figure(2)
    left.imshow(np.clip(counts / 2000.0, 0, 1), cmap="gray", aspect="equal")
    _title(left, f"the bytes: 16-bit counts, {len(image.data) // 1024} KiB of PNG")
    right.imshow(_near(depth_m), aspect="equal")
    missing = 100 * float(np.isnan(depth_m).mean())
    _title(right, f"metres: near red, far blue; no reading grey ({missing:.0f} %)")
    _around(pixels, left, right)
    return figure


def _segment(depth_m: np.ndarray, found: Any, camera: Any) -> Figure:
    rows, columns = np.indices(depth_m.shape)
    points = np.stack([(columns - camera.cx) / camera.fx, (rows - camera.cy) / camera.fy, np.ones_like(depth_m)], -1)
    height_m = (points * depth_m[..., None]) @ found.support.normal + found.support.offset_m
    table = np.abs(height_m) < np.maximum(0.003, 0.006 * depth_m)
    base = _near(depth_m).mean(axis=2, keepdims=True).repeat(3, axis=2) * 0.6 + 0.35
    base[table] = base[table] * 0.45 + np.array([0.36, 0.62, 0.85]) * 0.55
    base[found.pixels] = base[found.pixels] * 0.25 + OBSERVED * 0.75
    figure, (left, right) = _figure(2)
    left.imshow(np.clip(base, 0, 1), aspect="equal")
    left.plot(*PRESS_PX, marker="+", color=FORCE, markersize=14, markeredgewidth=2.5)
    _title(left, "object orange, support plane blue, contact +")
    height_mm = np.where(np.isfinite(height_m), 1e3 * height_m, np.nan)
    highest = 1.1 * np.nanpercentile(height_mm[found.pixels], 99)
    shown = right.imshow(height_mm, cmap="viridis", vmin=-5, vmax=highest, aspect="equal")
    _bar(figure, right, shown)
    _title(right, "height above the support plane, mm")
    _around(found.pixels, left, right)
    return figure


def _slice(axis: Axes, kinds: np.ndarray, colours: list[Any], title: str) -> None:
    """A vertical slice, z up, the camera to the left."""
    axis.imshow(kinds.T, origin="lower", cmap=ListedColormap(colours), vmin=0, vmax=len(colours) - 1, aspect="equal")
    _title(axis, title)


def _voxelize(view: Any) -> Figure:
    figure, (left, right) = _figure(2)
    camera = view_from_camera(view.grid.camera_from_grid, view.observed, PANEL_PX, PANEL_PX)
    left.imshow(np.clip(voxels(view.observed, OBSERVED, camera, 8.0), 0, 1), aspect="equal")
    _title(left, f"observed: {int(view.observed.sum())} of 64³ voxels, {1e3 * view.grid.pitch_m:.1f} mm each")
    middle = int(np.argmax(view.observed.sum(axis=(0, 2))))
    kinds = np.where(view.observed, 2, np.where(view.free, 0, 1))[:, middle]
    _slice(right, kinds, [FREE, UNKNOWN, OBSERVED], "slice, camera left: observed, free (green), unknown (grey)")
    return figure


def _reconstruct(view: Any, seen: np.ndarray, rough: np.ndarray, cut: float) -> Figure:
    figure, (left, right) = _figure(2)
    middle = int(np.argmax(view.observed.sum(axis=(0, 2))))
    shown = left.imshow(seen[:, middle].T, origin="lower", cmap="magma_r", vmin=0, vmax=1, aspect="equal")
    left.contour(seen[:, middle].T, levels=[cut], colors=INK, linewidths=1.2)
    _bar(figure, left, shown)
    _title(left, f"probability, same slice; line: threshold {cut:.2f}")
    camera = view_from_camera(view.grid.camera_from_grid, rough, PANEL_PX, PANEL_PX)
    right.imshow(np.clip(solid(rough, BODY, camera, None, 8.0)[0], 0, 1), aspect="equal")
    _title(right, "the full body, seen and unseen side")
    return figure


def _align(view: Any, rough: np.ndarray, grid: Any, occupancy: np.ndarray) -> Figure:
    figure, (left, right) = _figure(2)
    for axis, body, title in (
        (left, rough, "from above, in the view grid; red: the body grid"),
        (right, occupancy, "from above, in the body grid: x along the longest axis"),
    ):
        axis.imshow(body.any(axis=2).T, origin="lower", cmap=ListedColormap(["#f4f5f6", BODY.tolist()]), aspect="equal")
        _title(axis, title)
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]]) * grid.edge_m
    in_view = np.linalg.inv(view.grid.camera_from_grid) @ grid.camera_from_grid
    outline = (corners @ in_view[:2, :2].T + in_view[:2, 3]) / view.grid.pitch_m - 0.5
    left.plot(*outline.T, color=FORCE, linewidth=1.5)
    low, high = min(outline.min(), 0) - 1, max(outline.max(), 63) + 1
    left.set_xlim(low, high)
    left.set_ylim(low, high)
    low, high = 31.5 - 32 * HORIZONTAL_FILL, 31.5 + 32 * HORIZONTAL_FILL
    right.plot([low, high, high, low, low], [low, low, high, high, low], color=FAINT, linewidth=1, linestyle="--")
    dashed = f"dashed: {HORIZONTAL_FILL:.0%} of the edge; of the height at most {VERTICAL_FILL:.0%}"
    right.text(1, 1, dashed, color=FAINT, fontsize=9)
    return figure


def _deform(models: Models, camera: Any, image: EncodedImage) -> bytes:
    from service.picture import deformation_picture

    force_n = np.array(FORCE_N)
    request = DeformRequest(
        Observation(camera, image), material_named(MATERIAL), (Load(force_n, contact_px=PRESS_PX),),
    )  # fmt: skip
    result = Pipeline(models.reconstruction, models.deformation).predict(request)
    answer = result.loads[0]
    depth_m = decode_depth(image.encoding, image.data, image.unit_m, camera.width, camera.height)
    moved_mm = 1e3 * answer.max_displacement_m
    return deformation_picture(
        depth_m=None, observed=None, reconstruction=result.reconstruction, deformed=answer.deformed,
        displacement_m=answer.displacement_m, grid=result.grid, intrinsics=None,
        contact_m=pixel_to_point(*PRESS_PX, depth_m, camera), force_n=force_n,
        caption=f"{np.linalg.norm(force_n):.3g} N on {MATERIAL}: moves {moved_mm:.1f} mm at most", panel_px=PANEL_PX,
    )  # fmt: skip


if __name__ == "__main__":
    sys.exit(main())
