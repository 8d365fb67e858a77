"""A robot's side of gRPC: requests written as JSON are sent as messages, and responses read as JSON documents."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from typing import Any

import grpc
from google.protobuf.json_format import MessageToDict
from grpc_status import rpc_status

from service.api.generated import deformation_pb2 as pb
from service.api.generated.deformation_pb2_grpc import DeformationServiceStub

LIMITS = [("grpc.max_receive_message_length", -1), ("grpc.max_send_message_length", -1)]

_ENCODINGS = {
    "png16": pb.DEPTH_ENCODING_PNG16,
    "npy": pb.DEPTH_ENCODING_NPY,
    "16UC1": pb.DEPTH_ENCODING_16UC1,
    "32FC1": pb.DEPTH_ENCODING_32FC1,
    "compressedDepth": pb.DEPTH_ENCODING_COMPRESSED_DEPTH,
}


def stub(channel: grpc.Channel) -> DeformationServiceStub:
    return DeformationServiceStub(channel)


def message(body: Mapping[str, Any]) -> pb.DeformRequest:
    """The JSON request as a message; field for field, and nothing that is not there."""
    request = pb.DeformRequest()
    for name, value in body.items():
        match name, value:
            case _, None:
                pass
            case "camera" | "material", _:
                getattr(request, name).SetInParent()
                _set(getattr(request, name), value)
            case "depth" | "mask" | "shape", _:
                _image(getattr(request, name), value)
            case "up", _:
                request.up.CopyFrom(vector(value))
            case "roi", (u, v, width, height):
                request.roi.CopyFrom(pb.Region(u=u, v=v, width=width, height=height))
            case "loads", _:
                request.loads.extend(_load(load) for load in value)
            case "displacement_form", _:
                request.displacement_form = pb.DisplacementForm.Value(f"DISPLACEMENT_FORM_{value.upper()}")
            case "outputs", _:
                request.outputs.CopyFrom(pb.Outputs(**dict.fromkeys(value, True)))
            case _:
                setattr(request, name, value)
    return request


def vector(components: Any) -> pb.Vector3:
    x, y, z = components
    return pb.Vector3(x=x, y=y, z=z)


def _set(target: Any, fields: Mapping[str, Any]) -> None:
    for name, value in fields.items():
        if value is None:
            continue
        if isinstance(value, list):
            getattr(target, name).extend(value)
        else:
            setattr(target, name, value)


def _image(target: Any, fields: Mapping[str, Any]) -> None:
    target.SetInParent()
    for name, value in fields.items():
        if name == "data":
            target.data = base64.b64decode(value)
        elif name == "camera_from_grid":
            target.camera_from_grid.extend(number for row in value for number in row)
        elif name == "encoding" and isinstance(target, pb.DepthImage):
            target.encoding = _ENCODINGS[value]
        elif name == "unit_m" and value is not None:
            target.unit_m = value
        elif name == "voxel_size_m":
            target.voxel_size_m = value


def _load(fields: Mapping[str, Any]) -> pb.Load:
    load = pb.Load()
    for name, value in fields.items():
        if value is None:
            continue
        if name == "contact_px":
            load.contact_px.CopyFrom(pb.Pixel(u=value[0], v=value[1]))
        elif name == "patch_radius_m":
            load.patch_radius_m = value
        else:
            getattr(load, name).CopyFrom(vector(value))
    return load


def document(response: pb.DeformResponse) -> dict[str, Any]:
    """The response as the JSON document that HTTP would have answered with."""
    pose = list(response.grid.camera_from_grid)
    found: dict[str, Any] = {
        "request_id": response.request_id,
        "model": {"name": response.model.name, "version": response.model.version},
        "grid": {
            "shape": list(response.grid.shape),
            "voxel_size_m": response.grid.voxel_size_m,
            "camera_from_grid": [pose[row : row + 4] for row in range(0, 16, 4)],
        },
        "loads": [],
        "flags": list(response.flags),
        "timing_ms": dict(response.timing_ms),
    }
    if response.HasField("reconstruction_id"):
        found["reconstruction_id"] = response.reconstruction_id
    if response.HasField("scene"):
        found["scene"] = {"encoding": "glb", "data": _b64(response.scene)}
    for name in ("observed", "reconstruction", "reconstruction_probability"):
        if response.HasField(name):
            found[name] = _grid(getattr(response, name))
    for load in response.loads:
        answer: dict[str, Any] = {
            name: getattr(load, name) for name in ("max_displacement_m", "mean_displacement_m", "load_number")
        }
        answer["flags"] = list(load.flags)
        for name in ("deformed", "probability", "displacement", "displacement_at_voxels"):
            if load.HasField(name):
                answer[name] = _grid(getattr(load, name))
        found["loads"].append(answer)
    return found


def _grid(grid: Any) -> dict[str, Any]:
    match grid:
        case pb.OccupancyGrid():
            return {"encoding": "bits", "data": _b64(grid.bits)}
        case pb.ProbabilityGrid():
            return {"encoding": "uint8", "shape": [64] * 3, "data": _b64(grid.levels)}
        case pb.DisplacementAtVoxels():
            return {"encoding": "float16", "shape": [3, grid.count], "data": _b64(grid.float16_m)}
    return {"encoding": "float16", "shape": [3, 64, 64, 64], "data": _b64(grid.float16_m)}


def _b64(data: bytes) -> str:
    return base64.b64encode(data).decode()


def problem(error: grpc.RpcError) -> dict[str, Any]:
    """The problem document in the rich details of a failed call; fails where there is none."""
    status = rpc_status.from_call(error)
    assert status is not None, f"no rich details: {error}"
    found = pb.Problem()
    (packed,) = [detail for detail in status.details if detail.Is(pb.Problem.DESCRIPTOR)]
    packed.Unpack(found)
    assert found.detail == error.details()
    return problem_document(found)


def problem_document(found: pb.Problem) -> dict[str, Any]:
    return MessageToDict(found, preserving_proto_field_name=True)
