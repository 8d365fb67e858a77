"""Scenes are opened by a library that is not ours, and hold the bodies that the answer's grids hold."""

from __future__ import annotations

import io
import json
import struct
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from service.api.scene import displacement_at_surface, scene_glb
from service.core.grids import Grid
from service.core.materials import Material
from service.core.messages import DeformRequest, DeformResult, KnownShape, Load
from tests.poses import pose
from tests.service.fakes import fake_result

POSE = pose((0.4, -0.2, 0.9), (0.05, 0.02, 0.7))
PITCH_M = 0.2 / 64
LOADS = (Load(np.zeros(3), np.zeros(3)),) * 3


@pytest.fixture(scope="module")
def result() -> DeformResult:
    """A ball of 0.3 edges in the middle, moved by one, two and three voxels along x."""
    found = fake_result(DeformRequest(KnownShape(b"", 1.0, np.eye(4)), Material(1.0, 0.3), LOADS))
    return replace(found, grid=Grid(PITCH_M, POSE), reconstruction_id="abc")


@pytest.fixture(scope="module")
def scene(result: DeformResult):
    return trimesh.load_scene(io.BytesIO(scene_glb(result)), file_type="glb")


def middle_m(voxels_along_x: int = 0) -> np.ndarray:
    place = (np.array([32.0 + voxels_along_x, 32.0, 32.0]) * PITCH_M).tolist()
    return (POSE @ [*place, 1.0])[:3]


def test_nodes_are_named_and_lie_in_the_camera_frame_in_metres(scene):
    assert set(scene.graph.nodes_geometry) == {"reconstruction", "load 0", "load 1", "load 2"}
    for name, shift in (("reconstruction", 0), ("load 0", 1), ("load 2", 3)):
        transform, geometry = scene.graph[name]
        np.testing.assert_array_equal(transform, np.eye(4))
        mesh = scene.geometry[geometry]
        assert mesh.is_watertight and mesh.is_winding_consistent
        distances = np.linalg.norm(mesh.vertices - middle_m(shift), axis=1)
        np.testing.assert_allclose(distances, 0.3 * 0.2, atol=0.7 * PITCH_M)
        assert mesh.volume == pytest.approx(4 / 3 * np.pi * (0.3 * 0.2) ** 3, rel=0.03)
        outwards = (mesh.vertices - middle_m(shift)) / distances[:, None]
        assert (outwards * mesh.vertex_normals).sum(axis=1).min() > 0.9


def test_colours_tell_the_loads_apart(scene):
    """Every point of a load moved by as much as the other points: one third, two thirds and all of the largest."""
    means = []
    for number in range(3):
        colours = scene.geometry[scene.graph[f"load {number}"][1]].visual.vertex_attributes["color"]
        assert (colours[:, 3] == 255).all()
        assert (colours == colours[0]).all()
        means.append(colours[0, :3])
    # The end of viridis is yellow: red and green, no blue.
    assert means[2][0] > 200 and means[2][1] > 180 and means[2][2] < 40
    assert means[0][1] < means[1][1] < means[2][1]


def test_the_numbers_of_the_answer_are_beside_the_surfaces(result, scene):
    extras = document(scene_glb(result))["scenes"][0]["extras"]
    assert extras["reconstruction_id"] == "abc"
    assert extras["voxel_size_m"] == PITCH_M
    np.testing.assert_array_equal(extras["camera_from_grid"], POSE)
    (load,) = [node for node in document(scene_glb(result))["nodes"] if node["name"] == "load 1"]
    assert load["extras"]["max_displacement_m"] == 0.006
    assert load["extras"]["flags"] == ["contact_snapped"]


def document(glb: bytes) -> dict:
    """The JSON of a GLB, whose lengths and alignment are checked against the specification."""
    magic, version, length = struct.unpack_from("<4sII", glb)
    assert (magic, version, length) == (b"glTF", 2, len(glb))
    size, kind = struct.unpack_from("<I4s", glb, 12)
    assert kind == b"JSON" and size % 4 == 0
    found = json.loads(glb[20 : 20 + size])
    if 20 + size < len(glb):
        binary, kind = struct.unpack_from("<I4s", glb, 20 + size)
        assert kind == b"BIN\0" and 28 + size + binary == len(glb)
        assert found.get("buffers", [{"byteLength": 0}]) == [{"byteLength": binary}]
        assert all(view["byteOffset"] % 4 == 0 for view in found.get("bufferViews", []))
    return found


def test_a_body_that_was_pushed_out_of_its_grid_leaves_a_node_without_a_mesh(result):
    nothing = np.zeros((64, 64, 64), bool)
    gone = replace(result.loads[0], deformed=nothing, moved_m=np.zeros((3, 0), np.float32), max_displacement_m=0.0)
    found = document(scene_glb(replace(result, loads=(gone,))))
    (node,) = [node for node in found["nodes"] if node["name"] == "load 0"]
    assert "mesh" not in node
    empty = replace(result, loads=(gone,), reconstruction=gone.deformed)
    assert "meshes" not in document(scene_glb(empty))


def test_displacement_at_the_surface_is_that_of_the_voxel_behind_it(result):
    load = result.loads[1]
    vertices = np.array([middle_m(), POSE[:3, 3]], np.float32)
    np.testing.assert_allclose(displacement_at_surface(load, result.grid, vertices), [0.006, 0.0], atol=1e-6)
