"""Writes the generated code of proto/ to a folder: `make proto`.

The generator is pinned to grpcio-tools 1.60.2: code of a newer one refuses to be imported beside the protobuf 4 and
grpcio 1.60 that robots still run, while code of this one runs with every protobuf since 4.21, as the tests show.
"""

from __future__ import annotations

import sys
import tempfile
from importlib.metadata import version
from pathlib import Path

from grpc_tools import protoc

PROTO = Path(__file__).resolve().parent
PINNED = "1.60.2"
PACKAGE = "service.api.generated"


def generate(out: Path) -> None:
    """Write messages, their types and the service of physnet.v1, and the descriptors of the Open Inference Protocol."""
    with tempfile.TemporaryDirectory() as folder:
        ours = "physnet/v1/deformation.proto"
        _protoc(f"--python_out={folder}", f"--pyi_out={folder}", f"--grpc_python_out={folder}", ours)
        for path in sorted(Path(folder, ours).parent.iterdir()):
            # Protoc's import paths are those of the .proto files; ours lie inside the package.
            text = path.read_text("utf-8").replace("from physnet.v1 import", f"from {PACKAGE} import")
            (out / path.name).write_text(text, "utf-8")
    _protoc(f"--descriptor_set_out={out / 'inference_v2.binpb'}", "inference/v2/grpc_service.proto")


def _protoc(*arguments: str) -> None:
    # grpc_tools brings google/protobuf/*.proto along.
    wellknown = Path(protoc.__file__).parent / "_proto"
    if protoc.main(["protoc", f"-I{PROTO}", f"-I{wellknown}", *arguments]) != 0:
        raise SystemExit(1)


if __name__ == "__main__":
    if version("grpcio-tools") != PINNED:
        raise SystemExit(f"this needs grpcio-tools {PINNED}, not {version('grpcio-tools')}: use `make proto`")
    generate(Path(sys.argv[1]))
