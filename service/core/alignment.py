"""PCA alignment: from the grid a body was reconstructed in to the body grid the deformation network knows."""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np
from jaxtyping import Float32, Int32

from service.core.arrays import GRID_SIZE, Bytes, Eights, Matrix3, Occupancy, Probability, Transform, Vector3
from service.core.compiled import compiled
from service.core.errors import EmptyObject
from service.core.grids import Grid, cross
from service.core.lookup import between

Columns: TypeAlias = Int32[np.ndarray, "x=64 y=64 sum=6"]
"""Of a body's voxels with one x and one y: how many there are, the sums of z, z² and z³, the lowest and highest z."""
Place: TypeAlias = tuple[float, float, float]
Padded: TypeAlias = Float32[np.ndarray, " voxels=287496"]
"""64³ voxels with one of zeros on every side, in C order."""

HORIZONTAL_FILL = 0.70
"""Share of the body grid's edge that the body may fill in x and y: the rest is room to deform into."""

VERTICAL_FILL = 0.74
"""The same for its height; the body stands on the floor of the grid, so all the room is above it."""

PARALLEL = 1.0 - 1e-11
"""Two axes with at least this cosine are one: over a whole grid they part by less than a thousandth of a voxel."""


def body_grid(occupancy: Occupancy, grid: Grid, up: Vector3 | None = None, on_floor: bool = True) -> Grid:
    """Align a body that stands on its support.

    z points against gravity. x is the axis of largest variance of the body's horizontal shape, its sign such that the
    third moment along x is not negative; y completes a right-handed frame. The body is centred in x and y and scaled
    to fill `HORIZONTAL_FILL` or `VERTICAL_FILL` of the grid, whichever binds first.

    Args:
        occupancy: The body.
        grid: Where its voxels are.
        up: Direction against gravity in the camera frame; None for the z axis of `grid`.
        on_floor: Whether the floor of `grid` is the support plane; else the body's lowest voxel stands on it.

    Raises:
        EmptyObject: No voxel is occupied.
    """
    columns, mean, spread = _moments(occupancy)
    if up is None:
        x, z = _widest(spread), np.array([0.0, 0.0, 1.0])
    else:
        upright = _rotation_with_z(grid.camera_from_grid[:3, :3].T @ up)
        x, z = upright @ _widest(upright.T @ spread @ upright), upright[:, 2]
    return _enclosing_grid(columns, grid, mean, x, z, on_floor)


def body_grid_free(occupancy: Occupancy, grid: Grid) -> Grid:
    """Align by all three principal axes, where `up` is unknown.

    z is the principal axis nearest to the grid's own z, x the axis of the larger variance among the other two, with
    signs as in `body_grid`; the floor is the lowest occupied voxel.

    Raises:
        EmptyObject: No voxel is occupied.
    """
    columns, mean, spread = _moments(occupancy)
    _, axes = np.linalg.eigh(spread)
    nearest = int(np.argmax(np.abs(axes[2])))
    z = axes[:, nearest] * np.sign(axes[2, nearest])
    x = axes[:, max(i for i in range(3) if i != nearest)]
    return _enclosing_grid(columns, grid, mean, x, z, on_floor=False)


def resample(probability: Probability, source: Grid, target: Grid) -> Probability:
    """Trilinear lookup of one grid at the voxel centres of another; zero outside the source."""
    source_from_target = source.grid_from_camera @ target.camera_from_grid
    steps = source_from_target[:3, :3] * (target.pitch_m / source.pitch_m)
    origin = source_from_target[:3, 3] / source.pitch_m - 0.5 + steps.sum(axis=1) / 2  # where the first centre lies
    result = np.empty((GRID_SIZE,) * 3, np.float32)
    if source_from_target[2, 2] < PARALLEL:
        padded = np.zeros((GRID_SIZE + 2,) * 3, np.float32)
        padded[1:-1, 1:-1, 1:-1] = probability
        _resample(padded.ravel(), steps, origin + 1.0, result)
    else:
        _resample_upright(np.ascontiguousarray(probability), steps, origin, result)
    return result


def _moments(occupancy: Occupancy) -> tuple[Columns, Vector3, Matrix3]:
    """The body's columns, mean of the filled voxels' indices, and their second moments about it times a number.

    Raises:
        EmptyObject: No voxel is filled.
    """
    filled = np.ascontiguousarray(occupancy)
    columns = np.zeros((GRID_SIZE, GRID_SIZE, 6), np.int32)
    mean, spread = np.empty(3), np.empty((3, 3))
    if _sums(filled.view(np.uint8), filled.view(np.uint64), columns, mean, spread) == 0:
        raise EmptyObject("The reconstruction is empty: no voxel of the object is left to align.", field="depth")
    return columns, mean, spread


def _widest(spread: Matrix3) -> Vector3:
    """The horizontal axis of the largest variance."""
    (xx, xy, _), (_, yy, _), _ = spread.tolist()
    # Across the axis of the smallest variance, whose angle is this one.
    angle = math.atan2(-2.0 * xy, yy - xx) / 2.0
    return np.array([-math.sin(angle), math.cos(angle), 0.0])


def _rotation_with_z(z: Vector3) -> Matrix3:
    """Some rotation whose third column is z."""
    z = z / np.linalg.norm(z)
    helper = np.eye(3)[int(np.argmin(np.abs(z)))]
    x = helper - (helper @ z) * z
    x /= np.linalg.norm(x)
    return np.stack([x, cross(z, x), z], axis=1)


def _enclosing_grid(columns: Columns, grid: Grid, mean: Vector3, x: Vector3, z: Vector3, on_floor: bool) -> Grid:
    """Cube around the filled voxels along x, of either sign, and z; its bottom on the source's floor or the lowest."""
    axes, source_from_grid = np.array([x, cross(z, x), z]), np.empty((4, 4))
    edge = _enclose(columns, mean, axes, on_floor, source_from_grid)
    source_from_grid[:3, 3] *= grid.pitch_m
    return Grid(pitch_m=grid.pitch_m * edge / GRID_SIZE, camera_from_grid=grid.camera_from_grid @ source_from_grid)


_ZERO, _ONE, _NEXT, _NONE = np.float32(0.0), np.float32(1.0), np.uintp(1), np.int32(0)


@compiled
def _sums(occupancy: Bytes, eights: Eights, columns: Columns, mean: Vector3, spread: Matrix3) -> int:
    """Number of the filled voxels; tells the sums of each column, and of all the mean index and the second moments."""
    count, first, second = 0, np.zeros(3, np.int64), np.zeros((3, 3), np.int64)
    for x in range(GRID_SIZE):
        for y in range(GRID_SIZE):
            filled = np.uint64(0)
            for eight in range(GRID_SIZE // 8):
                filled |= eights[x, y, eight]
            if filled == 0:
                continue
            n, along, squared, cubed, low, high = _NONE, _NONE, _NONE, _NONE, np.int32(GRID_SIZE), _NONE
            for z in range(GRID_SIZE):
                one, place = np.int32(occupancy[x, y, z]), np.int32(z)
                n = np.int32(n + one)
                along = np.int32(along + one * place)
                squared = np.int32(squared + one * place * place)
                cubed = np.int32(cubed + one * place * place * place)
                low = min(low, place if one else np.int32(GRID_SIZE))
                high = max(high, place if one else _NONE)
            columns[x, y, 0], columns[x, y, 1], columns[x, y, 2], columns[x, y, 3] = n, along, squared, cubed
            columns[x, y, 4], columns[x, y, 5] = low, high
            count += int(n)
            first[0] += n * x
            first[1] += n * y
            first[2] += along
            second[0, 0] += n * x * x
            second[0, 1] += n * x * y
            second[1, 1] += n * y * y
            second[0, 2] += along * x
            second[1, 2] += along * y
            second[2, 2] += squared
    # In integers: rounding must not choose the axes of a body that is as wide as it is deep.
    for i in range(3):
        mean[i] = first[i] / count
        for j in range(3):
            spread[i, j] = count * second[min(i, j), max(i, j)] - first[i] * first[j]
    return count


@compiled
def _enclose(columns: Columns, mean: Vector3, axes: Matrix3, on_floor: bool, source_from_grid: Transform) -> float:
    """Edge of `_enclosing_grid` in voxels; tells where it is, in voxels too, and turns the axes its way."""
    middle = axes[0, 0] * (mean[0] + 0.5) + axes[0, 1] * (mean[1] + 0.5) + axes[0, 2] * (mean[2] + 0.5)
    third_moment, (low_x, low_y, low_z), (high_x, high_y, high_z) = _extent(columns, axes, middle)
    if third_moment < 0.0:
        axes[:2] *= -1.0
        low_x, high_x, low_y, high_y = -high_x, -low_x, -high_y, -low_y
    # the outermost voxels end half of one beyond their centres
    floor = 0.0 if on_floor else low_z - 0.5
    width, depth, height = high_x - low_x + 1.0, high_y - low_y + 1.0, high_z + 0.5 - floor
    edge = max(width / HORIZONTAL_FILL, depth / HORIZONTAL_FILL, height / VERTICAL_FILL)
    corner_x, corner_y = (low_x + high_x - edge) / 2.0, (low_y + high_y - edge) / 2.0
    for i in range(3):
        source_from_grid[i, :3], source_from_grid[3, i] = axes[:, i], 0.0
        source_from_grid[i, 3] = corner_x * axes[0, i] + corner_y * axes[1, i] + floor * axes[2, i]
    source_from_grid[3, 3] = 1.0
    return float(edge)


@compiled
def _extent(columns: Columns, axes: Matrix3, middle: float) -> tuple[float, Place, Place]:
    """The third moment about the middle along the first axis, lowest and highest centre along each; in voxels."""
    third_moment, low, high = 0.0, np.full(3, np.inf), np.full(3, -np.inf)
    for x in range(GRID_SIZE):
        for y in range(GRID_SIZE):
            n, along, squared, cubed = columns[x, y, 0], columns[x, y, 1], columns[x, y, 2], columns[x, y, 3]
            lowest, highest = columns[x, y, 4], columns[x, y, 5]
            if n == 0:
                continue
            # Σ (off + step z)³ over the filled voxels.
            off, step = axes[0, 0] * (x + 0.5) + axes[0, 1] * (y + 0.5) + axes[0, 2] * 0.5 - middle, axes[0, 2]
            third_moment += off * off * (off * n + 3.0 * step * along) + step * step * (
                3.0 * off * squared + step * cubed
            )
            for axis in range(3):
                start = axes[axis, 0] * (x + 0.5) + axes[axis, 1] * (y + 0.5)
                bottom, top = start + axes[axis, 2] * (lowest + 0.5), start + axes[axis, 2] * (highest + 0.5)
                low[axis], high[axis] = min(low[axis], bottom, top), max(high[axis], bottom, top)
    return third_moment, (low[0], low[1], low[2]), (high[0], high[1], high[2])


@compiled
def _resample(padded: Padded, steps: Matrix3, origin: Vector3, result: Probability) -> None:
    """Values at origin + steps @ (i, j, k), in voxels of the padded source."""
    end, side, size = np.float32(GRID_SIZE + 1), GRID_SIZE + 2, np.uintp(GRID_SIZE + 2)
    for i in range(GRID_SIZE):
        for j in range(GRID_SIZE):
            x = np.float32(origin[0] + steps[0, 0] * i + steps[0, 1] * j)
            y = np.float32(origin[1] + steps[1, 0] * i + steps[1, 1] * j)
            z = np.float32(origin[2] + steps[2, 0] * i + steps[2, 1] * j)
            for k in range(GRID_SIZE):
                a = x + np.float32(steps[0, 2]) * np.float32(k)
                b = y + np.float32(steps[1, 2]) * np.float32(k)
                c = z + np.float32(steps[2, 2]) * np.float32(k)
                result[i, j, k] = _ZERO
                if _ZERO < a < end and _ZERO < b < end and _ZERO < c < end:
                    p, q, r = np.uintp(a), np.uintp(b), np.uintp(c)
                    a, b, c = a - np.floor(a), b - np.floor(b), c - np.floor(c)
                    result[i, j, k] = between(padded, (p * size + q) * size + r, side, side, a, b, c)


@compiled
def _resample_upright(source: Probability, steps: Matrix3, origin: Vector3, result: Probability) -> None:
    """The same where centres above each other stay above each other: whole columns between columns of the source.

    Above a body there are zeros, so each column is followed only as far up as one of the four around it is.
    """
    column = np.empty(GRID_SIZE + 2, np.float32)  # a zero below the lowest voxel, and one above the highest
    below, weight = np.empty(GRID_SIZE, np.uintp), np.empty(GRID_SIZE, np.float32)
    ends = np.empty(GRID_SIZE + 1, np.uintp)  # where a column of the result ends if the source's does after so many
    column[0], ends[GRID_SIZE] = _ZERO, 0
    for k in range(GRID_SIZE):
        below[k], weight[k], ends[k] = 0, _ZERO, 0
    for k in range(GRID_SIZE):
        z = origin[2] + steps[2, 2] * k + 1.0
        if 0.0 < z < GRID_SIZE + 1:
            below[k], weight[k] = np.uintp(z), np.float32(z - np.floor(z))
            for reached in range(int(below[k]), GRID_SIZE + 1):
                ends[reached] = k + 1
    tops = np.empty((GRID_SIZE, GRID_SIZE), np.int32)
    for p in range(GRID_SIZE):
        for q in range(GRID_SIZE):
            top = np.int32(0)
            for k in range(GRID_SIZE):
                top = max(top, np.int32(k + 1) if source[p, q, k] != _ZERO else np.int32(0))
            tops[p, q] = top
    for i in range(GRID_SIZE):
        for j in range(GRID_SIZE):
            x = origin[0] + steps[0, 0] * i + steps[0, 1] * j
            y = origin[1] + steps[1, 0] * i + steps[1, 1] * j
            for k in range(GRID_SIZE):
                result[i, j, k] = _ZERO
            if not (-1.0 < x < GRID_SIZE and -1.0 < y < GRID_SIZE):
                continue
            p, q = int(np.floor(x)), int(np.floor(y))
            a, b = np.float32(x - p), np.float32(y - q)
            # beyond the outermost columns there is nothing
            before, behind = _ONE - a if p >= 0 else _ZERO, a if p + 1 < GRID_SIZE else _ZERO
            left, right = _ONE - b if q >= 0 else _ZERO, b if q + 1 < GRID_SIZE else _ZERO
            p_next, q_next = min(p + 1, GRID_SIZE - 1), min(q + 1, GRID_SIZE - 1)
            p, q = max(p, 0), max(q, 0)
            top = max(tops[p, q], tops[p, q_next], tops[p_next, q], tops[p_next, q_next])
            for k in range(top):
                column[k + 1] = before * (left * source[p, q, k] + right * source[p, q_next, k]) + behind * (
                    left * source[p_next, q, k] + right * source[p_next, q_next, k]
                )
            column[top + 1] = _ZERO
            for k in range(ends[top]):
                lower = column[below[k]]
                result[i, j, k] = lower + weight[k] * (column[below[k] + _NEXT] - lower)
