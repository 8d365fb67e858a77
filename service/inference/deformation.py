"""NumPy façade of the deformation: a coarse elastic solve, and the network that corrects it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import onnxruntime
from jaxtyping import Float32

from service.core.arrays import Occupancy, Probability
from service.core.condition import CONDITION_FIELDS, Condition
from service.core.displacement import Box, body_box, corrected
from service.core.lookup import Warp
from service.core.manifest import Manifest
from service.core.prior import ElasticPrior

Forward: TypeAlias = Float32[np.ndarray, "n axis=3 x=16 y=16 z=16"]
Backward: TypeAlias = Float32[np.ndarray, "n axis=3 x=32 y=32 z=32"]

POISSON_RATIO = CONDITION_FIELDS.index("poisson_ratio")


@dataclass(frozen=True)
class Deformation:
    """Answers for n loads on one body, in its body grid.

    Attributes:
        probability: Occupancy probability after each load.
        field: Backward displacement u on the lattice of `service.core.displacement.Field`, in edges of the grid: the
            material at y was at rest at y - u(y).
    """

    probability: Float32[np.ndarray, "n x=64 y=64 z=64"]
    field: Backward


@dataclass(frozen=True)
class Prior:
    """Answers of the coarse solve for n loads, see `service.core.prior.PriorSolution`."""

    forward: Forward
    backward: Backward


@dataclass(frozen=True, eq=False)
class _Body:
    """A body, ready for any load: as asked about, as the network sees it, its box, and its occupancy to be warped."""

    rest: Occupancy
    smooth: Probability | None
    tensor: Float32[np.ndarray, "1 1 x=64 y=64 z=64"]
    box: Box
    warp: Warp


class DeformationModel:
    """From an undeformed body and a batch of conditions to its deformed shapes."""

    def __init__(self, session: onnxruntime.InferenceSession, manifest: Manifest) -> None:
        self._session = session
        self.manifest = manifest
        self._latent = int(next(i for i in session.get_inputs() if i.name == "noise").shape[1])
        self._solved: tuple[Occupancy, float, ElasticPrior] | None = None
        self._known: _Body | None = None

    def prior(self, rest: Occupancy, conditions: Sequence[Condition]) -> Prior:
        """The coarse solve that the network starts from; loads of one material are solved at once."""
        ratios = [float(condition[POISSON_RATIO]) for condition in conditions]
        if len(set(ratios)) == 1:  # as from a robot, whose request names one material
            answer = self._solver(rest, ratios[0]).displacements(conditions)
            return Prior(answer.forward, answer.backward)
        n = len(conditions)
        forward, backward = np.empty((n, 3, 16, 16, 16), np.float32), np.empty((n, 3, 32, 32, 32), np.float32)
        for ratio in set(ratios):
            rows = [row for row, one in enumerate(ratios) if one == ratio]
            answer = self._solver(rest, ratio).displacements([conditions[row] for row in rows])
            forward[rows], backward[rows] = answer.forward, answer.backward
        return Prior(forward, backward)

    def __call__(
        self, rest: Occupancy, conditions: Sequence[Condition], samples: int = 0, prior: Prior | None = None,
        smooth: Probability | None = None,
    ) -> Deformation:  # fmt: skip
        """Deform one body under each of n loads.

        Args:
            rest: Undeformed body in its body grid, not empty.
            conditions: One vector a load, at least one.
            samples: 0 takes the latent's mean; more averages the answers over that many draws of it (fixed seed, so
                that a question asked twice has one answer).
            prior: Of these loads, if it is known already.
            smooth: See `service.core.lookup.Warp`.
        """
        prior = prior or self.prior(rest, conditions)
        body = self._body(rest, smooth)
        inputs = {"rest": body.tensor, "condition": np.stack(conditions), "prior": prior.forward}

        def answer(noise: Float32[np.ndarray, "n latent"]) -> Deformation:
            (correction,) = self._session.run(["correction"], {**inputs, "noise": noise})
            fields = [corrected(u, delta, body.box) for u, delta in zip(prior.backward, correction, strict=True)]
            return Deformation(_stacked([body.warp(field) for field in fields]), _stacked(fields))

        if samples == 0:
            return answer(np.zeros((len(conditions), self._latent), np.float32))
        draws = np.random.default_rng(0).standard_normal((samples, self._latent)).astype(np.float32)
        answers = [answer(np.repeat(draw[None], len(conditions), axis=0)) for draw in draws]
        return Deformation(
            np.stack([each.probability for each in answers]).mean(axis=0),
            np.stack([each.field for each in answers]).mean(axis=0),
        )

    def _solver(self, rest: Occupancy, poisson_ratio: float) -> ElasticPrior:
        """The factorised solve of a body. That of the last one is kept: a planner asks about the same body again."""
        if self._solved is None or self._solved[0] is not rest or self._solved[1] != poisson_ratio:
            self._solved = rest, poisson_ratio, ElasticPrior(rest, poisson_ratio)
        return self._solved[2]

    def _body(self, rest: Occupancy, smooth: Probability | None) -> _Body:
        """What every load on a body needs of it. That of the last one is kept, too."""
        if self._known is None or self._known.rest is not rest or self._known.smooth is not smooth:
            tensor = rest.astype(np.float32)[None, None]
            self._known = _Body(rest, smooth, tensor, body_box(rest), Warp(rest, smooth))
        return self._known

    def outside_training_range(self, condition: Condition) -> bool:
        """Whether a field of the condition lies beyond what the network was trained on.

        A load number below the range is not: the network's answer is linear in it there, as the body's is.
        """
        for name, value in zip(CONDITION_FIELDS, condition, strict=True):
            low, high = self.manifest.condition_range[name]
            if value > high or (value < low and name != "log10_load_number"):
                return True
        return False


def _stacked(arrays: list[Float32[np.ndarray, "..."]]) -> Float32[np.ndarray, "n ..."]:
    """`np.stack`, which copies the one array of a single load, too."""
    return arrays[0][None] if len(arrays) == 1 else np.stack(arrays)
