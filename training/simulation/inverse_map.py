"""The inverse of the map of deformed cells: which material point lies at a voxel's centre."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from jaxtyping import Float32, Float64, Int, Int32, UInt8, UInt32

from service.core.compiled import compiled
from training.simulation.sampled import INSIDE, NEAR, OUTSIDE, interpolated, plain_side
from training.simulation.trilinear import coefficients

Row: TypeAlias = tuple[float, float, float, float]

_ITERATIONS = 12
_FEW = 4
"""Iterations that settle all voxels of most cells; without a question between them they run eight voxels at a time."""
_TOLERANCE = 1e-3
"""Local coordinates are solved to this part of a cell, 1/400 of a voxel at 24³; voxels at a shared face are kept."""
_OUTSIDE = 0.75
"""Local coordinates, measured from the cell's centre, beyond which a voxel is given up as another cell's."""
_SMALLEST_SLOPE = 1e-9
"""Stands for a row of voxels that runs along a face of its cell: inside all the way or outside all the way."""
_SMALLEST_DETERMINANT = 1e-6
"""Of a cell, in cubic voxels: one turned inside out has no inverse; the solver reports states that hold one."""


@compiled
def material_points(
    position: Float64[np.ndarray, "nodes 3"],
    cell_nodes: Int[np.ndarray, "m 8"],
    active: Int[np.ndarray, "m 3"],
    state: UInt8[np.ndarray, "n2 n2 n2"],
    number: Int32[np.ndarray, "n2 n2 n2"],
    polynomial: Float32[np.ndarray, "k 27"],
    doubt: Float32[np.ndarray, " k"],
    plane: Float32[np.ndarray, "k 5"],
    cautious: bool,
    size: int,
    deformed: UInt8[np.ndarray, " voxels"],
    material: Float32[np.ndarray, "voxels 3"],
) -> None:
    """Mark every voxel centre whose material point lies in the body, and write that point.

    The trilinear map of a cell is its value and Jacobian at the centre plus four products of the local coordinates
    ξ ∈ [−½, ½]³, y = c + A ξ + B (ξη, ηζ, ζξ, ξηζ). The fixed point ξ ← A⁻¹(y − c) − A⁻¹B(ξη, ηζ, ζξ, ξηζ) converges
    in a few steps because cells are small; voxels that run away belong to another cell.

    Args:
        position: Deformed nodes, in voxel indices.
        cell_nodes: Corners 4·dx + 2·dy + dz of every cell.
        active: Index (i, j, k) of every cell at rest.
        state: See `SampledDistance`.
        number: See `SampledDistance`.
        polynomial: See `SampledDistance`.
        doubt: See `SampledDistance`.
        plane: See `SampledDistance`.
        cautious: Leave `NEAR` what only the distance itself can tell; else interpolation tells.
        size: Voxels along each edge of the cube.
        deformed: `OUTSIDE` before; written `INSIDE` or `NEAR`.
        material: Written where not `OUTSIDE`, in units of L; else left as it is.
    """
    edge = 2.0 / state.shape[0]
    bound = 0.5 + _TOLERANCE
    terms, inverse, curved = np.empty((8, 3)), np.empty((3, 3)), np.empty((3, 4))
    first, last = np.empty(3, np.int64), np.empty(3, np.int64)
    u, v, w, voxel = np.empty(0), np.empty(0), np.empty(0), np.empty(0, np.uint32)
    for cell in range(len(active)):
        if not (_expand(position, cell_nodes, cell, size, terms, first, last) and _invert(terms, inverse, curved)):
            continue
        most = (last[0] - first[0] + 1) * (last[1] - first[1] + 1) * (last[2] - first[2] + 1)
        if most > len(u):
            u, v, w, voxel = np.empty(most), np.empty(most), np.empty(most), np.empty(most, np.uint32)
        count = _candidates(terms, inverse, curved, first, last, size, u, v, w, voxel)
        _solve(curved, u[:count], v[:count], w[:count])
        ai, aj, ak = active[cell, 0], active[cell, 1], active[cell, 2]
        for row in range(count):
            x, y, z = u[row], v[row], w[row]
            if not (abs(x) <= bound and abs(y) <= bound and abs(z) <= bound):
                continue
            a, b, c = int(x > 0.0), int(y > 0.0), int(z > 0.0)
            i, j, k = 2 * ai + a, 2 * aj + b, 2 * ak + c
            side = int(state[i, j, k])
            if side == NEAR:
                # within this loop: handing five tables to a function takes longer than most of the answers
                octant = number[i, j, k]
                p, q, r = 4.0 * x + 1.0 - 2.0 * a, 4.0 * y + 1.0 - 2.0 * b, 4.0 * z + 1.0 - 2.0 * c
                side = plain_side(plane, octant, p, q, r)
                if side == NEAR:
                    value = interpolated(polynomial, octant, p, q, r)
                    if not cautious or abs(value) > doubt[octant]:
                        side = INSIDE if value < 0.0 else OUTSIDE
            # of two cells that meet in a voxel one that is sure of its material decides
            place = voxel[row]
            if side == OUTSIDE or (side == NEAR and deformed[place] == INSIDE):
                continue
            deformed[place] = side
            material[place, 0] = (ai + 0.5 + x) * edge
            material[place, 1] = (aj + 0.5 + y) * edge
            material[place, 2] = (ak + 0.5 + z) * edge


@compiled
def _expand(
    position: Float64[np.ndarray, "nodes 3"],
    cell_nodes: Int[np.ndarray, "m 8"],
    cell: int,
    size: int,
    terms: Float64[np.ndarray, "8 3"],
    first: Int[np.ndarray, " 3"],
    last: Int[np.ndarray, " 3"],
) -> bool:
    """Coefficients of 1, ξ, η, ζ, ξη, ηζ, ζξ, ξηζ in a cell's map, and the voxels of its bounding box; whether any."""
    for axis in range(3):
        a, b = position[cell_nodes[cell, 0], axis], position[cell_nodes[cell, 1], axis]
        c, d = position[cell_nodes[cell, 2], axis], position[cell_nodes[cell, 3], axis]
        e, f = position[cell_nodes[cell, 4], axis], position[cell_nodes[cell, 5], axis]
        g, h = position[cell_nodes[cell, 6], axis], position[cell_nodes[cell, 7], axis]
        low = min(min(min(a, b), min(c, d)), min(min(e, f), min(g, h)))
        high = max(max(max(a, b), max(c, d)), max(max(e, f), max(g, h)))
        if not (low < size and high >= -1.0):  # so that not even a NaN is taken for an index
            return False
        first[axis] = int(max(np.ceil(low - _TOLERANCE), 0.0))
        last[axis] = int(min(np.floor(high + _TOLERANCE), size - 1.0))
        if last[axis] < first[axis]:
            return False
        (
            terms[0, axis], terms[1, axis], terms[2, axis], terms[3, axis],
            terms[4, axis], terms[5, axis], terms[6, axis], terms[7, axis],
        ) = coefficients(a, b, c, d, e, f, g, h)  # fmt: skip
    return True


@compiled
def _invert(
    terms: Float64[np.ndarray, "8 3"], inverse: Float64[np.ndarray, "3 3"], curved: Float64[np.ndarray, "3 4"]
) -> bool:
    """Inverse of the Jacobian at the centre, and that times the bilinear terms; whether the cell is right side out."""
    for axis in range(3):
        b, c = (axis + 1) % 3, (axis + 2) % 3
        # rows of the inverse are cross products of the columns of the Jacobian, whose columns are terms 1 to 3
        inverse[axis, 0] = terms[1 + b, 1] * terms[1 + c, 2] - terms[1 + b, 2] * terms[1 + c, 1]
        inverse[axis, 1] = terms[1 + b, 2] * terms[1 + c, 0] - terms[1 + b, 0] * terms[1 + c, 2]
        inverse[axis, 2] = terms[1 + b, 0] * terms[1 + c, 1] - terms[1 + b, 1] * terms[1 + c, 0]
    determinant = terms[1, 0] * inverse[0, 0] + terms[1, 1] * inverse[0, 1] + terms[1, 2] * inverse[0, 2]
    if not determinant > _SMALLEST_DETERMINANT:
        return False
    for axis in range(3):
        for column in range(3):
            inverse[axis, column] /= determinant
        for term in range(4):
            curved[axis, term] = (
                inverse[axis, 0] * terms[4 + term, 0]
                + inverse[axis, 1] * terms[4 + term, 1]
                + inverse[axis, 2] * terms[4 + term, 2]
            )
    return True


@compiled
def _candidates(
    terms: Float64[np.ndarray, "8 3"],
    inverse: Float64[np.ndarray, "3 3"],
    curved: Float64[np.ndarray, "3 4"],
    first: Int[np.ndarray, " 3"],
    last: Int[np.ndarray, " 3"],
    size: int,
    u: Float64[np.ndarray, " n"],
    v: Float64[np.ndarray, " n"],
    w: Float64[np.ndarray, " n"],
    voxel: UInt32[np.ndarray, " n"],
) -> int:
    """Write the places of voxels that may lie in a cell and their affine local coordinates; returns how many."""
    step, half = np.empty(3), np.empty(3)
    for axis in range(3):
        slope = inverse[axis, 2]
        if abs(slope) < _SMALLEST_SLOPE:
            slope = _SMALLEST_SLOPE
        step[axis] = 1.0 / slope
        half[axis] = (0.5 + _TOLERANCE + _shift(curved, axis)) * abs(step[axis])
    # numbers in registers, where the compiler would have to read an array again after every write
    x_step, y_step, z_step = step[0], step[1], step[2]
    x_half, y_half, z_half = half[0], half[1], half[2]
    xi, xj, xk = inverse[0, 0], inverse[0, 1], inverse[0, 2]
    yi, yj, yk = inverse[1, 0], inverse[1, 1], inverse[1, 2]
    zi, zj, zk = inverse[2, 0], inverse[2, 1], inverse[2, 2]
    length = float(last[2] - first[2])
    dk = first[2] - terms[0, 2]
    count = 0
    for i in range(first[0], last[0] + 1):
        di = i - terms[0, 0]
        for j in range(first[1], last[1] + 1):
            dj = j - terms[0, 1]
            # affine guess at the row's first voxel, and where the row runs through the widened cell
            u0, v0, w0 = xi * di + xj * dj + xk * dk, yi * di + yj * dj + yk * dk, zi * di + zj * dj + zk * dk
            x_middle, y_middle, z_middle = -u0 * x_step, -v0 * y_step, -w0 * z_step
            start = max(x_middle - x_half, max(y_middle - y_half, max(z_middle - z_half, 0.0)))
            stop = min(x_middle + x_half, min(y_middle + y_half, min(z_middle + z_half, length)))
            if stop < start:
                continue
            for offset in range(int(np.ceil(start)), int(np.floor(stop)) + 1):
                voxel[count] = (i * size + j) * size + first[2] + offset
                u[count], v[count], w[count] = u0 + xk * offset, v0 + yk * offset, w0 + zk * offset
                count += 1
    return count


@compiled
def _shift(curved: Float64[np.ndarray, "3 4"], axis: int) -> float:
    """The largest shift along an axis that the products of local coordinates make within a cell."""
    pairs = abs(curved[axis, 0]) + abs(curved[axis, 1]) + abs(curved[axis, 2])
    return float(pairs / 4.0 + abs(curved[axis, 3]) / 8.0)


@compiled
def _solve(
    curved: Float64[np.ndarray, "3 4"],
    u: Float64[np.ndarray, " n"],
    v: Float64[np.ndarray, " n"],
    w: Float64[np.ndarray, " n"],
) -> None:
    """Turn affine local coordinates into those that solve the trilinear map; NaN where they do not settle."""
    # sums over the rows of the derivative of the products, |ξ| ≤ ½: what an iteration leaves of an error
    left, widest = 0.0, 0.0
    for axis in range(3):
        rows = abs(curved[axis, 0]) + abs(curved[axis, 1]) + abs(curved[axis, 2]) + 0.75 * abs(curved[axis, 3])
        left, widest = max(left, rows), max(widest, _shift(curved, axis))
    xs = (curved[0, 0], curved[0, 1], curved[0, 2], curved[0, 3])
    ys = (curved[1, 0], curved[1, 1], curved[1, 2], curved[1, 3])
    zs = (curved[2, 0], curved[2, 1], curved[2, 2], curved[2, 3])
    if widest * left**_FEW > 0.5 * _TOLERANCE:
        for row in range(len(u)):
            u[row], v[row], w[row] = _fixed_point(u[row], v[row], w[row], xs, ys, zs)
        return
    for row in range(len(u)):
        a, b, c = u[row], v[row], w[row]
        x, y, z = _improved(a, b, c, a, b, c, xs, ys, zs)
        x, y, z = _improved(a, b, c, x, y, z, xs, ys, zs)
        x, y, z = _improved(a, b, c, x, y, z, xs, ys, zs)
        u[row], v[row], w[row] = _improved(a, b, c, x, y, z, xs, ys, zs)


@compiled
def _improved(
    u: float, v: float, w: float, x: float, y: float, z: float, xs: Row, ys: Row, zs: Row
) -> tuple[float, float, float]:
    """One step of the fixed point."""
    xy, yz, zx, xyz = x * y, y * z, z * x, x * y * z
    return (
        u - xs[0] * xy - xs[1] * yz - xs[2] * zx - xs[3] * xyz,
        v - ys[0] * xy - ys[1] * yz - ys[2] * zx - ys[3] * xyz,
        w - zs[0] * xy - zs[1] * yz - zs[2] * zx - zs[3] * xyz,
    )


@compiled
def _fixed_point(
    u: float, v: float, w: float, xs: Row, ys: Row, zs: Row
) -> tuple[float, float, float]:
    """Local coordinates that solve the trilinear map, from its affine solution; NaN where it does not converge."""
    x, y, z = u, v, w
    for _ in range(_ITERATIONS):
        p, q, r = _improved(u, v, w, x, y, z, xs, ys, zs)
        settled = abs(p - x) < 0.5 * _TOLERANCE and abs(q - y) < 0.5 * _TOLERANCE and abs(r - z) < 0.5 * _TOLERANCE
        x = min(max(p, -_OUTSIDE), _OUTSIDE)
        y = min(max(q, -_OUTSIDE), _OUTSIDE)
        z = min(max(r, -_OUTSIDE), _OUTSIDE)
        if settled:
            return x, y, z
    return np.nan, np.nan, np.nan
