"""The forces of the coarse cells beside the energy that they are the slope of, and beside the simulator's element."""

from __future__ import annotations

import numpy as np
import pytest

from service.core.prior_cells import Cells, add_bed
from service.core.prior_element import VOID_STIFFNESS
from service.core.prior_forces import missing_forces
from service.core.prior_grid import CORNERS, CellGrid

GAUSS = 0.5 + (CORNERS - 0.5) / np.sqrt(3.0)


def body() -> np.ndarray:
    """Every cell of its grid is part full, or most of them."""
    x, y, z = np.indices((64, 64, 64)) - np.array([30.0, 33.0, 0.0])[:, None, None, None]
    return np.asarray(np.sqrt(x**2 + 0.5 * y**2) + 0.3 * z < 22.0)


GRID = CellGrid.fit(body(), 60)


def some(scale: float) -> np.ndarray:
    return (scale * np.random.default_rng(0).normal(size=(3, len(GRID.nodes)))).astype(np.float32)


def internal(cells: Cells, u: np.ndarray) -> tuple[np.ndarray, float]:
    """Forces of the material alone, and the smallest volume ratio."""
    result, bed = np.empty_like(u), np.zeros_like(u)
    smallest = missing_forces(cells, u, np.zeros_like(u), result)
    add_bed(cells, u, bed)
    return -result - bed, float(smallest)


def energy(cells: Cells, u: np.ndarray) -> float:
    """By the law, in NumPy and in double precision."""
    element, m = cells.element, cells.own
    factors = np.where(CORNERS == 1, GAUSS[:, None], 1.0 - GAUSS[:, None])
    signs = np.where(CORNERS == 1, 1.0, -1.0)
    slopes = np.stack([signs[:, j] * np.delete(factors, j, axis=2).prod(axis=2) for j in range(3)], axis=2)
    corners = u.T[cells.nodes[:, :m]].astype(float)  # (8, m, 3)
    gradient = np.einsum("ami,gaj->gmij", corners, slopes / GRID.edges) + np.eye(3)
    weight, ratio = element.weights[:, :m].astype(float), np.linalg.det(gradient)
    ratio = np.where(weight > 0.0, ratio, 1.0)
    shear, bulk = float(element.shear), float(element.bulk)
    stored = (weight * shear * (0.5 * ((gradient**2).sum(axis=(2, 3)) - 3.0) - np.log(ratio))).sum()
    volume = weight.sum(axis=0)
    mean = (weight * ratio).sum(axis=0) / np.where(volume > 0.0, volume, 1.0)
    stored += (0.5 * bulk * volume * np.log(np.where(volume > 0.0, mean, 1.0)) ** 2).sum()
    strain = gradient - np.eye(3)
    strain = 0.5 * (strain + strain.swapaxes(2, 3))
    empty = VOID_STIFFNESS * (1.0 - GRID.fill) * np.prod(GRID.edges) / 8.0
    return float(stored + 0.5 * (empty * (strain**2).sum(axis=(0, 2, 3))).sum())


@pytest.mark.parametrize("poisson_ratio", [0.0, 0.3, 0.49])
def test_forces_are_the_slope_of_the_energy(poisson_ratio: float) -> None:
    cells = Cells.of(GRID, poisson_ratio)
    u, toward = some(0.01), some(1.0)[::-1].copy()
    step = 1e-5
    slope = (energy(cells, u + step * toward) - energy(cells, u - step * toward)) / (2 * step)
    forces, smallest = internal(cells, u)
    assert smallest < 0.9  # far from rest
    assert (forces * toward).sum() == pytest.approx(slope, rel=1e-3)


def test_forces_grow_from_rest_as_its_stiffness_tells() -> None:
    """To the first order; at rest there are none."""
    cells, u = Cells.of(GRID, 0.4), some(1e-5)
    forces, _ = internal(cells, u)
    local = u.T[cells.nodes[:, : cells.own]].transpose(1, 0, 2).reshape(-1, 24)
    linear = np.zeros((len(GRID.nodes), 3))
    products = np.einsum("abm,mb->ma", cells.stiffness[:, :, : cells.own], local).reshape(-1, 8, 3)
    np.add.at(linear, cells.nodes[:, : cells.own].T, products)
    np.testing.assert_allclose(forces, linear.T, atol=2e-2 * np.abs(linear).max())
    at_rest, smallest = internal(cells, np.zeros_like(u))
    assert np.abs(at_rest).max() < 1e-7 and smallest == pytest.approx(1.0)


def test_a_turn_of_the_whole_costs_nothing_where_cells_are_full() -> None:
    rest = np.zeros((64, 64, 64), bool)
    rest[10:40, 20:44, :32] = True
    grid = CellGrid.fit(rest, 60)
    cells, angle = Cells.of(grid, 0.45), np.deg2rad(80.0)
    turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    u = (grid.node_positions @ (turn - np.eye(3)).T).T.astype(np.float32)
    forces, _ = internal(cells, u)
    assert np.abs(forces).max() < 1e-6


def test_a_uniform_stretch_has_the_stress_of_the_law() -> None:
    """P = μ (F − F⁻ᵀ) + λ ln J F⁻ᵀ, times the area, on each end of a block."""
    rest = np.zeros((64, 64, 64), bool)
    rest[16:48, 16:48, :32] = True
    grid = CellGrid.fit(rest, 64)
    cells, stretch = Cells.of(grid, 0.3), np.array([1.4, 0.8, 0.85])
    forces, smallest = internal(cells, (grid.node_positions * (stretch - 1.0)).T.astype(np.float32))
    ratio = stretch.prod()
    shear, bulk = 0.5 / 1.3, 0.3 / (1.3 * 0.4)
    stress = shear * (stretch - 1 / stretch) + bulk * np.log(ratio) / stretch
    assert smallest == pytest.approx(ratio, rel=1e-4)
    for axis in range(3):
        end = grid.nodes[:, axis] == grid.shape[axis]
        assert forces[axis, end].sum() == pytest.approx(stress[axis] * 0.25, rel=1e-3)


def test_a_cell_turned_inside_out_is_told() -> None:
    cells = Cells.of(GRID, 0.3)
    u = (GRID.node_positions * [-2.0, 0.0, 0.0]).T.astype(np.float32)
    _, smallest = internal(cells, u)
    assert smallest < 0.0
