"""Pictures of random samples of a data set, and its histogram of overlaps, on one sheet."""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from service.core.arrays import GRID_SIZE, Occupancy
from service.core.grids import unpack_bits
from training.data.store import Store, StoreError
from training.simulation.camera import direction

TILE = 200
"""Edge of a picture in pixels."""
ZOOM = 0.66
"""Edge of the body's cube, as a share of a picture's: a body that fills the cube fits, but for its nearest corner."""
COLUMNS = 8
PAPER = np.array([255, 255, 255], np.uint8)
REST, DEFORMED, SEEN = (205, 200, 195), (90, 140, 235), (60, 120, 210)
"""Colours as OpenCV orders them: blue, green, red."""
LIGHT = np.array([-0.5, -0.35, 0.8]) / np.linalg.norm([-0.5, -0.35, 0.8])
AZIMUTH_RAD, ELEVATION_RAD = np.radians(-125.0), np.radians(28.0)

Picture = UInt8[np.ndarray, "_ _ 3"]


def contact_sheet(store: Store, samples: int = 24, seed: int = 0) -> bytes:
    """Random samples as a PNG: the body at rest in grey behind the deformed one, or what is seen on the truth.

    Raises:
        StoreError: There is no group.
    """
    rng = np.random.default_rng(seed)
    paths = sorted((store.root / "groups").glob("*.npz"))
    if not paths:
        raise StoreError(f"{store.root} holds no group")
    tiles = []
    for _ in range(samples):
        index = int(paths[rng.integers(len(paths))].stem)
        group = store.group(index)
        row = int(rng.integers(len(group["sample"])))
        tiles.append(_tile(group, row, f"{index}.{row} {group['family']}"))
    overlaps = [group["identity_iou"] for _, group in store.groups() if "identity_iou" in group]
    sheet = arranged(tiles)
    if overlaps:
        sheet = np.concatenate([sheet, _histogram(np.concatenate(overlaps), sheet.shape[1])])
    return cv2.imencode(".png", sheet)[1].tobytes()


def _tile(group: dict[str, np.ndarray], row: int, title: str) -> Picture:
    if "truth" in group:
        picture = draw([(unpack_bits(group["truth"][row]), REST), (unpack_bits(group["observed"][row]), SEEN)])
        note = "seen on the truth"
    else:
        picture = draw([(unpack_bits(group["rest"]), REST), (unpack_bits(group["deformed"][row]), DEFORMED)])
        note = f"IoU {group['identity_iou'][row]:.2f} {group['law'][row]}"
    return captioned(picture, title, note)


def captioned(picture: Picture, *lines: str) -> Picture:
    """The picture with these lines written at its top."""
    for line, text in enumerate(lines):
        cv2.putText(picture, text, (4, 12 + 13 * line), cv2.FONT_HERSHEY_SIMPLEX, 0.36, (70, 70, 70), 1, cv2.LINE_AA)
    return picture


def draw(bodies: list[tuple[Occupancy, tuple[int, int, int]]]) -> Picture:
    """Voxels seen from above one corner, parallel projection; of two bodies the nearer surface shows."""
    picture = np.tile(PAPER, (TILE, TILE, 1))
    nearest = np.full((TILE, TILE), -np.inf)
    for occupancy, colour in bodies:
        depth, shade = _surface(occupancy)
        # what two bodies share is shown as the last one
        shown = depth >= nearest - 1e-3
        shown &= np.isfinite(depth)
        picture[shown] = np.clip(shade[shown, None] * np.array(colour, np.float64), 0, 255).astype(np.uint8)
        nearest = np.where(shown, depth, nearest)
    return picture


def _surface(occupancy: Occupancy) -> tuple[Float[np.ndarray, "h w"], Float[np.ndarray, "h w"]]:
    """Height above the picture's plane (−∞ where there is nothing) and brightness of each pixel."""
    right = np.array([-np.sin(AZIMUTH_RAD), np.cos(AZIMUTH_RAD), 0.0])
    toward = direction(ELEVATION_RAD, AZIMUTH_RAD)
    up = np.cross(toward, right)
    if up[2] < 0:
        up, right = -up, -right
    points, normals = _faces(occupancy, toward)
    depth, shade = np.full((TILE, TILE), -np.inf), np.zeros((TILE, TILE))
    if not len(points):
        return depth, shade
    centred = points - np.array([0.5, 0.5, 0.42])
    column = np.round(TILE * (0.5 + ZOOM * centred @ right)).astype(int)
    row = np.round(TILE * (0.56 - ZOOM * centred @ up)).astype(int)
    height = centred @ toward
    bright = 0.45 + 0.55 * np.clip(normals @ LIGHT, 0.0, 1.0)
    order = np.argsort(height)
    for shift in np.ndindex(3, 3):
        y, x = np.clip(row + shift[0] - 1, 0, TILE - 1), np.clip(column + shift[1] - 1, 0, TILE - 1)
        before = depth[y, x]
        better = order[height[order] > before[order]]
        depth[y[better], x[better]] = height[better]
        shade[y[better], x[better]] = bright[better]
    return depth, shade


def _faces(occupancy: Occupancy, toward: np.ndarray) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """Centres of the surface voxels, and normals from the slope of the blurred body."""
    blurred = cv2.blur(occupancy.astype(np.float32).reshape(GRID_SIZE, -1), (1, 3)).reshape(occupancy.shape)
    for _ in range(2):
        for axis in range(3):
            blurred = (np.roll(blurred, 1, axis) + blurred + np.roll(blurred, -1, axis)) / 3
    inner = occupancy.copy()
    for axis in range(3):
        inner &= _shifted(occupancy, axis, 1) & _shifted(occupancy, axis, -1)
    index = np.argwhere(occupancy & ~inner)
    slope = np.stack([np.gradient(blurred, axis=axis)[tuple(index.T)] for axis in range(3)], axis=1)
    normal = -slope / np.maximum(np.linalg.norm(slope, axis=1, keepdims=True), 1e-6)
    facing = normal @ toward > -0.2
    return (index[facing] + 0.5) / GRID_SIZE, normal[facing]


def _shifted(occupancy: Occupancy, axis: int, step: int) -> Bool[np.ndarray, "x y z"]:
    shifted = np.roll(occupancy, step, axis)
    edge: list[slice | int] = [slice(None)] * 3
    edge[axis] = 0 if step == 1 else -1
    shifted[tuple(edge)] = False
    return shifted


def arranged(tiles: list[Picture], columns: int = COLUMNS) -> Picture:
    """Tiles side by side, row by row."""
    rows = -(-len(tiles) // columns)
    sheet = np.tile(PAPER, (rows * TILE, min(columns, len(tiles)) * TILE, 1))
    for number, tile in enumerate(tiles):
        row, column = divmod(number, columns)
        sheet[row * TILE : (row + 1) * TILE, column * TILE : (column + 1) * TILE] = tile
    return sheet


def _histogram(overlaps: np.ndarray, width: int) -> Picture:
    """How much of each body stays where it was: bars over twentieths of [0, 1], with the median."""
    height, base = 150, 120
    picture = np.tile(PAPER, (height, width, 1))
    counts, _ = np.histogram(overlaps, 20, (0.0, 1.0))
    step = width / 20
    for i, count in enumerate(counts):
        top = base - round(90 * count / max(int(counts.max()), 1))
        cv2.rectangle(picture, (round(i * step) + 2, top), (round((i + 1) * step) - 2, base), DEFORMED, -1)
        cv2.putText(picture, f"{i / 20:.2f}", (round(i * step), base + 14), 0, 0.33, (70, 70, 70), 1, cv2.LINE_AA)
    median = float(np.median(overlaps))
    cv2.line(picture, (round(median * width), 20), (round(median * width), base), (60, 60, 60), 1)
    text = f"IoU with the body at rest: {len(overlaps)} samples, median {median:.3f}"
    cv2.putText(picture, text, (6, 14), 0, 0.42, (70, 70, 70), 1, cv2.LINE_AA)
    return picture
