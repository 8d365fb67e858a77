"""What the material of the cells pushes back with, however far they are deformed.

A field over a cell is Σ c_m φ_m with φ = 1, ξ, η, ζ, ξη, ηζ, ξζ, ξηζ of the place within it, each from −½ to ½: a
gradient at a Gauss point costs twelve products with these, not twenty-four with the values of the corners.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from jaxtyping import Float32

from service.core.compiled import compiled
from service.core.prior_cells import Cells, Corners, Nodal, add_bed, at_corners, at_nodes
from service.core.prior_element import Element
from service.core.prior_rotation import cofactors

_ZERO, _QUARTER, _HALF, _ONE = (np.float32(number) for number in (0.0, 0.25, 0.5, 1.0))
_PLACE = np.float32(0.5 / np.sqrt(3.0))
"""Of the Gauss points from the middle of a cell, in its edges."""

_SMALLEST_RATIO = np.float32(1e-3)
"""Of volumes, where its logarithm is taken."""

Terms = Float32[np.ndarray, "3 7 k"]
Tensors = Float32[np.ndarray, "9 k"]
Row = Float32[np.ndarray, " k"]


@compiled
def missing_forces(cells: Cells, u: Nodal, force: Nodal, result: Nodal) -> np.float32:
    """Write the forces that are left when those of material and bed are taken off a load's.

    Returns:
        The smallest volume ratio J at a Gauss point with material, at most 1: where it is not positive the forces say
        nothing.
    """
    k, element = cells.nodes.shape[1], cells.element
    corners, forces = np.empty((8, 3, k), np.float32), np.empty((8, 3, k), np.float32)
    terms = np.empty((3, 7, k), np.float32)
    gradient, cofactor = np.empty((8, 9, k), np.float32), np.empty((8, 9, k), np.float32)
    ratio, pressure = np.empty((8, k), np.float32), np.zeros(k, np.float32)
    at_corners(cells, u, corners)
    _write_terms(corners, terms)
    smallest = _ONE
    for point in range(len(ratio)):
        x, y, z = _place(point)
        _write_gradient(terms, element.edges, x, y, z, gradient[point])
        _write_cofactor(gradient[point], cofactor[point], ratio[point])
        smallest = min(smallest, _add_ratio(element.weights[point], ratio[point], pressure))
    _write_pressure(element, pressure)
    for i in range(len(terms)):
        for m in range(terms.shape[1]):
            for c in range(k):
                terms[i, m, c] = _ZERO
    for point in range(len(ratio)):
        x, y, z = _place(point)
        _write_stress(gradient[point], cofactor[point], ratio[point], element.weights[point], pressure, element.shear)
        _add_work(gradient[point], element.edges, x, y, z, terms)
    _write_corners(terms, forces)
    _add_void(element, corners, forces)
    at_nodes(cells, forces, result)
    add_bed(cells, u, result)
    for i in range(len(result)):
        row, applied = result[i], force[i]
        for v in range(len(row)):
            row[v] = applied[v] - row[v]
    return smallest


@compiled
def _place(point: int) -> tuple[np.float32, np.float32, np.float32]:
    return (
        _PLACE if point & 4 else -_PLACE, _PLACE if point & 2 else -_PLACE, _PLACE if point & 1 else -_PLACE
    )  # fmt: skip


@partial(compiled, apart=True)
def _write_terms(corners: Corners, terms: Terms) -> None:
    """From values at the corners 4·dx + 2·dy + dz to coefficients; the constant is not asked for."""
    for i in range(len(terms)):
        a, b, c, d = corners[0, i], corners[1, i], corners[2, i], corners[3, i]
        e, f, g, h = corners[4, i], corners[5, i], corners[6, i], corners[7, i]
        x, y, z, xy, yz, xz, xyz = (
            terms[i, 0], terms[i, 1], terms[i, 2], terms[i, 3], terms[i, 4], terms[i, 5], terms[i, 6]
        )  # fmt: skip
        for k in range(len(x)):
            sum_0, sum_1, sum_2, sum_3 = a[k] + b[k], c[k] + d[k], e[k] + f[k], g[k] + h[k]
            step_0, step_1, step_2, step_3 = b[k] - a[k], d[k] - c[k], f[k] - e[k], h[k] - g[k]
            x[k] = _QUARTER * ((sum_2 + sum_3) - (sum_0 + sum_1))
            y[k] = _QUARTER * ((sum_1 + sum_3) - (sum_0 + sum_2))
            z[k] = _QUARTER * ((step_0 + step_1) + (step_2 + step_3))
            xy[k] = _HALF * ((sum_3 - sum_2) - (sum_1 - sum_0))
            yz[k] = _HALF * ((step_1 - step_0) + (step_3 - step_2))
            xz[k] = _HALF * ((step_2 + step_3) - (step_0 + step_1))
            xyz[k] = (step_3 - step_2) - (step_1 - step_0)


@partial(compiled, apart=True)
def _write_corners(terms: Terms, corners: Corners) -> None:
    """The transpose of `_write_terms`: from work on the coefficients to forces on the corners."""
    for i in range(terms.shape[0]):
        for a in range(len(corners)):
            x, y, z = _ONE if a & 4 else -_ONE, _ONE if a & 2 else -_ONE, _ONE if a & 1 else -_ONE
            row, first, second, third = corners[a, i], terms[i, 0], terms[i, 1], terms[i, 2]
            fourth, fifth, sixth, last = terms[i, 3], terms[i, 4], terms[i, 5], terms[i, 6]
            for k in range(len(row)):
                linear = _QUARTER * (x * first[k] + y * second[k] + z * third[k])
                bilinear = _HALF * (x * y * fourth[k] + y * z * fifth[k] + x * z * sixth[k])
                row[k] = linear + bilinear + x * y * z * last[k]


@partial(compiled, apart=True)
def _write_gradient(
    terms: Terms, edges: Float32[np.ndarray, "3"], x: np.float32, y: np.float32, z: np.float32, result: Tensors
) -> None:
    """F = 1 + ∂u/∂X at a place of every cell, row by row."""
    by_x, by_y, by_z = _ONE / edges[0], _ONE / edges[1], _ONE / edges[2]
    xy, yz, xz = x * y, y * z, x * z
    for i in range(len(terms)):
        of_x, of_y, of_z = terms[i, 0], terms[i, 1], terms[i, 2]
        of_xy, of_yz, of_xz, of_xyz = terms[i, 3], terms[i, 4], terms[i, 5], terms[i, 6]
        along_x, along_y, along_z = result[3 * i], result[3 * i + 1], result[3 * i + 2]
        one_x, one_y = _ONE if i == 0 else _ZERO, _ONE if i == 1 else _ZERO
        one_z = _ONE if i == 2 else _ZERO
        for k in range(len(along_x)):
            along_x[k] = one_x + by_x * (of_x[k] + y * of_xy[k] + z * of_xz[k] + yz * of_xyz[k])
            along_y[k] = one_y + by_y * (of_y[k] + x * of_xy[k] + z * of_yz[k] + xz * of_xyz[k])
            along_z[k] = one_z + by_z * (of_z[k] + y * of_yz[k] + x * of_xz[k] + xy * of_xyz[k])


@partial(compiled, apart=True)
def _write_cofactor(gradient: Tensors, cofactor: Tensors, ratio: Row) -> None:
    """The cofactors of F, and J = det F."""
    f0, f1, f2, f3, f4, f5, f6, f7, f8 = (
        gradient[0], gradient[1], gradient[2], gradient[3], gradient[4], gradient[5], gradient[6], gradient[7],
        gradient[8],
    )  # fmt: skip
    c0, c1, c2, c3, c4, c5, c6, c7, c8 = (
        cofactor[0], cofactor[1], cofactor[2], cofactor[3], cofactor[4], cofactor[5], cofactor[6], cofactor[7],
        cofactor[8],
    )  # fmt: skip
    for k in range(len(ratio)):
        p, q, r, s, t, u, v, w, x = cofactors(
            f0[k], f1[k], f2[k], f3[k], f4[k], f5[k], f6[k], f7[k], f8[k]
        )  # fmt: skip
        c0[k], c1[k], c2[k], c3[k], c4[k], c5[k], c6[k], c7[k], c8[k] = p, q, r, s, t, u, v, w, x
        ratio[k] = f0[k] * p + f1[k] * q + f2[k] * r


@partial(compiled, apart=True)
def _add_ratio(weight: Row, ratio: Row, total: Row) -> np.float32:
    """Add what a Gauss point's volume becomes; 1 stands for the ratio where it holds nothing. The smallest one."""
    smallest = _ONE
    for k in range(len(ratio)):
        if not weight[k] > _ZERO:
            ratio[k] = _ONE
        smallest = min(smallest, ratio[k])
        total[k] += weight[k] * ratio[k]
    return smallest


@compiled
def _write_pressure(element: Element, values: Row) -> None:
    """From the volumes of the cells to p = λ ln J̄/J̄."""
    for k in range(len(values)):
        volume = _ZERO
        for point in range(len(element.weights)):
            volume += element.weights[point, k]
        mean = max(values[k] / volume, _SMALLEST_RATIO) if volume > _ZERO else _ONE
        values[k] = element.bulk * np.log(mean) / mean


@partial(compiled, apart=True)
def _write_stress(
    gradient: Tensors, cofactor: Tensors, ratio: Row, weight: Row, pressure: Row, shear: np.float32
) -> None:
    """Write the first Piola-Kirchhoff stress of a Gauss point, times what it stands for, over the gradient.

    P = μ F + (p − μ/J) cof F.
    """
    for k in range(len(weight)):  # the ratio is not needed any more
        ratio[k] = weight[k] * (pressure[k] - shear / ratio[k])
    for entry in range(len(gradient)):
        row, cofactors_of = gradient[entry], cofactor[entry]
        for k in range(len(weight)):
            row[k] = shear * weight[k] * row[k] + ratio[k] * cofactors_of[k]


@partial(compiled, apart=True)
def _add_work(
    stress: Tensors, edges: Float32[np.ndarray, "3"], x: np.float32, y: np.float32, z: np.float32, terms: Terms
) -> None:
    """Add the work that the stress at a place does on the coefficients."""
    by_x, by_y, by_z = _ONE / edges[0], _ONE / edges[1], _ONE / edges[2]
    xy, yz, xz = x * y, y * z, x * z
    for i in range(len(terms)):
        along_x, along_y, along_z = stress[3 * i], stress[3 * i + 1], stress[3 * i + 2]
        on_x, on_y, on_z = terms[i, 0], terms[i, 1], terms[i, 2]
        on_xy, on_yz, on_xz, on_xyz = terms[i, 3], terms[i, 4], terms[i, 5], terms[i, 6]
        for k in range(len(on_x)):
            a, b, c = by_x * along_x[k], by_y * along_y[k], by_z * along_z[k]
            on_x[k] += a
            on_y[k] += b
            on_z[k] += c
            on_xy[k] += y * a + x * b
            on_yz[k] += z * b + y * c
            on_xz[k] += z * a + x * c
            on_xyz[k] += yz * a + xz * b + xy * c


@partial(compiled, apart=True)
def _add_void(element: Element, corners: Corners, forces: Corners) -> None:
    """Add the forces of what is empty."""
    u, result, void, stiffness = corners.reshape(24, -1), forces.reshape(24, -1), element.void, element.void_stiffness
    for a in range(len(result)):
        row = result[a]
        for b in range(0, len(u), 4):
            first, second, third, fourth = u[b], u[b + 1], u[b + 2], u[b + 3]
            p, q, r, s = stiffness[a, b], stiffness[a, b + 1], stiffness[a, b + 2], stiffness[a, b + 3]
            for k in range(len(row)):
                row[k] += void[k] * (p * first[k] + q * second[k] + r * third[k] + s * fourth[k])
