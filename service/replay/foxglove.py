"""Answers as MCAP with Foxglove's schemas: a file that Foxglove opens as it is.

| topic | schema | what |
|---|---|---|
| `/physnet/deformed` | foxglove.VoxelGrid | the deformed body, coloured by displacement, where its grid sits |
| `/physnet/points` | foxglove.PointCloud | centres of its voxels with `displacement` in metres |
| `/physnet/scene` | foxglove.SceneUpdate | surfaces before (clear) and after the push, and the force as an arrow |
| `/physnet/answer` | JSON | largest displacement, flags and timings, to plot |

Everything stands in the frame of the camera that took the image, at the time that it was taken.
"""

from __future__ import annotations

import json
from pathlib import Path
from types import TracebackType

import numpy as np
from foxglove_schemas_protobuf.ArrowPrimitive_pb2 import ArrowPrimitive
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.Point3_pb2 import Point3
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.TriangleListPrimitive_pb2 import TriangleListPrimitive
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from foxglove_schemas_protobuf.VoxelGrid_pb2 import VoxelGrid
from google.protobuf.message import Message
from google.protobuf.timestamp_pb2 import Timestamp
from mcap.writer import CompressionType, Writer
from mcap_protobuf.schema import register_schema

from service.client.result import Mesh, Result
from service.client.ros import voxel_displacements_m
from service.core.arrays import GRID_SIZE, Matrix3
from service.core.colours import colours_of
from service.replay.force import Force
from service.replay.frames import RecordedFrame

TOPICS = {
    "/physnet/deformed": VoxelGrid,
    "/physnet/points": PointCloud,
    "/physnet/scene": SceneUpdate,
}
ANSWER_TOPIC = "/physnet/answer"

ARROW_M_PER_N = 0.01
"""Length of the force's arrow: 10 N are 10 cm."""

_ANSWER_SCHEMA = {
    "type": "object",
    "title": "physnet.Answer",
    "properties": {
        "max_displacement_m": {"type": "number"},
        "mean_displacement_m": {"type": "number"},
        "load_number": {"type": "number"},
        "round_trip_ms": {"type": "number"},
        "flags": {"type": "array", "items": {"type": "string"}},
        "timing_ms": {"type": "object", "additionalProperties": {"type": "number"}},
    },
}
_FIELD = PackedElementField


class FoxgloveWriter:
    """Writes answers to an MCAP file; a context manager, whose end writes the index."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("wb")
        self._writer = Writer(self._file, chunk_size=4 * 2**20, compression=CompressionType.ZSTD)
        self._writer.start(profile="", library="physnet replay")
        self._channels = {
            topic: self._writer.register_channel(topic, "protobuf", register_schema(self._writer, schema))
            for topic, schema in TOPICS.items()
        }
        answer = self._writer.register_schema("physnet.Answer", "jsonschema", json.dumps(_ANSWER_SCHEMA).encode())
        self._channels[ANSWER_TOPIC] = self._writer.register_channel(ANSWER_TOPIC, "json", answer)

    def write(
        self, frame: RecordedFrame, result: Result, round_trip_ms: float, force: Force | None = None
    ) -> None:
        """One answer.

        Args:
            frame: What it is about.
            result: The answer; its first push is shown.
            round_trip_ms: How long it took.
            force: What was pushed where, for the arrow.
        """
        stamp = Timestamp(seconds=frame.stamp_ns // 10**9, nanos=frame.stamp_ns % 10**9)
        self._add("/physnet/deformed", frame, voxel_grid(result, stamp, frame.frame_id))
        self._add("/physnet/points", frame, point_cloud(result, stamp, frame.frame_id))
        self._add("/physnet/scene", frame, scene(result, stamp, frame.frame_id, force))
        push = result[0]
        answer = {
            "max_displacement_m": push.max_displacement_m,
            "mean_displacement_m": push.mean_displacement_m,
            "load_number": push.load_number,
            "round_trip_ms": round_trip_ms,
            "flags": sorted(result.flags | push.flags),
            "timing_ms": result.timing_ms,
        }
        self._add_bytes(ANSWER_TOPIC, frame, json.dumps(answer).encode())

    def _add(self, topic: str, frame: RecordedFrame, message: Message) -> None:
        self._add_bytes(topic, frame, message.SerializeToString())

    def _add_bytes(self, topic: str, frame: RecordedFrame, data: bytes) -> None:
        # The recording's own time, so that both files play side by side.
        self._writer.add_message(self._channels[topic], frame.time_ns, data, frame.stamp_ns)

    def close(self) -> None:
        """Write the index and close."""
        self._writer.finish()  # type: ignore[no-untyped-call]  # mcap's own
        self._file.close()

    def __enter__(self) -> FoxgloveWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def voxel_grid(result: Result, stamp: Timestamp, frame_id: str) -> VoxelGrid:
    """The deformed body as cells of red, green, blue and alpha, alpha 0 where it is not."""
    deformed = result.deformed
    cells = np.zeros((GRID_SIZE,) * 3 + (4,), np.uint8)
    cells[deformed] = np.hstack([_colours(result), np.full((int(deformed.sum()), 1), 255, np.uint8)])
    pitch_m = result.grid.pitch_m
    return VoxelGrid(
        timestamp=stamp,
        frame_id=frame_id,
        pose=_pose(result.grid.camera_from_grid[:3, 3], result.grid.camera_from_grid[:3, :3]),
        row_count=GRID_SIZE,
        column_count=GRID_SIZE,
        cell_size=Vector3(x=pitch_m, y=pitch_m, z=pitch_m),
        slice_stride=4 * GRID_SIZE**2,
        row_stride=4 * GRID_SIZE,
        cell_stride=4,
        fields=[
            _FIELD(name=name, offset=place, type=_FIELD.UINT8)
            for place, name in enumerate(("red", "green", "blue", "alpha"))
        ],
        # Foxglove's order is z, y, x; ours x, y, z.
        data=np.ascontiguousarray(cells.transpose(2, 1, 0, 3)).tobytes(),
    )


def point_cloud(result: Result, stamp: Timestamp, frame_id: str) -> PointCloud:
    """Centres of the deformed body's voxels, with how far their material has come."""
    rows = np.hstack([result.points_camera(), voxel_displacements_m(result)[:, None]]).astype("<f4")
    return PointCloud(
        timestamp=stamp,
        frame_id=frame_id,
        pose=_pose(np.zeros(3), np.eye(3)),
        point_stride=16,
        fields=[
            _FIELD(name=name, offset=4 * place, type=_FIELD.FLOAT32)
            for place, name in enumerate(("x", "y", "z", "displacement"))
        ],
        data=rows.tobytes(),
    )


def scene(result: Result, stamp: Timestamp, frame_id: str, force: Force | None) -> SceneUpdate:
    """Surfaces before and after the push, and the arrow of the force."""
    after = result.mesh("deformed")
    moved_m = np.linalg.norm(result.displacement_at(after.vertices_m, "deformed"), axis=1)
    rgb = colours_of(moved_m, result.max_displacement_m)
    entity = SceneEntity(timestamp=stamp, frame_id=frame_id, id="body")
    entity.triangles.append(_triangles(after, [Color(r=r, g=g, b=b, a=1.0) for r, g, b in (rgb / 255.0).tolist()]))
    before = _triangles(result.mesh("reconstruction"), [])
    before.color.CopyFrom(Color(r=0.7, g=0.7, b=0.7, a=0.25))
    entity.triangles.append(before)
    if force is not None and np.any(force.force_n):
        entity.arrows.append(_arrow(force.contact_m, force.force_n))
    return SceneUpdate(entities=[entity])


def _triangles(mesh: Mesh, colours: list[Color]) -> TriangleListPrimitive:
    return TriangleListPrimitive(
        pose=_pose(np.zeros(3), np.eye(3)),
        points=[Point3(x=x, y=y, z=z) for x, y, z in mesh.vertices_m.tolist()],
        colors=colours,
        indices=mesh.faces.ravel().tolist(),
    )


def _arrow(contact_m: np.ndarray, force_n: np.ndarray) -> ArrowPrimitive:
    """An arrow whose head ends at the contact. Foxglove's arrows run along the x axis of their pose."""
    length_m = float(np.linalg.norm(force_n)) * ARROW_M_PER_N
    along = force_n / np.linalg.norm(force_n)
    beside = np.cross(along, np.eye(3)[np.abs(along).argmin()])
    beside /= np.linalg.norm(beside)
    rotation = np.column_stack([along, beside, np.cross(along, beside)])
    return ArrowPrimitive(
        pose=_pose(contact_m - length_m * along, rotation),
        shaft_length=0.75 * length_m,
        shaft_diameter=0.06 * length_m,
        head_length=0.25 * length_m,
        head_diameter=0.14 * length_m,
        color=Color(r=0.9, g=0.2, b=0.15, a=1.0),
    )


def _colours(result: Result) -> np.ndarray:
    return colours_of(voxel_displacements_m(result), result.max_displacement_m)


def _pose(position_m: np.ndarray, rotation: Matrix3) -> Pose:
    x, y, z = (float(number) for number in position_m)
    qx, qy, qz, qw = quaternion_of(rotation)
    return Pose(position=Vector3(x=x, y=y, z=z), orientation=Quaternion(x=qx, y=qy, z=qz, w=qw))


def quaternion_of(rotation: Matrix3) -> tuple[float, float, float, float]:
    """Unit quaternion (x, y, z, w) of a rotation matrix, with w ≥ 0.

    The eigenvector of the largest eigenvalue of a symmetric matrix: no cases, no loss where an element is small.

    Source: Bar-Itzhack, New method for extracting the quaternion from a rotation matrix, J. Guidance 23 (2000) 1085.
    """
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = rotation
    k = np.array(
        [
            [xx - yy - zz, yx + xy, zx + xz, zy - yz],
            [yx + xy, yy - xx - zz, zy + yz, xz - zx],
            [zx + xz, zy + yz, zz - xx - yy, yx - xy],
            [zy - yz, xz - zx, yx - xy, xx + yy + zz],
        ]
    )
    x, y, z, w = np.linalg.eigh(k)[1][:, -1]
    sign = -1.0 if w < 0.0 else 1.0
    return float(sign * x), float(sign * y), float(sign * z), float(sign * w)
