"""Mesh files as bodies: distances against the true ones, and every kind of file that gives no body."""

from __future__ import annotations

import math
import os
from pathlib import Path

import numpy as np
import pytest
import trimesh

from training.simulation.mesh import EmptyMesh, MeshError, NotWatertight, load_mesh, mesh_shape
from training.simulation.shapes import tight_bounds, voxelize

SHARED = Path(os.environ.get("PHYSNET_SHARED", Path(__file__).resolve().parents[4] / "shared"))
SCANS = SHARED / "data" / "real" / "meshes"


def write(tmp_path: Path, mesh: trimesh.Trimesh, name: str = "body.ply") -> Path:
    path = tmp_path / name
    if path.suffix == ".gltf":  # several files; trimesh's own export to a path leaves them open
        for part, data in trimesh.exchange.gltf.export_gltf(trimesh.Scene(mesh)).items():
            (tmp_path / (name if part.endswith(".gltf") else part)).write_bytes(data)
    else:
        mesh.export(path)
    return path


def ball(radius: float = 0.1) -> trimesh.Trimesh:
    return trimesh.creation.icosphere(subdivisions=4, radius=radius)


def test_a_box_has_its_corners_volume_and_size(tmp_path: Path) -> None:
    path = write(tmp_path, trimesh.creation.box((0.2, 0.1, 0.06)))
    shape = mesh_shape(path)
    assert shape.family == "body"
    np.testing.assert_allclose(tight_bounds(shape), [[-0.1, 0.1], [-0.05, 0.05], [0, 0.06]], atol=5e-4)
    occupancy, pitch, _ = voxelize(shape, 64)
    assert occupancy.sum() * pitch**3 == pytest.approx(0.2 * 0.1 * 0.06, rel=0.02)


@pytest.mark.parametrize("suffix", [".obj", ".stl", ".ply", ".glb", ".gltf", ".off"])
def test_formats_and_units(tmp_path: Path, suffix: str) -> None:
    body = trimesh.creation.cylinder(radius=30, height=80)
    shape = mesh_shape(write(tmp_path, body, f"can{suffix}"), unit_m=0.001)
    box = tight_bounds(shape)
    np.testing.assert_allclose(box[:, 1] - box[:, 0], [0.06, 0.06, 0.08], rtol=0.01)


@pytest.mark.parametrize(("up_axis", "height"), [("x", 0.3), ("y", 0.2), ("z", 0.1)])
def test_up_axis_becomes_z(tmp_path: Path, up_axis: str, height: float) -> None:
    shape = mesh_shape(write(tmp_path, trimesh.creation.box((0.3, 0.2, 0.1))), up_axis=up_axis)  # type: ignore[arg-type]
    assert tight_bounds(shape)[2, 1] == pytest.approx(height, rel=0.01)


def test_up_axis_keeps_the_hand(tmp_path: Path) -> None:
    """A marker at +z stands, with y up, at +x of the body; a mirrored body would have it at −x."""
    body = trimesh.util.concatenate(
        [
            trimesh.creation.box((0.1, 0.1, 0.1)),
            trimesh.creation.box((0.02, 0.02, 0.1)).apply_translation((0.0, 0.0, 0.08)),
            trimesh.creation.box((0.1, 0.02, 0.02)).apply_translation((0.08, 0.03, 0.0)),
        ]
    )
    shape = mesh_shape(write(tmp_path, body), up_axis="y")
    # (x, y, z) → (z, x, y): the rod along z now along x, the one along x now along y, at height 0.05 + 0.03.
    x0, y0 = tight_bounds(shape)[:2, 0] + 0.05
    rods = np.array(
        [[x0 + 0.1, y0, 0.05], [x0, y0 + 0.1, 0.08], [x0 - 0.08, y0, 0.05], [x0, y0 + 0.1, 0.02]], np.float32
    )
    assert (shape.distance(rods) < 0).tolist() == [True, True, False, False]


def test_an_inside_out_mesh_is_turned_with_a_warning(tmp_path: Path) -> None:
    body = ball()
    body.invert()
    path = write(tmp_path, body)
    with pytest.warns(UserWarning, match=r"body\.ply is inside out"):
        assert load_mesh(path).volume > 0
    with pytest.warns(UserWarning, match="inside out"):
        shape = mesh_shape(path, resolution=32)
    assert shape.distance(np.array([[0, 0, 0.1]], np.float32))[0] < -0.08


def test_a_mesh_with_some_faces_flipped_is_mended(tmp_path: Path) -> None:
    body = ball()
    faces = body.faces.copy()
    faces[::3] = faces[::3, ::-1]
    path = write(tmp_path, trimesh.Trimesh(body.vertices, faces, process=False))
    assert load_mesh(path).volume == pytest.approx(4 / 3 * math.pi * 1e-3, rel=0.01)


def test_repeated_vertices_are_merged(tmp_path: Path) -> None:
    """As STL writes them: three of its own for every face."""
    body = ball()
    soup = trimesh.Trimesh(body.triangles.reshape(-1, 3), np.arange(3 * len(body.faces)).reshape(-1, 3), process=False)
    assert len(load_mesh(write(tmp_path, soup)).vertices) == len(body.vertices)


def test_overlapping_parts_are_their_union(tmp_path: Path) -> None:
    left, right = trimesh.creation.box((0.1, 0.1, 0.1)), trimesh.creation.box((0.1, 0.1, 0.1))
    right.apply_translation((0.05, 0.02, 0.01))
    shape = mesh_shape(write(tmp_path, trimesh.util.concatenate(left, right)), resolution=48)
    overlap = np.array([[0.0, 0.0, 0.05]], np.float32)
    assert shape.distance(overlap)[0] < 0


def test_a_hole_is_reported_with_its_edges(tmp_path: Path) -> None:
    body = trimesh.creation.box((0.1, 0.1, 0.1))
    open_box = trimesh.Trimesh(body.vertices, body.faces[:-1], process=False)
    with pytest.raises(NotWatertight, match="3 of 18 edges are open") as caught:
        mesh_shape(write(tmp_path, open_box))
    assert caught.value.open_edges == 3


def test_no_triangles(tmp_path: Path) -> None:
    path = tmp_path / "empty.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\n")
    with pytest.raises(EmptyMesh):
        mesh_shape(path)


def test_triangles_without_extent(tmp_path: Path) -> None:
    path = tmp_path / "point.obj"
    path.write_text("v 1 1 1\nv 1 1 1\nv 1 1 1\nf 1 2 3\n")
    with pytest.raises(EmptyMesh):
        mesh_shape(path)


def test_a_file_that_is_no_mesh(tmp_path: Path) -> None:
    path = tmp_path / "broken.ply"
    path.write_bytes(b"ply\nnot a mesh at all")
    with pytest.raises(MeshError, match=r"broken\.ply"):
        mesh_shape(path)


def test_a_missing_file() -> None:
    with pytest.raises(FileNotFoundError, match=r"nowhere\.obj"):
        mesh_shape("nowhere.obj")


def test_millimetres_taken_for_metres_are_warned_of(tmp_path: Path) -> None:
    path = write(tmp_path, trimesh.creation.box((200, 100, 60)))
    with pytest.warns(UserWarning, match=r"200 m long: .*0\.001 for millimetres"):
        mesh_shape(path, resolution=16)


def test_metres_taken_for_millimetres_are_warned_of(tmp_path: Path) -> None:
    path = write(tmp_path, trimesh.creation.box((0.2, 0.1, 0.06)))
    with pytest.warns(UserWarning, match=r"0\.0002 m long: is its unit 0\.001 m"):
        mesh_shape(path, unit_m=0.001, resolution=16)


@pytest.mark.skipif(not SCANS.is_dir(), reason=f"the scanned meshes are not at {SCANS}; set PHYSNET_SHARED")
@pytest.mark.parametrize("name", ["scan_soap", "ycb_025_mug", "spot"])
def test_scanned_objects_keep_their_volume(name: str) -> None:
    path = SCANS / f"{name}.obj"
    shape = mesh_shape(path)
    occupancy, pitch, _ = voxelize(shape, 180)
    # The mug's wall is two cells of the distance grid: its rim and floor lose 3 % to interpolation.
    assert occupancy.sum() * pitch**3 == pytest.approx(load_mesh(path).volume, rel=0.035 if "mug" in name else 0.01)
