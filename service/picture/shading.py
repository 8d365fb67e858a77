"""Light, shadow and ground for what `service.picture.raycast` finds: one picture of a solid or of bare voxels.

Lengths are voxels, colours RGB in 0..1, as in `service.picture.raycast`.
"""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Bool, Float32

from service.core.arrays import GRID_SIZE, Occupancy
from service.picture.raycast import SUPERSAMPLING, Field, Places, Rgb, View, blur, cast, normals, sample, smooth_field

Colours = Float32[np.ndarray, "n 3"]
Light = Float32[np.ndarray, "3"]

_GROUND = np.array([0.955, 0.955, 0.95], np.float32)
_GROUND_LINE = np.array([0.84, 0.845, 0.85], np.float32)
_CUBE_FACES = tuple((axis, side) for axis in range(3) for side in (0, 1))


def solid(
    occupancy: Occupancy, colours: Field | Light, view: View, colour_map: Colours | None, line_pitch: float
) -> tuple[Rgb, Bool[np.ndarray, "rows cols"]]:
    """Draw the smooth surface of a body on its support plane.

    Args:
        occupancy: The body.
        colours: One RGB colour, or a scalar field in 0..1 that `colour_map` turns into colours.
        view: The camera.
        colour_map: Colours of 0..1 at even steps; unused for a single colour.
        line_pitch: Distance of the lines on the ground, voxels.

    Returns:
        The picture, and which of its pixels the body covers.
    """
    field = smooth_field(occupancy)
    light = _light(view)
    image = _ground(occupancy, view, light, line_pitch)
    hit, places = cast(field, view)
    if len(places):
        if colours.ndim == 1:
            paint: Colours = np.broadcast_to(colours, (len(places), 3)).astype(np.float32)
        else:
            assert colour_map is not None
            level = np.clip(sample(colours, places), 0, 1) * (len(colour_map) - 1)
            paint = colour_map[np.round(level).astype(int)]
        image[hit] = _shade(paint, places, normals(field, places), field, light, view)
    return _finish(image, view), _coverage(hit, view) > 0.5


def voxels(occupancy: Occupancy, colour: Light, view: View, line_pitch: float) -> Rgb:
    """Draw every filled voxel as a cube, back to front, which is exact for cubes of one lattice seen in parallel."""
    light = _light(view)
    rows, cols = view.rows * SUPERSAMPLING, view.cols * SUPERSAMPLING
    image = np.ascontiguousarray(_ground(occupancy, view, light, line_pitch).reshape(rows, cols, 3))
    cells = np.argwhere(occupancy)
    cells = cells[np.argsort(cells @ view.toward)]
    padded = np.pad(occupancy, 1)
    before_cell = (cells + 0.5 + 2.0 * view.toward).astype(np.float32)
    shade_of_cell = _ambient(blur(occupancy.astype(np.float32), 2.5), before_cell)
    faces = []
    for axis, side in _CUBE_FACES:
        normal = np.zeros(3)
        normal[axis] = 2 * side - 1
        if normal @ view.toward <= 0:
            continue
        corners = np.zeros((4, 3))
        corners[:, axis] = side
        corners[:, (axis + 1) % 3] = (0, 1, 1, 0)
        corners[:, (axis + 2) % 3] = (0, 0, 1, 1)
        brightness = 0.70 + 0.32 * max(float(normal @ light), 0.0) + 0.1 * max(normal[2], 0)
        neighbour = padded[tuple((cells + 1 + normal.astype(int)).T)]
        faces.append((corners, brightness, neighbour))
    for index, cell in enumerate(cells):
        for corners, brightness, neighbour in faces:
            if neighbour[index]:
                continue
            outline = np.round(view.project(cell + corners) * SUPERSAMPLING * 16).astype(np.int32)
            tone = colour * brightness * shade_of_cell[index]
            cv2.fillConvexPoly(image, outline, tone.tolist(), cv2.LINE_8, shift=4)
            cv2.polylines(image, [outline], True, (0.8 * tone).tolist(), 1, cv2.LINE_8, shift=4)
    return _finish(image.reshape(-1, 3), view)


def _light(view: View) -> Light:
    """Direction towards the key light: over the viewer's left shoulder."""
    direction = 0.55 * view.toward - 0.65 * view.right + 0.9 * np.array([0.0, 0.0, 1.0])
    return np.asarray(direction / np.linalg.norm(direction), np.float32)


def _shade(paint: Colours, places: Places, outward: Places, field: Field, light: Light, view: View) -> Colours:
    """Key light with shadow, light from the sky and from the viewer, dimmed in corners; a soft highlight."""
    lit = np.maximum(outward @ light, 0)
    faces_light = lit > 0
    lit[faces_light] *= 1 - _occluded(field, places[faces_light] + 2.0 * outward[faces_light], light)
    sky = 0.5 + 0.5 * outward[:, 2]
    facing = np.maximum(outward @ view.toward.astype(np.float32), 0)
    ambient = _ambient(blur(field, 3.0), places + 3.0 * outward)
    diffuse = 0.42 * lit + ambient * (0.34 * sky + 0.36 * facing + 0.16)
    halfway = light + view.toward.astype(np.float32)
    halfway /= np.linalg.norm(halfway)
    highlight = 0.10 * np.maximum(outward @ halfway, 0) ** 30 * (lit > 0)
    return np.asarray(np.clip(paint * diffuse[:, None] + highlight[:, None], 0, 1), np.float32)


def _ambient(density: Field, places: Places) -> Float32[np.ndarray, " n"]:
    """How open the surroundings are, 0..1, by a blurred density a little above the surface; the ground counts too."""
    around = sample(density, places)
    ground = 0.5 * np.exp(-np.maximum(places[:, 2], 0) / 4.0)
    around = around + (1 - around) * ground
    return np.asarray(np.clip(1.1 - 1.1 * around, 0.25, 1), np.float32)


def _occluded(field: Field, places: Places, light: Light) -> Float32[np.ndarray, " n"]:
    """Share of the light that the body keeps from a place: 0 in the open, 1 in full shadow."""
    blocked = np.zeros(len(places), np.float32)
    active = np.arange(len(places))
    filled = np.argwhere(field > 0.25)
    low, high = (filled.min(0), filled.max(0) + 1) if len(filled) else (np.zeros(3), np.zeros(3))
    for distance in np.arange(0.5, 1.8 * GRID_SIZE, 1.5, dtype=np.float32):
        at = places[active] + distance * light
        inside = ((at > low) & (at < high)).all(1)
        # A soft edge: what is just outside the surface already takes some of the light.
        veil = np.clip((sample(field, at[inside]) - 0.25) * 2.5, 0, 1)
        blocked[active[inside]] = np.maximum(blocked[active[inside]], veil)
        # What has passed the body or is already dark stays as it is; what has yet to reach it goes on.
        gone = ((at < low) & (light < 0)).any(1) | ((at > high) & (light > 0)).any(1)
        active = active[~gone & (blocked[active] < 1)]
        if not len(active):
            break
    return blocked


def _ground(occupancy: Occupancy, view: View, light: Light, line_pitch: float) -> Colours:
    """The support plane z = 0 under every supersampled pixel: lines, the body's soft shadow, fading to white."""
    origins = view.origins()
    toward = view.toward.astype(np.float32)
    places = origins - (origins[:, 2] / toward[2])[:, None] * toward
    # The shadow is soft, so a coarse map of it is enough: one cell a voxel, over twice the grid's width.
    cells = 2 * GRID_SIZE
    x, y = np.meshgrid(np.arange(cells) + 0.5 - GRID_SIZE / 2, np.arange(cells) + 0.5 - GRID_SIZE / 2, indexing="ij")
    floor = np.stack([x, y, np.full_like(x, 0.5)], -1).reshape(-1, 3).astype(np.float32)
    soft = blur(np.pad(occupancy, 3).astype(np.float32), 1.2)[3:-3, 3:-3, 3:-3]
    shadow = cv2.GaussianBlur(_occluded(soft, floor, light).reshape(cells, cells), (0, 0), 2.0)
    wide = blur(np.pad(occupancy, 8).astype(np.float32), 4.0)[8:-8, 8:-8, 8:-8]
    inside = ((floor[:, :2] > 0) & (floor[:, :2] < GRID_SIZE)).all(1)
    contact = np.where(inside, sample(wide, floor + np.array([0, 0, 2], np.float32)), 0).reshape(cells, cells)
    dark = np.clip(0.30 * shadow + 0.55 * contact.astype(np.float32), 0, 0.7)
    at = (places[:, :2] + GRID_SIZE / 2 - 0.5).reshape(view.rows * SUPERSAMPLING, -1, 2)
    dark = cv2.remap(dark, at[..., 1], at[..., 0], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
    along = (places[:, :2] - GRID_SIZE / 2) / line_pitch
    phase = np.abs(along - np.round(along))
    thickness = 1.2 * view.half_width / view.cols / line_pitch
    line = (phase < thickness).any(1, keepdims=True)
    colour = np.where(line, _GROUND_LINE, _GROUND) * (1 - dark.reshape(-1, 1))
    radius = np.linalg.norm(places[:, :2] - view.centre[:2].astype(np.float32), axis=1)
    edge = 1.05 * max(view.half_width, view.half_height)
    fade = np.clip((radius / edge - 0.55) / 0.45, 0, 1)[:, None]
    fade = fade * fade * (3 - 2 * fade)
    return np.asarray(colour * (1 - fade) + fade, np.float32)


def _finish(image: Colours, view: View) -> Rgb:
    """Average the supersamples into pixels."""
    tall = image.reshape(view.rows * SUPERSAMPLING, view.cols * SUPERSAMPLING, 3)
    return np.asarray(cv2.resize(tall, (view.cols, view.rows), interpolation=cv2.INTER_AREA), np.float32)


def _coverage(hit: Bool[np.ndarray, " rays"], view: View) -> Float32[np.ndarray, "rows cols"]:
    tall = hit.reshape(view.rows * SUPERSAMPLING, view.cols * SUPERSAMPLING).astype(np.float32)
    return np.asarray(cv2.resize(tall, (view.cols, view.rows), interpolation=cv2.INTER_AREA), np.float32)
