"""NumPy façade of the deformation network."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import onnxruntime
from jaxtyping import Float32

from service.core.arrays import Occupancy
from service.core.condition import CONDITION_FIELDS, Condition
from service.core.lookup import warp
from service.core.manifest import Manifest

Displacements: TypeAlias = Float32[np.ndarray, "n axis=3 x=64 y=64 z=64"]


@dataclass(frozen=True)
class Deformation:
    """Answers for n loads on one body, in its body grid.

    Attributes:
        probability: Occupancy probability after each load.
        displacement: Backward displacement in edges of the grid: the material at y was at rest at y - u(y).
    """

    probability: Float32[np.ndarray, "n x=64 y=64 z=64"]
    displacement: Displacements


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
            displacement = self._run(body, stacked, np.zeros((len(stacked), self._latent), np.float32))
            return Deformation(_warp_all(rest, displacement), displacement)
        draws = np.random.default_rng(0).standard_normal((samples, self._latent)).astype(np.float32)
        answers = [self._run(body, stacked, np.repeat(draw[None], len(stacked), axis=0)) for draw in draws]
        probability = np.stack([_warp_all(rest, displacement) for displacement in answers]).mean(axis=0)
        return Deformation(probability, np.stack(answers).mean(axis=0))

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
    ) -> Displacements:  # fmt: skip
        (displacement,) = self._session.run(["displacement"], {"rest": body, "condition": conditions, "noise": noise})
        result: Displacements = displacement
        return result


def _warp_all(rest: Occupancy, displacement: Displacements) -> Float32[np.ndarray, "n x=64 y=64 z=64"]:
    return np.stack([warp(rest, field) for field in displacement])
