"""NumPy façade of the deformation network."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import onnxruntime
from jaxtyping import Float32

from service.core.arrays import Occupancy
from service.core.condition import CONDITION_FIELDS, Condition
from service.core.manifest import Manifest


@dataclass(frozen=True)
class Deformation:
    """Answers for n loads on one body, in its body grid.

    Attributes:
        probability: Occupancy probability after each load.
        displacement: Backward displacement in edges of the grid: the material at y was at rest at y - u(y).
    """

    probability: Float32[np.ndarray, "n x=64 y=64 z=64"]
    displacement: Float32[np.ndarray, "n axis=3 x=64 y=64 z=64"]


class DeformationModel:
    """From an undeformed body and a batch of conditions to its deformed shapes."""

    def __init__(self, session: onnxruntime.InferenceSession, manifest: Manifest) -> None:
        self._session = session
        self.manifest = manifest
        self._latent = int(next(i for i in session.get_inputs() if i.name == "noise").shape[1])

    def __call__(self, rest: Occupancy, conditions: Sequence[Condition], samples: int = 0) -> Deformation:
        """Deform one body under each of n loads.

        Args:
            rest: Undeformed body in its body grid.
            conditions: One vector a load, at least one.
            samples: 0 takes the latent's mean; more averages the answers over that many draws of it (fixed seed, so
                that a question asked twice has one answer).
        """
        body = rest.astype(np.float32)[None, None]
        stacked = np.stack(conditions)
        if samples == 0:
            noise = np.zeros((len(stacked), self._latent), np.float32)
            return Deformation(*self._run(body, stacked, noise))
        draws = np.random.default_rng(0).standard_normal((samples, self._latent)).astype(np.float32)
        answers = [self._run(body, stacked, np.broadcast_to(draw, (len(stacked), self._latent))) for draw in draws]
        probability, displacement = (
            np.asarray(np.mean(parts, axis=0), np.float32) for parts in zip(*answers, strict=True)
        )
        return Deformation(probability, displacement)

    def outside_training_range(self, condition: Condition) -> bool:
        """Whether a field of the condition lies beyond what the network was trained on.

        A load number below the range is not: the network's answer is linear in it there, as the body's is.
        """
        for name, value in zip(CONDITION_FIELDS, condition, strict=True):
            low, high = self.manifest.condition_range[name]
            if value > high or (value < low and name != "log10_load_number"):
                return True
        return False

    def _run(
        self, body: Float32[np.ndarray, "1 1 x y z"], conditions: Float32[np.ndarray, "n 9"],
        noise: Float32[np.ndarray, "n latent"],
    ) -> tuple[Float32[np.ndarray, "n x y z"], Float32[np.ndarray, "n 3 x y z"]]:  # fmt: skip
        probability, displacement = self._session.run(
            ["probability", "displacement"], {"rest": body, "condition": conditions, "noise": noise}
        )
        return probability, displacement
