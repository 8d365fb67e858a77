"""A network as it is, without the façade: tensors in, tensors out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from service.core.manifest import Manifest


@dataclass(frozen=True)
class Graph:
    """An opened graph and what it is.

    Attributes:
        session: An `onnxruntime.InferenceSession`, the one that the façade runs. Not named as such: the wires know
            graphs, and ONNX Runtime is loaded beside them.
    """

    session: Any
    manifest: Manifest

    def run(self, inputs: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Every output for float32 inputs of the manifest's names and shapes."""
        names = [spec.name for spec in self.manifest.outputs]
        return dict(zip(names, self.session.run(names, dict(inputs)), strict=True))
