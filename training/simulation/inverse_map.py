"""The inverse of the map of deformed cells: which material point lies at a voxel's centre."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from jaxtyping import Float32, Float64, Int, Int32, UInt8

from service.core.compiled import compiled
from training.simulation.sampled import EMPTY, INSIDE, NEAR, OUTSIDE, WHOLE, interpolated, plain_side
from training.simulation.trilinear import coefficients

Three: TypeAlias = tuple[np.float32, np.float32, np.float32]
Row: TypeAlias = tuple[np.float32, np.float32, np.float32, np.float32]

_ITERATIONS = 12
_ROUNDS = 3
"""Rounds of four iterations after which a cell's voxels are to be settled, known before they are solved: without a
question between them they run eight voxels at a time."""
_TILE = 4
"""Voxels along two edges of what is solved at a time: a cell of 24³ has two or three along each."""
_TOLERANCE = 1e-3
"""Local coordinates are solved to this part of a cell, 1/400 of a voxel at 24³; voxels at a shared face are kept."""
_OUTSIDE = 0.75
"""Local coordinates, measured from the cell's centre, beyond which a voxel is given up as another cell's."""
_SMALLEST_DETERMINANT = 1e-6
"""Of a cell, in cubic voxels: one turned inside out has no inverse; the solver reports states that hold one."""


@compiled
def material_points(
    position: Float64[np.ndarray, "nodes 3"],
    cell_nodes: Int[np.ndarray, "m 8"],
    active: Int[np.ndarray, "m 3"],
    cells: int,
    octants: Int32[np.ndarray, "m 8"],
    polynomial: Float32[np.ndarray, "k 27"],
    doubt: Float32[np.ndarray, " k"],
    plane: Float32[np.ndarray, "k 5"],
    cautious: bool,
    size: int,
    deformed: UInt8[np.ndarray, " voxels"],
    place: Int[np.ndarray, " 2*voxels"],
    moved: Float32[np.ndarray, "2*voxels 3"],
    asked: Int[np.ndarray, " voxels"],
    material: Float32[np.ndarray, "voxels 3"],
) -> tuple[int, int]:
    """Find every voxel centre whose material point lies in the body, and how far that point has come.

    The trilinear map of a cell is its value and Jacobian at the centre plus four products of the local coordinates
    ξ ∈ [−½, ½]³, y = c + A ξ + B (ξη, ηζ, ζξ, ξηζ). The fixed point ξ ← A⁻¹(y − c) − A⁻¹B(ξη, ηζ, ζξ, ξηζ) converges
    in a few steps because cells are small; voxels that run away belong to another cell.

    Args:
        position: Deformed nodes, in voxel indices.
        cell_nodes: Corners 4·dx + 2·dy + dz of every cell.
        active: Index (i, j, k) of every cell at rest.
        cells: Cells along each edge of the cube.
        octants: See `SampledDistance.octants_of`.
        polynomial: See `SampledDistance`.
        doubt: See `SampledDistance`.
        plane: See `SampledDistance`.
        cautious: Leave `NEAR` what only the distance itself can tell; else interpolation tells.
        size: Voxels along each edge of the cube.
        deformed: `OUTSIDE` before; written `INSIDE` or `NEAR`.
        place: Written: places in the flat grid of what was found, cell by cell. A voxel on the border of cells stands
            there once where one of them is sure of its material, and once more where another has a doubt.
        moved: Written: displacements of the material there, in units of L.
        asked: Written: rows of `place` that are `NEAR`, ascending.
        material: Written: the material points of these, in units of L.

    Returns:
        How many rows of `place` and of `asked` are written.
    """
    cell_edge, voxel_edge, bound = 1.0 / cells, 1.0 / size, np.float32(0.5 + _TOLERANCE)
    terms, inverse, curved = np.empty((8, 3)), np.empty((3, 3)), np.empty((3, 4))
    first, last = np.empty(3, np.int64), np.empty(3, np.int64)
    local = np.empty(3 * _TILE * _TILE, np.float32)
    count, doubtful = 0, 0
    for cell in range(len(active)):
        if not (_expand(position, cell_nodes, cell, size, terms, first, last) and _invert(terms, inverse, curved)):
            continue
        whole = True
        for octant in range(8):
            whole = whole and octants[cell, octant] == WHOLE
        # what stays the same for all voxels of the cell, in the precision in which they are solved
        xs = (np.float32(curved[0, 0]), np.float32(curved[0, 1]), np.float32(curved[0, 2]), np.float32(curved[0, 3]))
        ys = (np.float32(curved[1, 0]), np.float32(curved[1, 1]), np.float32(curved[1, 2]), np.float32(curved[1, 3]))
        zs = (np.float32(curved[2, 0]), np.float32(curved[2, 1]), np.float32(curved[2, 2]), np.float32(curved[2, 3]))
        rounds = _rounds(xs, ys, zs)
        along_y = (np.float32(inverse[0, 1]), np.float32(inverse[1, 1]), np.float32(inverse[2, 1]))
        along_z = (np.float32(inverse[0, 2]), np.float32(inverse[1, 2]), np.float32(inverse[2, 2]))
        ai, aj, ak = active[cell, 0] + 0.5, active[cell, 1] + 0.5, active[cell, 2] + 0.5
        for i in range(first[0], last[0] + 1):
            for j0 in range(first[1], last[1] + 1, _TILE):
                for k0 in range(first[2], last[2] + 1, _TILE):
                    di, dj, dk = i - terms[0, 0], j0 - terms[0, 1], k0 - terms[0, 2]
                    corner = (
                        np.float32(inverse[0, 0] * di + inverse[0, 1] * dj + inverse[0, 2] * dk),
                        np.float32(inverse[1, 0] * di + inverse[1, 1] * dj + inverse[1, 2] * dk),
                        np.float32(inverse[2, 0] * di + inverse[2, 1] * dj + inverse[2, 2] * dk),
                    )
                    if rounds > 0:
                        _solve(corner, along_y, along_z, xs, ys, zs, rounds, local)
                    else:
                        _solve_slowly(corner, along_y, along_z, xs, ys, zs, local)
                    for j in range(j0, min(j0 + _TILE, last[1] + 1)):
                        for k in range(k0, min(k0 + _TILE, last[2] + 1)):
                            lane = _TILE * (j - j0) + k - k0
                            x, y, z = local[lane], local[lane + _TILE * _TILE], local[lane + 2 * _TILE * _TILE]
                            if not (abs(x) <= bound and abs(y) <= bound and abs(z) <= bound):
                                continue
                            voxel, side = (i * size + j) * size + k, INSIDE
                            if not whole:
                                a, b, c = int(x > 0.0), int(y > 0.0), int(z > 0.0)
                                row = octants[cell, 4 * a + 2 * b + c]
                                if row == EMPTY:
                                    continue
                                if row >= 0:
                                    # here: handing tables to a function takes longer than most of the answers
                                    p, q, r = 4.0 * x + 1.0 - 2.0 * a, 4.0 * y + 1.0 - 2.0 * b, 4.0 * z + 1.0 - 2.0 * c
                                    side = plain_side(plane, row, p, q, r)
                                    if side == NEAR:
                                        value = interpolated(polynomial, row, p, q, r)
                                        if not cautious or abs(value) > doubt[row]:
                                            side = INSIDE if value < 0.0 else OUTSIDE
                                    if side == OUTSIDE:
                                        continue
                            # of two cells that meet in a voxel the first that is sure of its material decides
                            before = deformed[voxel]
                            if before == INSIDE or before == side:
                                continue
                            deformed[voxel] = side
                            if side == NEAR:
                                asked[doubtful] = count
                                material[doubtful, 0] = (ai + x) * cell_edge
                                material[doubtful, 1] = (aj + y) * cell_edge
                                material[doubtful, 2] = (ak + z) * cell_edge
                                doubtful += 1
                            place[count] = voxel
                            moved[count, 0] = (i + 0.5) * voxel_edge - (ai + x) * cell_edge
                            moved[count, 1] = (j + 0.5) * voxel_edge - (aj + y) * cell_edge
                            moved[count, 2] = (k + 0.5) * voxel_edge - (ak + z) * cell_edge
                            count += 1
    return count, doubtful


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
def _rounds(xs: Row, ys: Row, zs: Row) -> int:
    """Rounds of four steps that bring every voxel of a cell to half the tolerance; 0 where too many would be needed."""
    # sums over the rows of the derivative of the products, |ξ| ≤ ½: what an iteration leaves of an error
    x_left = abs(xs[0]) + abs(xs[1]) + abs(xs[2]) + np.float32(0.75) * abs(xs[3])
    y_left = abs(ys[0]) + abs(ys[1]) + abs(ys[2]) + np.float32(0.75) * abs(ys[3])
    z_left = abs(zs[0]) + abs(zs[1]) + abs(zs[2]) + np.float32(0.75) * abs(zs[3])
    left, error = max(x_left, y_left, z_left), max(_widening(xs), _widening(ys), _widening(zs))
    for rounds in range(1, _ROUNDS + 1):
        error *= left * left * left * left
        if error <= 0.5 * _TOLERANCE:
            return rounds
    return 0


@compiled
def _solve(
    corner: Three, along_y: Three, along_z: Three, xs: Row, ys: Row, zs: Row, rounds: int,
    local: Float32[np.ndarray, " 3*tile*tile"],
) -> None:  # fmt: skip
    """Write the local coordinates of a tile of voxels, x of all of them first, by a few steps of the fixed point.

    Args:
        corner: Affine local coordinates of the tile's first voxel.
        along_y: What they grow by from voxel to voxel along y.
        along_z: The same along z.
        xs: What the products of local coordinates add to x, see `_improved`.
        ys: To y.
        zs: To z.
        rounds: Of four steps each.
        local: Result; NaN where a voxel is another cell's.
    """
    # what lies beyond the affine cell, widened by the most that the products may add, is another cell's
    most = np.float32(0.5 + _TOLERANCE)
    x_most, y_most, z_most = most + _widening(xs), most + _widening(ys), most + _widening(zs)
    for first in range(rounds):
        # sixteen voxels in single precision are two vectors of each number
        for lane in range(_TILE * _TILE):
            j, k = np.float32(lane // _TILE), np.float32(lane % _TILE)
            u = corner[0] + along_y[0] * j + along_z[0] * k
            v = corner[1] + along_y[1] * j + along_z[1] * k
            w = corner[2] + along_y[2] * j + along_z[2] * k
            x, y, z = u, v, w
            if first > 0:
                x, y, z = local[lane], local[lane + _TILE * _TILE], local[lane + 2 * _TILE * _TILE]
            x, y, z = _improved(u, v, w, x, y, z, xs, ys, zs)
            x, y, z = _improved(u, v, w, x, y, z, xs, ys, zs)
            x, y, z = _improved(u, v, w, x, y, z, xs, ys, zs)
            x, y, z = _improved(u, v, w, x, y, z, xs, ys, zs)
            held = (abs(u) <= x_most) & (abs(v) <= y_most) & (abs(w) <= z_most)
            local[lane] = x if held else np.float32(np.nan)
            local[lane + _TILE * _TILE], local[lane + 2 * _TILE * _TILE] = y, z


@compiled
def _solve_slowly(
    corner: Three, along_y: Three, along_z: Three, xs: Row, ys: Row, zs: Row, local: Float32[np.ndarray, " 3*tile*tile"]
) -> None:
    """As `_solve`, for cells of which no bound says that they settle; NaN where a voxel does not."""
    most = np.float32(0.5 + _TOLERANCE)
    x_most, y_most, z_most = most + _widening(xs), most + _widening(ys), most + _widening(zs)
    far, small = np.float32(_OUTSIDE), np.float32(0.5 * _TOLERANCE)
    for step in range(_ITERATIONS):
        for lane in range(_TILE * _TILE):
            j, k = np.float32(lane // _TILE), np.float32(lane % _TILE)
            u = corner[0] + along_y[0] * j + along_z[0] * k
            v = corner[1] + along_y[1] * j + along_z[1] * k
            w = corner[2] + along_y[2] * j + along_z[2] * k
            x, y, z = u, v, w
            if step > 0:
                x, y, z = local[lane], local[lane + _TILE * _TILE], local[lane + 2 * _TILE * _TILE]
            p, q, r = _improved(u, v, w, x, y, z, xs, ys, zs)
            good = (abs(u) <= x_most) & (abs(v) <= y_most) & (abs(w) <= z_most)
            if step == _ITERATIONS - 1:
                good &= (abs(p - x) < small) & (abs(q - y) < small) & (abs(r - z) < small)
            # one that runs away stays within reach, and is outside
            p, q, r = min(max(p, -far), far), min(max(q, -far), far), min(max(r, -far), far)
            local[lane] = p if good else np.float32(np.nan)
            local[lane + _TILE * _TILE], local[lane + 2 * _TILE * _TILE] = q, r


@compiled
def _widening(products: Row) -> np.float32:
    """The largest shift along an axis that the products of local coordinates make within a cell."""
    pairs = abs(products[0]) + abs(products[1]) + abs(products[2])
    return np.float32(0.25) * pairs + np.float32(0.125) * abs(products[3])


@compiled
def _improved(
    u: np.float32, v: np.float32, w: np.float32, x: np.float32, y: np.float32, z: np.float32, xs: Row, ys: Row, zs: Row
) -> Three:
    """One step of the fixed point."""
    xy, yz, zx, xyz = x * y, y * z, z * x, x * y * z
    return (
        u - xs[0] * xy - xs[1] * yz - xs[2] * zx - xs[3] * xyz,
        v - ys[0] * xy - ys[1] * yz - ys[2] * zx - ys[3] * xyz,
        w - zs[0] * xy - zs[1] * yz - zs[2] * zx - zs[3] * xyz,
    )
