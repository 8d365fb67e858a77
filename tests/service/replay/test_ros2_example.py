"""The ROS 2 example, as far as a machine without ROS can tell: it compiles, its parts name each other, and what it says
is held to ROS's own message definitions."""

from __future__ import annotations

import ast
import runpy
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rosbags", reason="ROS's message definitions need rosbags: pip install 'physnet[replay]'")

from rosbags.typesys import Stores, get_typestore

from tests.conftest import ROOT
from tests.service.client.answers import answer

PACKAGE = ROOT / "examples" / "ros2" / "physnet_ros2"
STORES = [Stores.ROS2_HUMBLE, Stores.ROS2_JAZZY]
SOURCES = sorted(PACKAGE.rglob("*.py"))


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: path.name)
def test_it_compiles(path: Path):
    compile(path.read_text("utf-8"), str(path), "exec")


def imports(path: Path) -> set[tuple[str, str]]:
    found = set()
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.ImportFrom):
            found |= {(str(node.module), alias.name) for alias in node.names}
    return found


def test_what_the_node_imports_is_there_and_declared():
    """Messages exist in every supported ROS 2, names of the client exist, and package.xml names each package."""
    declared = {node.text for node in ElementTree.parse(PACKAGE / "package.xml").getroot().iter("exec_depend")}
    for module, name in imports(PACKAGE / "physnet_ros2" / "node.py"):
        package = module.split(".")[0]
        if package == "service":
            assert hasattr(__import__(module, fromlist=[name]), name), f"{module}.{name}"
        elif module.endswith(".msg"):
            assert package in declared, package
            for store in STORES:
                assert f"{package}/msg/{name}" in get_typestore(store).types
        elif package not in ("__future__", "typing", "physnet_ros2"):
            assert package in declared, package


def test_the_parts_of_the_package_name_each_other():
    setup = (PACKAGE / "setup.py").read_text("utf-8")
    launch = (PACKAGE / "launch" / "physnet.launch.py").read_text("utf-8")
    root = ElementTree.parse(PACKAGE / "package.xml").getroot()
    assert root.findtext("name") == PACKAGE.name
    assert 'NAME = "physnet_ros2"' in setup and "physnet_node = {NAME}.node:main" in setup
    for name in ("launch/physnet.launch.py", "config/physnet.yaml", "resource/{NAME}"):
        assert name in setup
        assert (PACKAGE / name.format(NAME=PACKAGE.name)).exists()
    assert 'executable="physnet_node"' in launch
    node = (PACKAGE / "physnet_ros2" / "node.py").read_text("utf-8")
    for line in (PACKAGE / "config" / "physnet.yaml").read_text("utf-8").splitlines():
        if line.startswith("    ") and not line.strip().startswith("#"):
            assert f'declare_parameter("{line.strip().split(":")[0]}"' in node


@pytest.mark.parametrize("store", STORES, ids=lambda store: store.value)
def test_its_messages_are_ross(store, monkeypatch):
    types = get_typestore(store)
    kinds = {name.rpartition("/")[2]: name for name in types.types}
    empty_time = types.types["builtin_interfaces/msg/Time"](sec=3, nanosec=4)
    header = types.types["std_msgs/msg/Header"](stamp=empty_time, frame_id="camera")

    def made(kind: str, **fields: object) -> object:
        return types.types[kinds[kind]](**fields)

    def marker() -> object:
        """A Marker with every field at its default, as rclpy makes one; the type store knows no defaults."""
        vector, quaternion = (lambda kind: made(kind, **dict.fromkeys("xyz", 0.0))), made(
            "Quaternion", **dict.fromkeys("xyzw", 0.0))  # fmt: skip
        defaults: dict[str, object] = {
            "header": header, "ns": "", "id": 0, "type": 0, "action": 0, "text": "",
            "pose": made("Pose", position=vector("Point"), orientation=quaternion), "scale": vector("Vector3"),
            "color": made("ColorRGBA", r=0.0, g=0.0, b=0.0, a=0.0), "frame_locked": False,
            "lifetime": types.types["builtin_interfaces/msg/Duration"](sec=0, nanosec=0), "points": [], "colors": [],
            "mesh_resource": "", "mesh_use_embedded_materials": False, "texture_resource": "", "uv_coordinates": [],
            "texture": made("CompressedImage", header=header, format="", data=np.empty(0, np.uint8)),
            "mesh_file": made("MeshFile", filename="", data=np.empty(0, np.uint8)),
        }  # fmt: skip
        return made("Marker", **{name: defaults[name] for name, _ in types.fielddefs[kinds["Marker"]][1]})

    classes = {kind: types.types[kinds[kind]] for kind in ("PointCloud2", "PointField", "Point", "ColorRGBA")}
    classes["Marker"] = marker
    monkeypatch.setattr(sys, "path", [*sys.path, str(PACKAGE)])
    conversions = runpy.run_path(str(PACKAGE / "physnet_ros2" / "conversions.py"))
    result = answer()

    cloud = conversions["cloud_of"](result, header, classes, lambda raw: np.frombuffer(raw, np.uint8))
    read = types.deserialize_cdr(types.serialize_cdr(cloud, cloud.__msgtype__), cloud.__msgtype__)
    assert (read.header.frame_id, read.width) == ("camera", int(result.deformed.sum()))

    surface = conversions["marker_of"](result, header, classes)
    read = types.deserialize_cdr(types.serialize_cdr(surface, surface.__msgtype__), surface.__msgtype__)
    assert (read.type, read.pose.orientation.w, read.scale.x) == (11, 1.0, 1.0)
    corners = np.array([(point.x, point.y, point.z) for point in read.points])
    np.testing.assert_allclose(corners, result.mesh().vertices_m[result.mesh().faces.ravel()])

    assert conversions["material_of"]("silicone") == "silicone"
    assert conversions["material_of"]("1.2e5,0.45") == (1.2e5, 0.45)
