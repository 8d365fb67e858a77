"""Every kind of file is read again by somebody else's reader, and holds what was written."""

from __future__ import annotations

import io
import json
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import meshio
import numpy as np
import pygltflib
import pytest

from service.client.formats.binvox import encode_binvox
from service.client.formats.files import SUFFIXES, cells_along_camera
from service.client.formats.octomap import REACH, encode_octomap
from service.client.formats.png import encode_grey_png
from tests.conftest import ROOT
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


def volume_m3(points: np.ndarray, triangles: np.ndarray) -> float:
    """Of a closed surface, by the divergence theorem."""
    a, b, c = (points[triangles[:, corner]].astype(float) for corner in range(3))
    return float((a * np.cross(b, c)).sum() / 6.0)


def test_ply_is_the_surface_with_its_displacement(tmp_path):
    path = RESULT.save(tmp_path / "x.ply")
    mesh, read = RESULT.mesh(), meshio.read(path)
    np.testing.assert_array_equal(read.points, mesh.vertices_m)
    np.testing.assert_array_equal(read.cells_dict["triangle"], mesh.faces)
    assert volume_m3(read.points, mesh.faces) == pytest.approx(RESULT.deformed.sum() * PITCH_M**3, rel=0.04)
    moved = np.column_stack([read.point_data[name] for name in ("dx", "dy", "dz")])
    np.testing.assert_array_equal(moved, RESULT.displacement_at(mesh.vertices_m, "deformed").astype(np.float32))
    assert b"\ncomment metres, camera frame: x right, y down, z forward\n" in path.read_bytes()
    # Without a displacement there is none: the body before the push.
    before = meshio.read(RESULT.save(tmp_path / "y.ply", layer="reconstruction"))
    assert before.point_data == {}
    of_body_m3 = RESULT.reconstruction.sum() * PITCH_M**3
    assert volume_m3(before.points, before.cells_dict["triangle"]) == pytest.approx(of_body_m3, rel=0.04)


def test_glb_is_a_scene_of_both_surfaces(tmp_path):
    read = pygltflib.GLTF2().load(RESULT.save(tmp_path / "x.glb"))
    nodes = {node.name: node for node in read.nodes if node.mesh is not None}
    assert set(nodes) == {"reconstruction", "load 0", "load 1"}
    for name, layer in (("reconstruction", "reconstruction"), ("load 0", "deformed"), ("load 1", "deformed")):
        (primitive,), want = read.meshes[nodes[name].mesh].primitives, RESULT.mesh(layer)
        np.testing.assert_array_equal(accessor(read, primitive.attributes.POSITION), want.vertices_m)
        np.testing.assert_array_equal(accessor(read, primitive.indices).reshape(-1, 3), want.faces)
        normals = accessor(read, primitive.attributes.NORMAL)
        np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-4)
        material = read.materials[primitive.material]
        assert (material.name, material.alphaMode) == (
            ("before", "BLEND") if name == "reconstruction" else ("after", "OPAQUE")
        )
        # The format's own metal shows black where a viewer has no surroundings to mirror.
        assert material.pbrMetallicRoughness.metallicFactor == 0.0
        assert (nodes[name].translation, nodes[name].rotation, nodes[name].matrix) == (None, None, None)
    # What has moved farthest is yellow, and what has not dark.
    colours = accessor(read, read.meshes[nodes["load 0"].mesh].primitives[0].attributes.COLOR_0)[:, :3].astype(int)
    moved_m = np.linalg.norm(RESULT.displacement_at(RESULT.mesh().vertices_m, "deformed"), axis=1)
    assert colours[moved_m.argmax()].sum() > 300 > colours[moved_m.argmin()].sum()
    assert nodes["load 1"].extras["max_displacement_m"] == RESULT[1].max_displacement_m
    assert nodes["load 1"].extras["flags"] == ["contact_snapped"]
    assert read.scenes[0].extras["voxel_size_m"] == PITCH_M
    np.testing.assert_array_equal(read.scenes[0].extras["camera_from_grid"], GRID.camera_from_grid)


def accessor(read: pygltflib.GLTF2, number: int) -> np.ndarray:
    """An array of a file, one row an element."""
    described = read.accessors[number]
    view = read.bufferViews[described.bufferView]
    start = view.byteOffset + (described.byteOffset or 0)
    kind = {pygltflib.FLOAT: "<f4", pygltflib.UNSIGNED_BYTE: "u1", pygltflib.UNSIGNED_INT: "<u4"}
    columns = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[described.type]
    data = np.frombuffer(read.binary_blob(), kind[described.componentType], described.count * columns, start)
    return data.reshape(-1, columns)


def read_binvox(data: bytes) -> tuple[np.ndarray, dict[str, list[float]]]:
    """Voxels [x, y, z] and the numbers of the header, by the format's own page: y runs first, then z, then x."""
    head, _, runs = data.partition(b"data\n")
    assert head.startswith(b"#binvox 1\n")
    lines = [line.split() for line in head.decode().splitlines() if not line.startswith("#")]
    numbers = {name: [float(text) for text in texts] for name, *texts in lines}
    values, counts = np.frombuffer(runs, np.uint8).reshape(-1, 2).T
    assert counts.min() >= 1 and set(values) <= {0, 1}
    x, y, z = map(int, numbers["dim"])
    return np.repeat(values, counts).reshape(x, z, y).transpose(0, 2, 1).astype(bool), numbers


def test_binvox_is_the_same_voxels(tmp_path):
    voxels, numbers = read_binvox(RESULT.save(tmp_path / "x.binvox").read_bytes())
    np.testing.assert_array_equal(voxels, RESULT.deformed)
    assert numbers == {"dim": [64.0] * 3, "translate": [0.0] * 3, "scale": [GRID.edge_m]}


@pytest.mark.parametrize("longest", [254, 255, 256, 510])
def test_binvox_knows_no_run_longer_than_a_byte_says_and_none_of_nothing(longest):
    occupancy = np.zeros((16, 16, 16), bool)
    x, z, y = np.unravel_index(longest, (16, 16, 16))
    occupancy[x, y, z] = True
    voxels, numbers = read_binvox(encode_binvox(occupancy, 0.5, (1.0, 2.0, 3.0)))
    np.testing.assert_array_equal(voxels, occupancy)
    assert (numbers["translate"], numbers["scale"]) == ([1.0, 2.0, 3.0], [0.5])


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
    for beyond in (REACH, -REACH - 1):
        with pytest.raises(ValueError, match="reaches"):
            encode_octomap(np.array([[0, 0, 0], [0, beyond, 0]]), 0.01)


def test_a_body_that_was_pushed_out_of_its_grid_is_a_file_of_nothing(tmp_path):
    nothing = np.zeros((64, 64, 64), bool)
    gone = replace(RESULT[0], occupancy=nothing, displacement=None, max_displacement_m=0.0)
    result = replace(RESULT, pushes=(gone,))
    read = pygltflib.GLTF2().load(result.save(tmp_path / "x.glb"))
    assert {node.name: node.mesh for node in read.nodes}["load 0"] is None
    assert len(meshio.read(result.save(tmp_path / "x.ply")).points) == 0
    assert b"size 0" in result.save(tmp_path / "x.bt").read_bytes()
    assert not read_binvox(result.save(tmp_path / "x.binvox").read_bytes())[0].any()


def test_nobody_waits_for_the_writers_libraries_who_writes_no_file():
    """Neither a robot that imports the client nor a service that starts."""
    script = "import sys, service.client, service.client.formats.files, service.app; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", script], cwd=ROOT, check=True, capture_output=True, timeout=60)
    loaded = set(done.stdout.decode().split())
    assert "service.core.gltf" in loaded
    assert not loaded & {"trimesh", "octomap"}


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
