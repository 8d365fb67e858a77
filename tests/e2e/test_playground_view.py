"""What the playground draws, and what of it is saved."""

from __future__ import annotations

import io
import re
from pathlib import Path

import numpy as np
import pygltflib
import pytest

from tests.e2e.playground import Visit, needs_chromium

pytestmark = needs_chromium


def test_the_view_shows_layers_colours_and_a_cut(mug: Visit):
    page = mug.page

    def picture() -> bytes:
        drawn = int(page.get_attribute("#view", "data-drawn") or 0)
        page.wait_for_timeout(400)
        mug.until(f"Number(document.querySelector('#view').dataset.drawn) >= {drawn}")
        return page.locator("#view").screenshot()

    pictures = [picture()]
    page.uncheck("#layers [value=observed]")
    page.uncheck("#layers [value=reconstructed]")
    pictures.append(picture())
    page.check("#colouring [value=uncertainty]")
    assert "lie off by" in page.inner_text("#legend")
    pictures.append(picture())
    page.check("#cut [value='0']")
    page.locator("#cut-at").fill("55")
    pictures.append(picture())
    assert len(set(pictures)) == 4
    page.check("#colouring [value=displacement]")
    page.check("#cut [value='']")
    assert re.search(r"0\s.*mm", page.inner_text("#legend"), re.S)
    page.check("#layers [value=observed]")
    page.check("#layers [value=reconstructed]")


def test_the_result_is_saved_as_three_kinds_of_files(mug: Visit):
    def saved(kind: str) -> bytes:
        with mug.page.expect_download() as download:
            mug.page.click(f"#save [data-kind={kind}]")
        assert download.value.suggested_filename == f"physnet-mug.{kind}"
        return Path(download.value.path()).read_bytes()

    archive = np.load(io.BytesIO(saved("npz")))
    assert archive["deformed"].shape == (1, 64, 64, 64)
    assert archive["deformed"].sum() > 1000
    filled = np.argwhere(archive["reconstruction"]) * archive["voxel_size_m"]
    extent_m = float(filled.max(0)[2] - filled.min(0)[2])

    head, _, body = saved("ply").partition(b"end_header\n")
    vertices, faces = (int(re.search(rf"element {what} (\d+)".encode(), head)[1]) for what in ("vertex", "face"))
    assert len(body) == 35 * vertices + 13 * faces
    record = np.dtype([("place", "<f4", 3), ("normal", "<f4", 3), ("colour", "u1", 3), ("known", "<f4", 2)])
    points = np.frombuffer(body, record, vertices)
    # In the camera's frame: the mug stands between 0.4 and 0.6 m away.
    assert 0.35 < points["place"][:, 2].min() < points["place"][:, 2].max() < 0.7
    triangles = np.frombuffer(body, np.dtype([("n", "u1"), ("at", "<i4", 3)]), faces, 35 * vertices)["at"]
    edges = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    assert (np.unique(edges, axis=0, return_counts=True)[1] % 2 == 0).all(), "the surface is not closed"
    a, b, c = (points["place"][triangles[:, corner]].astype(float) for corner in range(3))
    volume_m3 = float((a * np.cross(b, c)).sum() / 6.0)
    assert volume_m3 == pytest.approx(archive["deformed"].sum() * float(archive["voxel_size_m"]) ** 3, rel=0.2)
    np.testing.assert_allclose(np.linalg.norm(points["normal"], axis=1), 1.0, atol=1e-3)
    assert re.findall(rb"property float (displacement|uncertainty)", head) == [b"displacement", b"uncertainty"]
    displacement_m = points["known"][:, 0]
    assert 1e3 * displacement_m.max() == pytest.approx(mug.peak_mm(), rel=0.1)
    assert re.findall(rb"property uchar (\w+)", head) == [b"red", b"green", b"blue"]
    # What has moved least has the first colour of the scale.
    assert points["colour"][displacement_m.argmin()].tolist() == [0xB4, 0xBD, 0xC5]

    scene = pygltflib.GLTF2.load_from_bytes(saved("glb"))
    assert [node.name for node in scene.nodes] == ["reconstruction", "deformed"]
    # The archive is asked for anew, at a contact that may have moved since the body on the page was found.
    assert scene.scenes[0].extras["voxel_size_m"] == pytest.approx(float(archive["voxel_size_m"]), rel=0.01)
    rest, deformed = ([scene.accessors[n] for n in (mesh.primitives[0].attributes.POSITION, mesh.primitives[0].indices)]
                      for mesh in scene.meshes)  # fmt: skip
    assert rest[0].max[1] - rest[0].min[1] == pytest.approx(extent_m, abs=3 * float(archive["voxel_size_m"]))
    assert (deformed[0].count, deformed[1].count) == (vertices, 3 * faces)
    moved = scene.accessors[scene.meshes[1].primitives[0].attributes._DISPLACEMENT]
    view = scene.bufferViews[moved.bufferView]
    read = np.frombuffer(scene.binary_blob(), "<f4", moved.count, view.byteOffset)
    np.testing.assert_array_equal(read, displacement_m)
