"""The hexahedron of the coarse elastic solve: trilinear, with enhanced strains that make it exact in bending."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float32, Float64

from service.core.prior_grid import CORNERS, POINTS_27, CellGrid, shape_functions
from service.core.prior_moments import GAUSS_3

VOID_STIFFNESS = 1e-3
"""Young's modulus of the empty part of a cell, of that of the body: no node hangs free."""

FILL_POWER = 1.2
"""A cell that is part full is this power of its fill as stiff: cells too coarse for a member hold it too straight."""

FLOOR_STIFFNESS = 300.0
"""Stiffness of the bed between the sole and the support, in E/L per unit of area. It stands for a clamp of
500, which finer cells would feel as soft as this: measured best on 139 bodies of the simulator."""

_WEIGHTS_3 = np.array([5.0, 8.0, 5.0]) / 18.0
_WEIGHTS_27 = (_WEIGHTS_3[:, None, None] * _WEIGHTS_3[:, None] * _WEIGHTS_3).ravel()
_SIGNS = np.where(CORNERS == 1, 1.0, -1.0)
_FACTORS = np.where(CORNERS == 1, POINTS_27[:, None, :], 1.0 - POINTS_27[:, None, :])
_GRADIENTS = np.stack(
    [_SIGNS[:, axis] * np.delete(_FACTORS, axis, axis=2).prod(axis=2) for axis in range(3)], axis=2
)  # (27, 8, 3), of the unit cell
_FLOOR_SHAPE = shape_functions(np.stack(np.meshgrid(GAUSS_3, GAUSS_3, [0.0], indexing="ij")).reshape(3, -1)).T
_FLOOR_PAIRS = (_FLOOR_SHAPE[:, :, None] * _FLOOR_SHAPE[:, None, :]).reshape(9, 64)


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
    moduli = elastic_moduli(poisson_ratio)
    operator = np.zeros((27, 9, 24))
    for i in range(3):
        operator[:, 3 * i : 3 * i + 3, i::3] = (_GRADIENTS / grid.edges).transpose(0, 2, 1)
    modes = np.tile(POINTS_27 - 0.5, (1, 3))  # entry 3i + j varies along axis j
    stress = moduli @ operator
    coupling = ((_WEIGHTS_27[:, None] * modes)[:, :, None] * stress).sum(axis=0)
    # ∫(ξ_j − ½)² = 1/12, and entries of the same j are uncoupled by an isotropic law
    parameters = -12.0 * coupling / np.diag(moduli)[:, None]
    enhanced = operator + modes[:, :, None] * parameters
    table = enhanced.transpose(0, 2, 1) @ (moduli @ enhanced)
    laplace = np.tensordot(_WEIGHTS_27, operator.transpose(0, 2, 1) @ operator, axes=1)
    table = np.concatenate([table, laplace[None]]).reshape(28, 576) * grid.edges.prod()
    share = np.zeros((28, count), np.float32)
    share[:27, : len(grid.cells)] = grid.weights * np.maximum(grid.fill, 1e-3) ** (FILL_POWER - 1.0)
    share[27, : len(grid.cells)] = VOID_STIFFNESS * np.maximum(1.0 - grid.fill, 1e-3)
    return np.asarray((table.astype(np.float32).T @ share).reshape(24, 24, count))


def floor_stiffness(grid: CellGrid) -> Float64[np.ndarray, "b 8 8"]:
    """Stiffness of the bed under every floor cell, the same along each axis."""
    scale = FLOOR_STIFFNESS * grid.edges[0] * grid.edges[1]
    return np.asarray((scale * grid.floor_weights.T @ _FLOOR_PAIRS).reshape(-1, 8, 8))


def elastic_moduli(poisson_ratio: float) -> Float64[np.ndarray, "9 9"]:
    """Stress by displacement gradient, both row by row, for Young's modulus 1.

    Source: Hooke's law, λ tr ε + 2μ ε; Bonet and Wood, Nonlinear Continuum Mechanics (2008), eq. 6.29.
    """
    shear = 0.5 / (1.0 + poisson_ratio)
    lame = poisson_ratio / ((1.0 + poisson_ratio) * (1.0 - 2.0 * poisson_ratio))
    identity = np.eye(3)
    moduli = lame * np.einsum("ij,kl->ijkl", identity, identity)
    moduli += shear * (np.einsum("ik,jl->ijkl", identity, identity) + np.einsum("il,jk->ijkl", identity, identity))
    return np.asarray(moduli.reshape(9, 9))
