"""Opening a graph in ONNX Runtime, checked against its manifest."""

from __future__ import annotations

from pathlib import Path

import onnxruntime

from service.core.errors import ModelMismatch
from service.core.manifest import Manifest, TensorSpec


def open_session(directory: Path, manifest: Manifest, threads: int) -> onnxruntime.InferenceSession:
    """A CPU session for one graph.

    Args:
        directory: The model's folder.
        manifest: Its manifest; names and shapes of the tensors must agree with the graph.
        threads: Threads within an operator, at least 1.

    Raises:
        ModelMismatch: The graph's tensors are not those of the manifest.
    """
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    # Spinning threads would take the cores from whoever else lives on the robot's computer.
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    session = onnxruntime.InferenceSession(str(directory / manifest.graph), options, providers=["CPUExecutionProvider"])
    for what, specs, tensors in (
        ("inputs", manifest.inputs, session.get_inputs()),
        ("outputs", manifest.outputs, session.get_outputs()),
    ):
        found = tuple(TensorSpec(t.name, tuple(t.shape)) for t in tensors)
        if found != specs:
            raise ModelMismatch(
                f"{directory / manifest.graph}: the graph's {what} are not those of its manifest.",
                expected=str([s.name for s in specs]),
                actual=str([s.name for s in found]),
            )
    return session
