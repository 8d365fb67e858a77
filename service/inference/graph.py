"""A network as it is, without the façade: tensors in, tensors out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from service.core.manifest import Manifest


@dataclass(frozen=True)
class Graph:
    """An opened network and what it is.

    Attributes:
        sessions: An `onnxruntime.InferenceSession` for each graph of the manifest, those that the façade runs. Not
            named as such: the wires know graphs, and ONNX Runtime is loaded beside them.
    """

    sessions: tuple[Any, ...]
    manifest: Manifest

    def run(self, inputs: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Every output for float32 inputs of the manifest's names and shapes."""
        known = dict(inputs)
        for session in self.sessions:
            names = [tensor.name for tensor in session.get_outputs()]
            feeds = {tensor.name: known[tensor.name] for tensor in session.get_inputs()}
            known.update(zip(names, session.run(names, feeds), strict=True))
        return {spec.name: known[spec.name] for spec in self.manifest.outputs}
