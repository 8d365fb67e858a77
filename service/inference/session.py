"""Opening a network in ONNX Runtime, checked against its manifest."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import onnxruntime

from service.core.errors import ModelMismatch
from service.core.manifest import Manifest, TensorSpec
from service.inference.helpers import starting


def open_sessions(
    directory: Path, manifest: Manifest, threads: Sequence[int]
) -> tuple[onnxruntime.InferenceSession, ...]:
    """CPU sessions for the graphs of a network, in the order in which they run.

    Args:
        directory: The model's folder.
        manifest: Its manifest; names and shapes of the tensors must agree with the graphs.
        threads: Within an operator of each of them, at least 1.

    Raises:
        ModelMismatch: The graphs' tensors are not those of the manifest.
    """
    with starting():
        sessions = tuple(
            _open(directory / graph, count) for graph, count in zip(manifest.graphs, threads, strict=True)
        )
    handed_on = {spec for session in sessions[:-1] for spec in _specs(session.get_outputs())}
    inputs = [spec for session in sessions for spec in _specs(session.get_inputs()) if spec not in handed_on]
    for what, specs, found in (
        ("inputs", manifest.inputs, inputs),
        ("outputs", manifest.outputs, _specs(sessions[-1].get_outputs())),
    ):
        if tuple(found) != specs:
            raise ModelMismatch(
                f"{directory / manifest.graph}: the graph's {what} are not those of its manifest.",
                expected=str([s.name for s in specs]),
                actual=str([s.name for s in found]),
            )
    return sessions


def _open(path: Path, threads: int) -> onnxruntime.InferenceSession:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    # Spinning threads would take the cores from whoever else lives on the robot's computer.
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    return onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])


def _specs(tensors: list[onnxruntime.NodeArg]) -> list[TensorSpec]:
    return [TensorSpec(tensor.name, tuple(tensor.shape)) for tensor in tensors]
