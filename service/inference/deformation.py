"""NumPy façade of the deformation: a coarse elastic solve, and the network that corrects it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import onnxruntime
from jaxtyping import Float32

from service.core.arrays import Occupancy
from service.core.condition import CONDITION_FIELDS, Condition
from service.core.lookup import Inside
from service.core.manifest import Manifest
from service.core.prior import Balanced, Nodal
from service.core.spread import Spread
from service.inference.bodies import Bodies, Features
from service.inference.spare_cores import Once, SpareCores

Forward: TypeAlias = Float32[np.ndarray, "n axis=3 x=16 y=16 z=16"]
Backward: TypeAlias = Float32[np.ndarray, "n axis=3 x=32 y=32 z=32"]
Solve: TypeAlias = Callable[[Sequence[Condition]], tuple[Nodal, Balanced]]

POISSON_RATIO = CONDITION_FIELDS.index("poisson_ratio")


@dataclass(frozen=True)
class Deformation:
    """Answers for n loads on one body, in its body grid.

    Attributes:
        probability: Occupancy probability after each load.
        field: Backward displacement u on the lattice of `service.core.displacement.Field`, in edges of the grid: the
            material at y was at rest at y - u(y).
        balanced: Of the coarse solve, see `service.core.prior.PriorSolution`.
    """

    probability: Float32[np.ndarray, "n x=64 y=64 z=64"]
    field: Backward
    balanced: Balanced


@dataclass(frozen=True)
class Prior:
    """Answers of the coarse solve for n loads, see `service.core.prior.PriorSolution`.

    The network needs the first alone; the second may be worked out meanwhile.
    """

    forward: Forward
    backward: Once[Backward]
    balanced: Balanced


class DeformationModel:
    """From an undeformed body and a batch of conditions to its deformed shapes. Any thread may ask.

    Args:
        encoder: From a body to what the network knows of it, for any load.
        generator: From that, loads and the coarse solve's answers to what these lack.
        manifest: Of both.
        spare: Cores for what need not be done in turn.
    """

    def __init__(
        self, encoder: onnxruntime.InferenceSession, generator: onnxruntime.InferenceSession, manifest: Manifest,
        spare: SpareCores | None = None,
    ) -> None:  # fmt: skip
        self._encoder = encoder
        self._session = generator
        self.manifest = manifest
        self.spare = spare or SpareCores(0)
        self._features = [tensor.name for tensor in encoder.get_outputs()]
        self._latent = int(next(i for i in generator.get_inputs() if i.name == "noise").shape[1])
        self._bodies = Bodies(self._encode, self.spare.spread)

    def prepare(
        self, rest: Occupancy, poisson_ratio: float, inside: Inside | None = None, soon: Iterable[Once[Any]] = (),
        later: Iterable[Once[Any]] = (),
    ) -> None:  # fmt: skip
        """Set the coarse solve of a body up, and offer what its answers need besides to cores that have time.

        Args:
            rest: The body.
            poisson_ratio: ν of its material.
            inside: See `service.core.lookup.Warp`.
            soon: What its caller needs before loads are solved for.
            later: What its caller needs after that.
        """
        body = self._bodies.find(rest, inside)
        for once in soon:
            self.spare.offer(once)
        body.solver(poisson_ratio)()  # half of it is offered, too
        self.spare.offer(body.features)
        self.spare.offer(body.warp)
        for once in later:
            self.spare.offer(once)

    def prior(self, rest: Occupancy, conditions: Sequence[Condition], inside: Inside | None = None) -> Prior:
        """The coarse solve that the network starts from; loads of one material are solved at once."""
        body = self._bodies.find(rest, inside)
        ratios = [float(condition[POISSON_RATIO]) for condition in conditions]
        solver = body.solver(ratios[0])()
        nodal = np.empty((len(conditions), 3, len(solver.grid.nodes)), np.float32)
        balanced = np.empty(len(conditions), bool)
        for ratio in set(ratios):  # one, as from a robot, whose request names one material
            rows, solve = [row for row, one in enumerate(ratios) if one == ratio], body.solver(ratio)().nodal

            def part(first: int, end: int, rows: list[int] = rows, solve: Solve = solve) -> None:
                own = rows[first:end]
                nodal[own], balanced[own] = solve([conditions[row] for row in own])

            self.spare.spread(part, len(rows))
        # The fields are those of the cells, whatever the material. The network is kept waiting by the first alone.
        forward = solver.forward(nodal)
        return Prior(forward, self.spare.offer(Once(lambda: solver.backward(nodal, balanced))), balanced)

    def __call__(
        self, rest: Occupancy, conditions: Sequence[Condition], samples: int = 0, prior: Prior | None = None,
        inside: Inside | None = None,
    ) -> Deformation:  # fmt: skip
        """Deform one body under each of n loads.

        Args:
            rest: Undeformed body in its body grid, not empty.
            conditions: One vector a load, at least one.
            samples: 0 takes the latent's mean; more averages the answers over that many draws of it (fixed seed, so
                that a question asked twice has one answer).
            prior: Of these loads, if it is known already.
            inside: See `service.core.lookup.Warp`.
        """
        body = self._bodies.find(rest, inside)
        known = prior or self.prior(rest, conditions, inside)
        inputs = {**body.features(), "condition": np.stack(conditions), "prior": known.forward}
        loads = len(conditions)

        def answer(noise: Float32[np.ndarray, "n latent"]) -> Deformation:
            (correction,) = self._session.run(["correction"], {**inputs, "noise": noise})
            backward, warp = known.backward(), body.warp()
            field = np.empty_like(backward)
            probability = np.empty((loads, *rest.shape), np.float32)

            def carry(i: int, spread: Spread) -> None:
                warp.corrected(backward[i], correction[i], field[i], probability[i], spread)

            self.spare.each(carry, loads)
            return Deformation(probability, field, known.balanced)

        if samples == 0:
            return answer(np.zeros((loads, self._latent), np.float32))
        draws = np.random.default_rng(0).standard_normal((samples, self._latent)).astype(np.float32)
        answers = [answer(np.repeat(draw[None], loads, axis=0)) for draw in draws]
        return Deformation(
            np.stack([each.probability for each in answers]).mean(axis=0),
            np.stack([each.field for each in answers]).mean(axis=0),
            known.balanced,
        )

    def _encode(self, tensor: Float32[np.ndarray, "1 1 x=64 y=64 z=64"]) -> Features:
        return dict(zip(self._features, self._encoder.run(self._features, {"rest": tensor}), strict=True))

    def outside_training_range(self, condition: Condition) -> bool:
        """Whether a field of the condition lies beyond what the network was trained on.

        A load number below the range is not: the network's answer is linear in it there, as the body's is.
        """
        for name, value in zip(CONDITION_FIELDS, condition, strict=True):
            low, high = self.manifest.condition_range[name]
            if value > high or (value < low and name != "log10_load_number"):
                return True
        return False
