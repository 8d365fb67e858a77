"""The hexahedron of the coarse elastic solve: trilinear, its volumetric energy that of the cell's mean volume ratio."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, Float64

from service.core.compiled import compiled
from service.core.prior_grid import CORNERS, CellGrid, shape_functions
from service.core.prior_sole import GAUSS_3
from service.core.vectors import add_share

VOID_STIFFNESS = 1e-3
"""Young's modulus of the empty part of a cell, of that of the body: no node hangs free."""

FILL_POWER = 1.2
"""A cell that is part full is this power of its fill as stiff: cells too coarse for a member hold it too straight."""

FLOOR_STIFFNESS = 300.0
"""Stiffness of the bed between the sole and the support, in E/L per unit of area. It stands for a clamp of
500, which finer cells would feel as soft as this: measured best on 139 bodies of the simulator."""

EMPTY_OCTANT = 0.02
"""Octants holding less material than this count as empty; their Gauss point lies far from what they hold."""

_POINTS: Float64[np.ndarray, "8 3"] = 0.5 + (CORNERS - 0.5) / np.sqrt(3.0)
_SIGNS = np.where(CORNERS == 1, 1.0, -1.0)
_FACTORS = np.where(CORNERS == 1, _POINTS[:, None, :], 1.0 - _POINTS[:, None, :])
_GRADIENTS = np.ascontiguousarray(
    np.stack([_SIGNS[:, j] * np.delete(_FACTORS, j, axis=2).prod(axis=2) for j in range(3)], axis=2), np.float32
)  # (point, node, axis), of the unit cell
_LOWER = CORNERS[:, 2] == 0
_FLOOR_SHAPE = shape_functions(np.stack(np.meshgrid(GAUSS_3, GAUSS_3, [0.0], indexing="ij")).reshape(3, -1))[_LOWER]
_FLOOR_PAIRS = (_FLOOR_SHAPE[:, None] * _FLOOR_SHAPE).reshape(16, 9).astype(np.float32)

Edges = Float32[np.ndarray, "3"]
Row = Float32[np.ndarray, " k"]


class Element(NamedTuple):
    """The material of a body's cells, for Young's modulus 1.

    μ/2 (tr FᵀF − 3) − μ ln J is integrated at the 2×2×2 Gauss points, each of which stands for the material of its own
    octant, λ/2 ln² J̄ once a cell with J̄ = Σ w J/Σ w: it does not lock as ν → ½. This is the law and the element of the
    simulator that the networks learn from.

    Attributes:
        weights: Volume that each Gauss point 4·dx + 2·dy + dz stands for.
        void: Stiffness of the empty part of each cell, as a share of `void_stiffness`.
        void_stiffness: Of a cell of modulus 1 and ν = 0, linear: what is empty may turn inside out without a cost.
        edges: Of a cell along x, y, z.
        shear: μ.
        bulk: λ.

    Source: Hughes, The Finite Element Method (2000), section 4.5; Bonet and Wood, Nonlinear Continuum Mechanics (2008),
    section 8.6. Weights by octants, finite cells: Parvizian, Düster and Rank, Comput. Mech. 41 (2007).
    """

    weights: Float32[np.ndarray, "8 k"]
    void: Float32[np.ndarray, " k"]
    void_stiffness: Float32[np.ndarray, "24 24"]
    edges: Float32[np.ndarray, "3"]
    shear: np.float32
    bulk: np.float32

    @classmethod
    def of(cls, grid: CellGrid, poisson_ratio: float, count: int) -> Element:
        """The element of a grid's cells.

        Args:
            grid: The cells.
            poisson_ratio: ν in [0, 0.49].
            count: Cells of the answer, at least as many as the grid's; those after them hold nothing.
        """
        own, volume = len(grid.cells), float(np.prod(grid.edges))
        fill = np.maximum(grid.fill, np.float32(1e-3))
        weights, void = np.zeros((8, count), np.float32), np.zeros(count, np.float32)
        held = np.where(8.0 * grid.octants < EMPTY_OCTANT, np.float32(0.0), grid.octants)
        weights[:, :own] = held * (np.float32(volume) * fill ** np.float32(FILL_POWER - 1.0))
        void[:own] = VOID_STIFFNESS * np.maximum(1.0 - grid.fill, 1e-3)
        edges = grid.edges.astype(np.float32)
        stiffness = np.float32(volume / 16.0) * _shear_stiffness(edges).sum(axis=0)
        return cls(
            weights, void, stiffness, edges, np.float32(0.5 / (1.0 + poisson_ratio)),
            np.float32(poisson_ratio / ((1.0 + poisson_ratio) * (1.0 - 2.0 * poisson_ratio))),
        )  # fmt: skip


def rest_stiffness(element: Element) -> Float32[np.ndarray, "24 24 k"]:
    """Stiffness of every cell at rest, which is that of linear elasticity; local degree of freedom 3·node + axis."""
    result = np.empty((24, 24, len(element.void)), np.float32)
    _write_rest_stiffness(element, result)
    return result


@compiled
def _write_rest_stiffness(element: Element, result: Float32[np.ndarray, "24 24 k"]) -> None:
    """Sums over the Gauss points, and λ V h ⊗ h with h the mean of the points' ∇N."""
    table = _shear_stiffness(element.edges)
    mean, bulk = np.zeros((24, len(element.void)), np.float32), np.zeros(len(element.void), np.float32)
    for point in range(len(table)):
        add_share(np.float32(1.0), element.weights[point], bulk)
        for a in range(len(mean)):
            add_share(_GRADIENTS[point, a // 3, a % 3] / element.edges[a % 3], element.weights[point], mean[a])
    for k in range(len(bulk)):
        bulk[k] = element.bulk / bulk[k] if bulk[k] > np.float32(0.0) else np.float32(0.0)
    for a in range(len(result)):
        for b in range(a, len(result)):
            row = result[a, b]
            _write_product(bulk, mean[a], mean[b], row)
            for point in range(len(table)):
                if table[point, a, b] != np.float32(0.0):
                    add_share(element.shear * table[point, a, b], element.weights[point], row)
            add_share(element.void_stiffness[a, b], element.void, row)
            other = result[b, a]
            for k in range(len(row)):
                other[k] = row[k]


@compiled
def _shear_stiffness(edges: Edges) -> Float32[np.ndarray, "8 24 24"]:
    """2 ε : ε by the displacements at the Gauss points: ∇N_a·∇N_b 1 + ∇N_b ⊗ ∇N_a."""
    result = np.empty((8, 24, 24), np.float32)
    for point in range(len(result)):
        for a in range(result.shape[1]):
            i = a % 3
            for b in range(result.shape[2]):
                j = b % 3
                value = _GRADIENTS[point, a // 3, j] * _GRADIENTS[point, b // 3, i] / (edges[i] * edges[j])
                if i == j:
                    for axis in range(len(edges)):
                        product = _GRADIENTS[point, a // 3, axis] * _GRADIENTS[point, b // 3, axis]
                        value += product / (edges[axis] * edges[axis])
                result[point, a, b] = value
    return result


@partial(compiled, apart=True)
def _write_product(first: Row, second: Row, third: Row, result: Row) -> None:
    for k in range(len(result)):
        result[k] = first[k] * second[k] * third[k]


def floor_stiffness(grid: CellGrid) -> Float32[np.ndarray, "4 4 b"]:
    """Stiffness of the bed under every floor cell between its lower corners, the same along each axis."""
    scale = np.float32(FLOOR_STIFFNESS * grid.edges[0] * grid.edges[1])
    return np.asarray((_FLOOR_PAIRS @ (scale * grid.sole_weights)).reshape(4, 4, -1))
