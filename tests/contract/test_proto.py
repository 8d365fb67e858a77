"""The gRPC API's contract: generated code is of the .proto files, robots' old libraries can import it, and what was
published stays as it was, field by field.

After a change that is meant: `PHYSNET_WRITE_BASELINE=1 python -m pytest tests/contract`.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from google.protobuf.descriptor_pb2 import DescriptorProto, FileDescriptorProto, FileDescriptorSet

from service.api.generated import deformation_pb2, deformation_pb2_grpc

ROOT = Path(__file__).resolve().parents[2]
GENERATED = ROOT / "service" / "api" / "generated"
BASELINE = Path(__file__).with_name("proto_v1.binpb")
FILES = ("deformation_pb2.py", "deformation_pb2.pyi", "deformation_pb2_grpc.py")


def without_json_names(file: FileDescriptorProto) -> FileDescriptorProto:
    """Protoc adds them to descriptor sets and leaves them out of generated code."""
    clean = FileDescriptorProto.FromString(file.SerializeToString())
    stack = list(clean.message_type)
    while stack:
        message = stack.pop()
        stack.extend(message.nested_type)
        for field in message.field:
            field.ClearField("json_name")
    return clean


@pytest.fixture(scope="module")
def compiled(tmp_path_factory: pytest.TempPathFactory) -> dict[str, FileDescriptorProto]:
    """proto/ as it is now, through whichever protoc is installed: descriptors are the same from each."""
    protoc = pytest.importorskip("grpc_tools.protoc", reason="needs grpcio-tools")
    out = tmp_path_factory.mktemp("proto") / "all.binpb"
    include = Path(protoc.__file__).parent / "_proto"
    sources = ["physnet/v1/deformation.proto", "inference/v2/grpc_service.proto"]
    command = ["protoc", f"-I{ROOT / 'proto'}", f"-I{include}", f"--descriptor_set_out={out}", *sources]
    assert protoc.main(command) == 0
    return {file.name: file for file in FileDescriptorSet.FromString(out.read_bytes()).file}


def test_the_generated_code_is_that_of_the_proto_files(compiled):
    ours = FileDescriptorProto.FromString(deformation_pb2.DESCRIPTOR.serialized_pb)
    assert without_json_names(compiled[ours.name]) == without_json_names(ours), "stale: run `make proto`"
    (theirs,) = FileDescriptorSet.FromString((GENERATED / "inference_v2.binpb").read_bytes()).file
    assert without_json_names(compiled[theirs.name]) == without_json_names(theirs), "stale: run `make proto`"


def test_the_stub_knows_every_method(compiled):
    (service,) = compiled["physnet/v1/deformation.proto"].service
    text = (GENERATED / "deformation_pb2_grpc.py").read_text("utf-8")
    for method in service.method:
        assert f"'/physnet.v1.{service.name}/{method.name}'" in text, "stale: run `make proto`"
        assert hasattr(deformation_pb2_grpc.DeformationServiceServicer, method.name)


def test_the_pinned_generator_writes_these_very_bytes(tmp_path):
    """Where `make proto` has been run: comments and all."""
    python = ROOT / ".venv-proto" / "bin" / "python"
    if not python.exists():
        pytest.skip("no .venv-proto; `make proto` makes it")
    subprocess.run([python, ROOT / "proto" / "generate.py", tmp_path], check=True, timeout=60)
    for path in tmp_path.iterdir():
        assert path.read_bytes() == (GENERATED / path.name).read_bytes(), f"stale: {path.name}, run `make proto`"


@pytest.mark.parametrize("name", FILES)
def test_robots_with_old_libraries_can_import_it(name):
    """Guards that newer generators write refuse protobuf 4 (runtime_version) and grpcio 1.60 (_registered_method)."""
    text = (GENERATED / name).read_text("utf-8")
    assert not [guard for guard in ("runtime_version", "_registered_method", "GRPC_GENERATED_VERSION") if guard in text]


def test_importing_the_client_code_needs_nothing_but_protobuf_and_grpc():
    program = (
        "import sys, service.api.generated.deformation_pb2_grpc\n"
        "print(*{name.split('.')[0] for name in sys.modules})"
    )
    loaded = subprocess.run(
        [sys.executable, "-c", program], cwd=ROOT, check=True, capture_output=True, text=True, timeout=60
    ).stdout.split()
    assert not {"numpy", "onnxruntime", "pydantic", "fastapi", "cv2"} & set(loaded)


def walk(file: FileDescriptorProto) -> Iterator[tuple[str, Any]]:
    """Every field, enum value and method by its full path, with what a client relies on."""

    def messages(prefix: str, found: Any) -> Iterator[tuple[str, DescriptorProto]]:
        for message in found:
            yield f"{prefix}.{message.name}", message
            yield from messages(f"{prefix}.{message.name}", message.nested_type)

    enums = [(file.package, enum) for enum in file.enum_type]
    for path, message in messages(file.package, file.message_type):
        enums += [(path, enum) for enum in message.enum_type]
        for field in message.field:
            oneof = message.oneof_decl[field.oneof_index].name if field.HasField("oneof_index") else None
            yield (
                f"{path}.{field.name}",
                (field.number, field.type, field.label, field.type_name, field.proto3_optional, oneof),
            )
    for prefix, enum in enums:
        for value in enum.value:
            yield f"{prefix}.{enum.name}.{value.name}", value.number
    for service in file.service:
        for method in service.method:
            path = f"{file.package}.{service.name}.{method.name}"
            yield path, (method.input_type, method.output_type, method.client_streaming, method.server_streaming)


def test_what_was_published_is_still_there():
    published = FileDescriptorProto.FromString(deformation_pb2.DESCRIPTOR.serialized_pb)
    if os.environ.get("PHYSNET_WRITE_BASELINE"):
        BASELINE.write_bytes(FileDescriptorSet(file=[published]).SerializeToString(deterministic=True))
    (committed,) = FileDescriptorSet.FromString(BASELINE.read_bytes()).file
    now = dict(walk(published))
    assert len(dict(walk(committed))) > 100
    for path, promise in walk(committed):
        assert now.get(path) == promise, path


@pytest.mark.parametrize("change", ["renumber", "remove", "retype", "rename"])
def test_the_comparison_sees_a_break(change):
    (committed,) = FileDescriptorSet.FromString(BASELINE.read_bytes()).file
    before = dict(walk(committed))
    field = next(message for message in committed.message_type if message.name == "Load").field[3]
    match change:
        case "renumber":
            field.number = 40
        case "remove":
            next(message for message in committed.message_type if message.name == "Load").field.pop()
        case "retype":
            field.type = field.TYPE_FLOAT
        case "rename":
            field.name = "patch_radius_mm"
    assert dict(walk(committed)).get("physnet.v1.Load.patch_radius_m") != before["physnet.v1.Load.patch_radius_m"]


def test_every_physical_number_says_its_unit():
    """Names of doubles end in a unit, or are known to have none."""
    dimensionless = {
        "fx", "fy", "cx", "cy", "distortion", "threshold", "x", "y", "z", "u", "v", "camera_from_grid", "poisson_ratio",
        "load_number", "low", "high", "value",
    }  # fmt: skip
    for path, promise in walk(FileDescriptorProto.FromString(deformation_pb2.DESCRIPTOR.serialized_pb)):
        name = path.rpartition(".")[2]
        if isinstance(promise, tuple) and promise[1] == 1 and name not in dimensionless:
            assert name.endswith(("_m", "_n", "_pa", "_s", "_ms")), path
