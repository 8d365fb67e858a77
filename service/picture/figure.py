"""One PNG a person can judge an answer by: what the camera saw, what was reconstructed, and how it deforms."""

from __future__ import annotations

import io

import cv2
import numpy as np
from jaxtyping import Float32

from service.core.arrays import GRID_SIZE, DepthImage, Occupancy, Vector3
from service.core.grids import Grid, invert_rigid
from service.picture.raycast import Field, Rgb, View, blur, view_from_camera
from service.picture.shading import solid, voxels

try:
    from matplotlib.axes import Axes
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LinearSegmentedColormap, Normalize
    from matplotlib.figure import Figure
    from matplotlib.patches import FancyArrowPatch
    from matplotlib.patheffects import Normal, withStroke
except ModuleNotFoundError as missing:
    raise ModuleNotFoundError("Pictures need matplotlib: pip install 'physnet[pictures]'") from missing

Displacement = Float32[np.ndarray, "axis=3 x=64 y=64 z=64"]

_DPI = 100
_SMALL = 12.5
"""Points: a page shows the picture at a third of its width, and words should still be read."""
_INK = "#22262b"
_FAINT = "#7a828c"
_FORCE = "#d3122f"
_OBSERVED = np.array([0.96, 0.68, 0.30], np.float32)
_REST = np.array([0.66, 0.75, 0.86], np.float32)
# From the body's own colour at rest to a signal colour: lightness falls all the way, so it also reads in grey.
_DISPLACEMENT = LinearSegmentedColormap.from_list(
    "displacement", [(0.66, 0.75, 0.86), (0.98, 0.88, 0.50), (0.97, 0.58, 0.20), (0.84, 0.18, 0.25), (0.45, 0.05, 0.35)]
)


def deformation_picture(
    *,
    depth_m: DepthImage | None,
    observed: Occupancy | None,
    reconstruction: Occupancy,
    deformed: Occupancy,
    displacement_m: Displacement | None,
    grid: Grid,
    intrinsics: tuple[float, float, float, float] | None,
    contact_m: Vector3,
    force_n: Vector3,
    caption: str,
    panel_px: int = 440,
) -> bytes:
    """Draw the panels side by side, all bodies from one viewpoint at one scale.

    Args:
        depth_m: The depth frame, or None where the shape was known (then neither it nor `observed` is drawn).
        observed: Voxels the camera saw, or None.
        reconstruction: The body at rest.
        deformed: The body under the load.
        displacement_m: At each voxel of the deformed body, the displacement of the material now there; None draws
            the deformed body in one colour.
        grid: Where all grids stand.
        intrinsics: fx, fy, cx, cy in pixels; needed with `depth_m`.
        contact_m: Contact in the camera frame.
        force_n: Force in the camera frame, newtons; a zero force draws no arrow.
        caption: Title line.
        panel_px: Edge of each square panel; the whole picture is about 4.4 times as wide.

    Returns:
        A PNG.
    """
    view = view_from_camera(grid.camera_from_grid, reconstruction | deformed, panel_px, panel_px)
    line_pitch_m = _nice_length(1.6 * view.half_width * grid.pitch_m / 5)
    line_pitch = line_pitch_m / grid.pitch_m
    force = float(np.linalg.norm(force_n))

    rest_image, rest_cover = solid(reconstruction, _REST, view, None, line_pitch)
    if displacement_m is None:
        peak_m = 0.0
        deformed_image, _ = solid(deformed, _REST, view, None, line_pitch)
    else:
        magnitude_m = np.linalg.norm(displacement_m, axis=0).astype(np.float32)
        peak_m = float(magnitude_m[deformed].max(initial=0.0))
        level = _beyond_surface(magnitude_m, deformed) / max(peak_m, 1e-9)
        colours = np.asarray(_DISPLACEMENT(np.linspace(0, 1, 256))[:, :3], np.float32)
        deformed_image, _ = solid(deformed, level.astype(np.float32), view, colours, line_pitch)

    panels: list[tuple[str, Rgb]] = []
    if observed is not None:
        panels.append(("observed", voxels(observed, _OBSERVED, view, line_pitch)))
    panels += [("reconstruction", rest_image), ("deformed", deformed_image)]

    figure, axes = _layout(len(panels) + (depth_m is not None), panel_px, caption)
    if depth_m is not None:
        assert intrinsics is not None, "a depth frame is drawn with its intrinsics"
        _draw_frame(axes[0], depth_m, intrinsics, contact_m, force_n, grid)
    for axis, (title, image) in zip(axes[-len(panels) :], panels, strict=True):
        _title(axis, title)
        axis.imshow(np.clip(image, 0, 1), interpolation="none", aspect="equal")
        axis.set_autoscale_on(False)
    _draw_arrow(axes[-2], *_arrow_in_view(grid, view, contact_m, force_n, deformed, None), f"{force:.3g} N")
    _draw_arrow(axes[-1], *_arrow_in_view(grid, view, contact_m, force_n, deformed, displacement_m), None)
    for halo, width, style in (("white", 2.6, "-"), (_INK, 1.1, "--")):
        axes[-1].contour(rest_cover, levels=[0.5], colors=halo, linewidths=width, linestyles=style, alpha=0.85)
    for axis, note in ((axes[-1], "dashed: at rest"), (axes[-2], f"lines every {line_pitch_m * 1e3:.3g} mm")):
        axis.text(0.5, 0.02, note, transform=axis.transAxes, ha="center", color=_FAINT, fontsize=_SMALL)
    if peak_m > 0:
        _colour_bar(figure, axes[-1], peak_m * 1e3)
    out = io.BytesIO()
    figure.savefig(out, format="png")
    return out.getvalue()


def _layout(panels: int, panel_px: int, caption: str) -> tuple[Figure, list[Axes]]:
    """Square axes in one row, one image pixel a figure pixel; room for the title above and the colour bar beside."""
    gap, top, bottom, left, right = 14, 84, 10, 14, 110
    width = left + right + panels * panel_px + (panels - 1) * gap
    height = top + bottom + panel_px
    figure = Figure(figsize=(width / _DPI, height / _DPI), dpi=_DPI, facecolor="white")
    figure.text(left / width, 1 - 16 / height, caption, ha="left", va="top", fontsize=19, color=_INK, weight="bold")
    axes = []
    for panel in range(panels):
        x = left + panel * (panel_px + gap)
        axis = figure.add_axes((x / width, bottom / height, panel_px / width, panel_px / height))
        axis.set_axis_off()
        axes.append(axis)
    return figure, axes


def _title(axis: Axes, title: str) -> None:
    axis.set_title(title, fontsize=15, color=_FAINT, loc="left", pad=5)


def _draw_frame(
    axis: Axes,
    depth_m: DepthImage,
    intrinsics: tuple[float, float, float, float],
    contact_m: Vector3,
    force_n: Vector3,
    grid: Grid,
) -> None:
    """The depth image around the body, near red and far blue, with relief from its slope; no reading is grey."""
    seen = np.isfinite(depth_m) & (depth_m > 0)
    fx, fy, cx, cy = intrinsics
    middle_m = grid.camera_from_grid[:3, :3] @ np.array([0.5, 0.5, 0.35]) * grid.edge_m + grid.camera_from_grid[:3, 3]
    rows, cols = depth_m.shape
    side = float(np.clip(2.0 * grid.edge_m * fx / max(middle_m[2], 0.05), 32, min(rows, cols)))
    corner_u = float(np.clip(fx * middle_m[0] / middle_m[2] + cx - side / 2, 0, cols - side))
    corner_v = float(np.clip(fy * middle_m[1] / middle_m[2] + cy - side / 2, 0, rows - side))
    shown = seen & (np.abs(np.arange(cols) - corner_u - side / 2) <= side / 2)
    shown &= (np.abs(np.arange(rows) - corner_v - side / 2) <= side / 2)[:, None]
    low, high = np.percentile(depth_m[shown], [1, 99]) if shown.any() else (0.0, 1.0)
    # A far background must not eat the colours of the body.
    high = min(high, middle_m[2] + 1.5 * grid.edge_m)
    near = np.clip((high - np.where(seen, depth_m, high)) / max(high - low, 1e-6), 0, 1)
    colour = cv2.applyColorMap(np.round(15 + 225 * near).astype(np.uint8), cv2.COLORMAP_TURBO)[..., ::-1] / 255.0
    filled = cv2.GaussianBlur(np.where(seen, depth_m, high).astype(np.float32), (0, 0), 1.2)
    slope = cv2.Sobel(filled, cv2.CV_32F, 1, 0, scale=1 / 8) * fx / np.maximum(filled, 1e-3)
    relief = np.clip(1.0 - 0.16 * np.clip(slope, -2, 2), 0.6, 1.3)[..., None]
    image = np.where(seen[..., None], np.clip(colour * relief, 0, 1), 0.90)
    axis.imshow(image, interpolation="antialiased", aspect="equal")
    axis.set_autoscale_on(False)
    axis.set_xlim(corner_u - 0.5, corner_u + side - 0.5)
    axis.set_ylim(corner_v + side - 0.5, corner_v - 0.5)
    _title(axis, f"depth: red {low:.2f} m, blue {high:.2f} m")

    def pixel(place_m: Vector3) -> tuple[float, float]:
        return float(fx * place_m[0] / place_m[2] + cx), float(fy * place_m[1] / place_m[2] + cy)

    force = float(np.linalg.norm(force_n))
    tail = contact_m - 0.3 * grid.edge_m * force_n / force if force > 0 else contact_m
    # A tail behind the camera has no pixel.
    tail = tail if tail[2] > 0.05 else contact_m
    _draw_arrow(axis, pixel(tail), pixel(contact_m), f"{force:.3g} N")


def _arrow_in_view(
    grid: Grid,
    view: View,
    contact_m: Vector3,
    force_n: Vector3,
    deformed: Occupancy,
    displacement_m: Displacement | None,
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Tail and tip in pixels of a 3D panel; the arrow ends at the contact, as a finger that pushes does.

    With a displacement the contact has gone along with the body.
    """
    grid_from_camera = invert_rigid(grid.camera_from_grid)
    contact = (grid_from_camera[:3, :3] @ contact_m + grid_from_camera[:3, 3]) / grid.pitch_m
    if displacement_m is not None and deformed.any():
        # The field is known where the material has come to rest, so the contact is the voxel that came from there.
        now = np.argwhere(deformed)
        moved = displacement_m[:, *now.T].T / grid.pitch_m
        contact = contact + moved[np.argmin(np.linalg.norm(now + 0.5 - moved - contact, axis=1))]
    force = float(np.linalg.norm(force_n))
    direction = grid_from_camera[:3, :3] @ force_n / force if force > 0 else np.zeros(3)
    tail, tip = view.project(np.stack([contact - 0.3 * GRID_SIZE * direction, contact]))
    return (float(tail[0]), float(tail[1])), (float(tip[0]), float(tip[1]))


def _draw_arrow(axis: Axes, tail: tuple[float, float], tip: tuple[float, float], label: str | None) -> None:
    tail = _within(axis, tail, tip)
    halo = [withStroke(linewidth=4.5, foreground="white"), Normal()]
    if np.hypot(tip[0] - tail[0], tip[1] - tail[1]) > 4:
        axis.add_patch(
            FancyArrowPatch(
                tail, tip, arrowstyle="-|>,head_length=7,head_width=4", linewidth=2.4, color=_FORCE, shrinkA=0,
                shrinkB=0, joinstyle="miter", capstyle="butt", path_effects=halo, zorder=5,
            )
        )  # fmt: skip
    axis.plot(*tip, marker="o", markersize=4.5, color=_FORCE, markeredgecolor="white", markeredgewidth=0.9, zorder=6)
    if label:
        # Beyond the tail, away from the body; above the contact where the arrow points into the picture.
        away = np.array([tail[0] - tip[0], tip[1] - tail[1]])
        away = away / np.hypot(*away) if np.hypot(*away) > 12 else np.array([0.0, 1.0])
        axis.annotate(
            label, tail, xytext=tuple(away * (32, 15)), textcoords="offset points", ha="center", va="center",
            color=_FORCE, fontsize=15, weight="bold", path_effects=[withStroke(linewidth=3, foreground="white")],
            zorder=7,
        )  # fmt: skip


def _within(axis: Axes, tail: tuple[float, float], tip: tuple[float, float]) -> tuple[float, float]:
    """Shorten an arrow so that its tail, and a label there, stay in the panel."""
    share = 1.0
    for limits, start, end in zip((axis.get_xlim(), axis.get_ylim()), tail, tip, strict=True):
        margin = 0.14 * abs(limits[1] - limits[0])
        low, high = min(limits) + margin, max(limits) - margin
        if start < low or start > high:
            share = min(share, max((min(max(start, low), high) - end) / (start - end), 0.0))
    return tip[0] + share * (tail[0] - tip[0]), tip[1] + share * (tail[1] - tip[1])


def _colour_bar(figure: Figure, beside: Axes, peak_mm: float) -> None:
    box = beside.get_position()
    axis = figure.add_axes((box.x1 + 0.006, box.y0 + 0.12 * box.height, 0.007, 0.7 * box.height))
    bar = figure.colorbar(ScalarMappable(Normalize(0, peak_mm), _DISPLACEMENT), cax=axis)
    bar.outline.set_visible(False)
    axis.tick_params(labelsize=_SMALL, colors=_INK, length=2)
    axis.set_title("mm", fontsize=_SMALL, color=_INK, loc="left", pad=6)


def _beyond_surface(values: Field, inside: Occupancy) -> Field:
    """Carry a field that is known inside a body a little way out, so that it can be sampled on the surface."""
    weight = blur(inside.astype(np.float32), 1.0)
    mean = blur(np.where(inside, values, 0).astype(np.float32), 1.0) / np.maximum(weight, 1e-6)
    return np.where(inside, values, np.where(weight > 1e-3, mean, 0)).astype(np.float32)


def _nice_length(length_m: float) -> float:
    """The nearest of 1, 2, 5, 10, 20, … (in any decade) below."""
    decade = 10.0 ** np.floor(np.log10(length_m))
    return float(max(step * decade for step in (1, 2, 5) if step * decade <= length_m * (1 + 1e-9)))
