"""What ParaView opens, read back by another reader than the one that is tested: none of our code has a part in it."""

from __future__ import annotations

from pathlib import Path

import meshio
import numpy as np
import pytest

from tests.training.simulation.cases import LENGTH_M, OFFSET_M, RUBBER, WIDTH_M, bar_case
from training.simulation.solved_case import SolvedCase, solve_case
from training.simulation.vtu import write_vtu

WEIGHT_N = RUBBER.density_kg_m3 * 9.81 * LENGTH_M * WIDTH_M**2


@pytest.fixture(scope="module")
def solved() -> SolvedCase:
    return solve_case(bar_case(gravity_m_s2=np.array([0.0, 0.0, -9.81]), law="linear"))


@pytest.fixture
def mesh(solved: SolvedCase, tmp_path: Path) -> meshio.Mesh:
    write_vtu(solved, tmp_path / "case.vtu")
    return meshio.read(tmp_path / "case.vtu")


def test_its_cells_are_hexahedra_that_fill_the_body(mesh: meshio.Mesh) -> None:
    """Signed volumes from VTK's order of corners: mirrored or twisted cells would have another sign or size."""
    (block,) = mesh.cells
    assert block.type == "hexahedron"
    corners = mesh.points[block.data]
    edges = corners[:, [1, 3, 4]] - corners[:, [0]]
    volumes = np.linalg.det(edges)
    assert (volumes > 0).all()
    np.testing.assert_allclose(corners[:, 6] - corners[:, 0], edges.sum(axis=1), atol=1e-12)
    np.testing.assert_allclose(corners[:, 2] - corners[:, 0], edges[:, :2].sum(axis=1), atol=1e-12)
    assert (volumes * mesh.cell_data["fill"][0]).sum() == pytest.approx(LENGTH_M * WIDTH_M**2, rel=5e-3)
    np.testing.assert_allclose(mesh.points.min(axis=0), OFFSET_M, atol=1e-9)
    np.testing.assert_allclose(mesh.points.max(axis=0), OFFSET_M + np.array([LENGTH_M, WIDTH_M, WIDTH_M]), atol=1e-9)


def test_its_fields_are_those_of_the_case(mesh: meshio.Mesh, solved: SolvedCase) -> None:
    assert set(mesh.point_data) == {"displacement", "load", "reaction"}
    assert set(mesh.cell_data) == {"von_mises", "fill", "smallest_jacobian"}
    np.testing.assert_array_equal(mesh.point_data["displacement"], solved.displacement_m)
    # edges, rounded by the interpolation of distances, cost a few thousandths of the volume
    load_n = mesh.point_data["load"].sum(axis=0)
    np.testing.assert_allclose(load_n, [0, 0, -WEIGHT_N], atol=5e-3 * WEIGHT_N)
    np.testing.assert_allclose(mesh.point_data["reaction"].sum(axis=0), -load_n, atol=1e-9)
    tip = mesh.points[:, 0] > OFFSET_M[0] + 0.99 * LENGTH_M
    held = mesh.points[:, 0] < OFFSET_M[0] + 0.01 * LENGTH_M
    assert mesh.point_data["displacement"][tip, 2].max() < -1e-4
    assert np.abs(mesh.point_data["displacement"][held]).max() < 1e-6
