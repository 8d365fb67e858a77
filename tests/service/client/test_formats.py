"""Every kind of file is read again by somebody else's reader, and holds what was written."""

from __future__ import annotations

import io
import json
import re
import shutil
import struct
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh

from service.client.formats.files import SUFFIXES, cells_along_camera
from service.client.formats.octomap import CENTRE_KEY, encode_octomap
from service.client.formats.png import encode_grey_png
from tests.service.client.answers import GRID, PITCH_M, answer, in_camera

RESULT = answer(loads=2)


def test_npz_holds_everything(tmp_path):
    with np.load(RESULT.save(tmp_path / "x.npz"), allow_pickle=False) as archive:
        assert float(archive["voxel_size_m"]) == PITCH_M
        np.testing.assert_array_equal(archive["camera_from_grid"], GRID.camera_from_grid)
        np.testing.assert_array_equal(archive["observed"], RESULT.observed)
        np.testing.assert_array_equal(archive["reconstruction"], RESULT.reconstruction)
        np.testing.assert_array_equal(archive["deformed"], [push.deformed for push in RESULT])
        np.testing.assert_array_equal(archive["displacement_m"], [push.displacement_m for push in RESULT])
        np.testing.assert_array_equal(archive["max_displacement_m"], [push.max_displacement_m for push in RESULT])
        assert archive["probability"].dtype == np.float16
        meta = json.loads(str(archive["meta"]))
    assert meta["model"] == {"name": "hand", "version": "1"}
    assert meta["load_flags"] == [["contact_snapped"]] * 2


def test_npz_has_the_layout_of_the_services_own():
    from service.api.replies import reply_npz
    from service.client.formats.files import npz
    from service.core.materials import Material
    from service.core.messages import DeformRequest, KnownShape, Load
    from tests.service.fakes import fake_result

    request = DeformRequest(KnownShape(b"", 1.0, np.eye(4)), Material(1e5, 0.3), (Load(np.ones(3)),))
    outputs = frozenset({"reconstruction", "deformed", "probability", "displacement"})
    with (
        np.load(io.BytesIO(reply_npz(fake_result(request), outputs, "id", {}))) as theirs,
        np.load(io.BytesIO(npz(answer()))) as ours,
    ):
        assert set(ours) == set(theirs) | {"observed"}
        for name in theirs:
            assert (ours[name].dtype.kind, ours[name].shape[1:]) == (theirs[name].dtype.kind, theirs[name].shape[1:])
        # An id of the service is of this run of it alone; all else that it says of itself is there.
        assert set(json.loads(str(theirs["meta"]))) - {"reconstruction_id"} == set(json.loads(str(ours["meta"])))


def test_ply_is_the_surface_with_its_displacement(tmp_path):
    path = RESULT.save(tmp_path / "x.ply")
    mesh, read = RESULT.mesh(), trimesh.load(path, process=False)
    np.testing.assert_array_equal(read.vertices, mesh.vertices_m)
    np.testing.assert_array_equal(read.faces, mesh.faces)
    assert read.volume == pytest.approx(RESULT.deformed.sum() * PITCH_M**3, rel=0.04)
    vertices = read.metadata["_ply_raw"]["vertex"]["data"]
    moved = np.column_stack([vertices[name] for name in ("dx", "dy", "dz")])
    np.testing.assert_allclose(moved, RESULT.displacement_at(mesh.vertices_m, "deformed"), atol=1e-7)
    # Without a displacement there is none: the body before the push.
    before = trimesh.load(RESULT.save(tmp_path / "y.ply", layer="reconstruction"), process=False)
    assert before.volume == pytest.approx(RESULT.reconstruction.sum() * PITCH_M**3, rel=0.04)


def test_glb_is_a_scene_of_both_surfaces(tmp_path):
    scene = trimesh.load(RESULT.save(tmp_path / "x.glb"), process=False)
    assert set(scene.geometry) == {"reconstruction", "load 0", "load 1"}
    for name, layer in (("reconstruction", "reconstruction"), ("load 0", "deformed"), ("load 1", "deformed")):
        mesh, want = scene.geometry[name], RESULT.mesh(layer)
        np.testing.assert_array_equal(mesh.vertices, want.vertices_m)
        np.testing.assert_array_equal(mesh.faces, want.faces)
    # What has moved farthest is yellow, and what has not dark.
    colours = accessor((tmp_path / "x.glb").read_bytes(), "load 0", "COLOR_0", np.uint8, 4)[:, :3].astype(int)
    moved_m = np.linalg.norm(RESULT.displacement_at(RESULT.mesh().vertices_m, "deformed"), axis=1)
    assert colours[moved_m.argmax()].sum() > 300 > colours[moved_m.argmin()].sum()


def accessor(glb: bytes, mesh: str, name: str, kind: type, components: int) -> np.ndarray:
    """An attribute of a mesh, by the document alone."""
    (length,) = struct.unpack_from("<I", glb, 12)
    document, binary = json.loads(glb[20 : 20 + length]), glb[28 + length :]
    (found,) = [one for one in document["meshes"] if one["name"] == mesh]
    described = document["accessors"][found["primitives"][0]["attributes"][name]]
    view = document["bufferViews"][described["bufferView"]]
    data = binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]
    return np.frombuffer(data, kind).reshape(described["count"], components)


def test_binvox_is_the_same_voxels(tmp_path):
    with RESULT.save(tmp_path / "x.binvox").open("rb") as file:
        grid = trimesh.exchange.binvox.load_binvox(file)
    np.testing.assert_array_equal(grid.matrix, RESULT.deformed)
    # trimesh puts the centres of the first and last voxels onto the corners of the cube, which binvox does not.
    text = (tmp_path / "x.binvox").read_bytes().split(b"data\n")[0].decode()
    assert "dim 64 64 64" in text
    assert float(re.search(r"scale (\S+)", text).group(1)) == GRID.edge_m


def octomap_leaves(path: Path) -> np.ndarray:
    """Occupied cells (n × 3 centres and edge, metres) as OctoMap's own program reads them."""
    program = shutil.which("bt2vrml", path=str(Path(sys.executable).parent))
    if program is None:
        pytest.skip("OctoMap's own programs are not installed: pip install cmeel-octomap")
    # By Python itself: the first line of an installed program cannot name a path with a space in it.
    subprocess.run([sys.executable, program, str(path)], check=True, capture_output=True, timeout=60)
    text = Path(f"{path}.wrl").read_text()
    number = r"(-?[\d.e+-]+)"
    found = re.findall(rf"translation {number} {number} {number}.*?size {number} {number} {number}", text, re.S)
    return np.array(found, np.float64)[:, :4]


def test_octomap_reads_the_same_cells(tmp_path):
    """Whole blocks are one leaf of the tree; taken apart again they are the cells that went in."""
    cells = np.argwhere(RESULT.deformed) - (30, 10, 50)
    (tmp_path / "x.bt").write_bytes(encode_octomap(cells, PITCH_M))
    leaves = octomap_leaves(tmp_path / "x.bt")
    assert len(leaves) < len(cells)
    found = set()
    for x, y, z, edge in leaves:
        steps = np.arange(round(edge / PITCH_M)) + 0.5
        low = np.array([x, y, z]) / PITCH_M - 0.5 * len(steps)
        for i in steps:
            for j in steps:
                found |= {(round(low[0] + i - 0.5), round(low[1] + j - 0.5), round(low[2] + k - 0.5)) for k in steps}
    assert found == set(map(tuple, cells.tolist()))


def test_octomap_of_a_result_stands_in_the_camera_frame(tmp_path):
    leaves = octomap_leaves(RESULT.save(tmp_path / "x.bt"))
    volume_m3 = (leaves[:, 3] ** 3).sum()
    assert volume_m3 == pytest.approx(RESULT.deformed.sum() * PITCH_M**3, rel=0.02)
    centre = (leaves[:, :3] * leaves[:, 3:] ** 3).sum(0) / volume_m3
    np.testing.assert_allclose(centre, RESULT.points_camera().mean(0), atol=0.1 * PITCH_M)


def test_cells_along_the_camera_are_those_whose_centres_are_in_the_body():
    cells = cells_along_camera(RESULT.deformed, GRID)
    axes = [np.arange(low - 2, high + 3) for low, high in zip(cells.min(0), cells.max(0), strict=True)]
    everywhere = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    centres_m = (everywhere + 0.5) * PITCH_M
    voxels = np.floor((centres_m - GRID.camera_from_grid[:3, 3]) @ GRID.camera_from_grid[:3, :3] / PITCH_M).astype(int)
    inside = ((voxels >= 0) & (voxels < 64)).all(1)
    inside[inside] = RESULT.deformed[tuple(voxels[inside].T)]
    assert set(map(tuple, cells.tolist())) == set(map(tuple, everywhere[inside].tolist()))
    assert in_camera(np.zeros((1, 3))).shape == (1, 3)


def test_an_octomap_of_nothing_and_one_that_reaches_too_far():
    assert b"size 0" in encode_octomap(np.empty((0, 3), np.int64), 0.01)
    with pytest.raises(ValueError, match="reaches"):
        encode_octomap(np.array([[CENTRE_KEY, 0, 0]]), 0.01)


def test_a_suffix_that_nobody_knows_is_refused_with_those_that_are(tmp_path):
    with pytest.raises(ValueError, match=r"\.glb.*\.bt"):
        RESULT.save(tmp_path / "x.stl")
    assert list(tmp_path.iterdir()) == []
    assert {".npz", ".ply", ".glb", ".bt", ".binvox"} == set(SUFFIXES)


@pytest.mark.parametrize("shape", [(1, 1), (3, 5), (48, 64)])
def test_a_png_is_read_again(shape):
    image = np.random.default_rng(1).integers(0, 256, shape).astype(np.uint8)
    read = cv2.imdecode(np.frombuffer(encode_grey_png(image), np.uint8), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(read, image)
