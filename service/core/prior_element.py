"""The hexahedron of the coarse elastic solve: trilinear, with enhanced strains that make it exact in bending."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float32, Float64

from service.core.compiled import compiled
from service.core.prior_grid import CORNERS, POINTS_27, CellGrid, shape_functions
from service.core.prior_moments import GAUSS_3, add_share

VOID_STIFFNESS = 1e-3
"""Young's modulus of the empty part of a cell, of that of the body: no node hangs free."""

FILL_POWER = 1.2
"""A cell that is part full is this power of its fill as stiff: cells too coarse for a member hold it too straight."""

FLOOR_STIFFNESS = 300.0
"""Stiffness of the bed between the sole and the support, in E/L per unit of area. It stands for a clamp of
500, which finer cells would feel as soft as this: measured best on 139 bodies of the simulator."""

_WEIGHTS_3 = np.array([5.0, 8.0, 5.0]) / 18.0
_WEIGHTS_27 = (_WEIGHTS_3[:, None, None] * _WEIGHTS_3[:, None] * _WEIGHTS_3).ravel().astype(np.float32)
_MODES = (POINTS_27 - 0.5).astype(np.float32)
_SIGNS = np.where(CORNERS == 1, 1.0, -1.0)
_FACTORS = np.where(CORNERS == 1, POINTS_27[:, None, :], 1.0 - POINTS_27[:, None, :])
_GRADIENTS = np.ascontiguousarray(
    np.stack([_SIGNS[:, axis] * np.delete(_FACTORS, axis, axis=2).prod(axis=2) for axis in range(3)], axis=2),
    np.float32,
)  # (27, 8, 3), of the unit cell
_FLOOR_SHAPE = shape_functions(np.stack(np.meshgrid(GAUSS_3, GAUSS_3, [0.0], indexing="ij")).reshape(3, -1))
_FLOOR_SHAPE = _FLOOR_SHAPE[CORNERS[:, 2] == 0]
_FLOOR_PAIRS = (_FLOOR_SHAPE[:, None] * _FLOOR_SHAPE).reshape(16, 9).astype(np.float32)

Moduli = Float32[np.ndarray, "9 9"]
Rows = Float32[np.ndarray, "9 24"]


def cell_stiffness(grid: CellGrid, poisson_ratio: float, count: int) -> Float32[np.ndarray, "24 24 count"]:
    """Stiffness of every cell for Young's modulus 1; local degree of freedom 3·node + axis.

    The displacement gradient is enhanced by α_ij (ξ_j − ½) with the α of a full cell, whose nine equations are
    uncoupled: this takes out the parasitic shear and the parasitic thickness strains of bending and, with them, most of
    the volumetric locking. What is left is one constant 24×24 matrix a Gauss point; the cells weigh them by what they
    hold.

    Args:
        grid: The cells.
        poisson_ratio: ν in [0, 0.49].
        count: Cells of the answer, at least as many; those after the body's have no stiffness.

    Source: Simo and Rifai, IJNME 29 (1990), here with the enhancement of the full parallelepiped (Taylor, Beresford and
    Wilson, IJNME 10 (1976)) also in cells that are part full.
    """
    table = np.zeros((28, 24, 24), np.float32)
    _point_stiffness(elastic_moduli(poisson_ratio).astype(np.float32), grid.edges.astype(np.float32), table)
    share = np.zeros((28, count), np.float32)
    share[:27, : len(grid.cells)] = grid.weights * np.maximum(grid.fill, 1e-3) ** (FILL_POWER - 1.0)
    share[27, : len(grid.cells)] = VOID_STIFFNESS * np.maximum(1.0 - grid.fill, 1e-3)
    return np.asarray((table.reshape(28, 576).T @ share).reshape(24, 24, count))


@compiled
def _point_stiffness(moduli: Moduli, edges: Float32[np.ndarray, "3"], table: Float32[np.ndarray, "28 24 24"]) -> None:
    """Add what each Gauss point stands for in the stiffness of a full cell, by its weight, and last that of the void.

    The entry 3i + j of a displacement gradient is ∂u_i/∂x_j, enhanced by a mode that varies along axis j.
    """
    freedoms = table.shape[1]
    gradient, stress = np.zeros((27, 9, freedoms), np.float32), np.empty((9, freedoms), np.float32)
    coupling = np.zeros((9, freedoms), np.float32)
    volume = edges[0] * edges[1] * edges[2]
    for q in range(len(gradient)):
        for column in range(table.shape[1]):
            for j in range(len(edges)):
                gradient[q, 3 * (column % 3) + j, column] = _GRADIENTS[q, column // 3, j] / edges[j]
        _stresses(moduli, gradient[q], stress)
        for m in range(len(coupling)):
            add_share(_WEIGHTS_27[q] * _MODES[q, m % 3], stress[m], coupling[m])
        _add_products(gradient[q], gradient[q], _WEIGHTS_27[q] * volume, table[27])
    for q in range(len(gradient)):
        for m in range(len(coupling)):
            # ∫(ξ_j − ½)² = 1/12, and entries of the same j are uncoupled by an isotropic law
            add_share(np.float32(-12.0) * _MODES[q, m % 3] / moduli[m, m], coupling[m], gradient[q, m])
        _stresses(moduli, gradient[q], stress)
        _add_products(gradient[q], stress, volume, table[q])


@compiled
def _stresses(moduli: Moduli, gradient: Rows, stress: Rows) -> None:
    for m in range(len(moduli)):
        for b in range(stress.shape[1]):
            stress[m, b] = 0.0
        for n in range(len(moduli)):
            if moduli[m, n] != 0.0:
                add_share(moduli[m, n], gradient[n], stress[m])


@compiled
def _add_products(first: Rows, second: Rows, share: np.float32, result: Float32[np.ndarray, "24 24"]) -> None:
    """Add a share of the products of columns."""
    for a in range(len(result)):
        for m in range(len(first)):
            if first[m, a] != 0.0:
                add_share(share * first[m, a], second[m], result[a])


def floor_stiffness(grid: CellGrid) -> Float32[np.ndarray, "4 4 b"]:
    """Stiffness of the bed under every floor cell between its lower corners, the same along each axis."""
    scale = np.float32(FLOOR_STIFFNESS * grid.edges[0] * grid.edges[1])
    return np.asarray((_FLOOR_PAIRS @ (scale * grid.floor_weights)).reshape(4, 4, -1))


def elastic_moduli(poisson_ratio: float) -> Float64[np.ndarray, "9 9"]:
    """Stress by displacement gradient, both row by row, for Young's modulus 1.

    Source: Hooke's law, λ tr ε + 2μ ε; Bonet and Wood, Nonlinear Continuum Mechanics (2008), eq. 6.29.
    """
    shear = 0.5 / (1.0 + poisson_ratio)
    lame = poisson_ratio / ((1.0 + poisson_ratio) * (1.0 - 2.0 * poisson_ratio))
    return np.asarray(lame * _TRACE + shear * _TWICE_SYMMETRIC)


_IDENTITY = np.eye(3)
_TRACE = np.einsum("ij,kl->ijkl", _IDENTITY, _IDENTITY).reshape(9, 9)
_TWICE_SYMMETRIC = (
    np.einsum("ik,jl->ijkl", _IDENTITY, _IDENTITY) + np.einsum("il,jk->ijkl", _IDENTITY, _IDENTITY)
).reshape(9, 9)
