"""Displacements at rest on the lattice of the coarse solve: all that a correction can say, at a quarter of the cost.

A batch of `training.data.batches` holds what is served too, fields of 32³ nodes and voxels of the deformed body; most
of a step's time goes into these, and not into the network.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Float32
from torch import Tensor

from service.core.prior_lattice import LATTICE_SIZE
from training.data.batches import (
    FIELD,
    DeformationSet,
    coverage,
    mirrored_condition,
    mirrored_field,
    transposed_condition,
    transposed_field,
    unpack,
)
from training.data.priors import Priors

LATTICE = (LATTICE_SIZE,) * 3

LINEAR_PEAK = 0.02
"""Largest displacement, in edges of the grid, up to which the linear law is believed. Where the neo-Hookean one
stays below 0.06, the best factor for the coarse solve is the same by both to 0.02 of its logarithm; at linear peaks of
0.06 to 0.1 the spread of that factor has doubled."""


@dataclass(frozen=True, eq=False)
class LatticeSet:
    """The samples of a set on the lattice.

    Samples by the linear law hold at any load: those that went farther than `LINEAR_PEAK` are scaled down to it.

    Attributes:
        samples: The set.
        condition: Of each sample.
        peak: Of each sample.
        prior: Its coarse solves.
        forward: u(x), means over the body in each cell of the lattice.
        covered: Part of each cell that lies in each body at rest.
    """

    samples: DeformationSet
    condition: Float32[np.ndarray, "n 9"]
    peak: Float32[np.ndarray, " n"]
    prior: Priors
    forward: Float32[np.ndarray, "n 3 16 16 16"]
    covered: Float32[np.ndarray, "bodies 16 16 16"]

    def __len__(self) -> int:
        return len(self.samples)

    @classmethod
    def of(cls, samples: DeformationSet) -> LatticeSet:
        """Take the means."""
        linear = np.array(samples.law) == "linear"
        part = np.where(linear, np.minimum(1.0, LINEAR_PEAK / np.maximum(samples.peak, 1e-9)), 1.0).astype(np.float32)
        condition = samples.condition.copy()
        condition[:, 6] += np.log10(part)
        forward = np.zeros((len(samples), 3, *LATTICE), np.float32)
        covered = np.zeros((len(samples.rest), *LATTICE), np.float32)
        for body in range(len(samples.rest)):
            inside = coverage(unpack(samples.rest[body : body + 1]))[0, 0].numpy()
            covered[body] = _block_means(inside[None])[0]
            for row in np.flatnonzero(samples.body == body):
                fields = samples.fields[body]
                field = np.zeros((3, FIELD[0] * FIELD[1] * FIELD[2]), np.float32)
                field[:, fields.nodes] = fields.forward[samples.step[row]]
                weighed = _block_means(field.reshape(3, *FIELD) * inside)
                forward[row] = part[row] * weighed / np.maximum(covered[body], 1e-6)
        prior = Priors(samples.rest, samples.body, condition)
        return cls(samples, condition, part * samples.peak, prior, forward, covered)

    def batch_by_body(self, bodies: int, loads: int, rng: np.random.Generator) -> LatticeBatch:
        """As `DeformationSet.batch_by_body` draws them."""
        chosen, rows = self.samples.draw(bodies, loads, rng)
        return LatticeBatch(
            rest=unpack(self.samples.rest[chosen]),
            condition=torch.from_numpy(self.condition[rows]),
            peak=torch.from_numpy(self.peak[rows]),
            forward=torch.from_numpy(self.forward[rows]),
            rest_coverage=torch.from_numpy(self.covered[chosen])[:, None],
            prior_forward=torch.from_numpy(self.prior(rows)[0]),
        )


@dataclass(frozen=True, eq=False)
class LatticeBatch:
    """Tensors of one step; names as in `DeformationBatch`."""

    rest: Float[Tensor, "bodies 1 64 64 64"]
    condition: Float[Tensor, "b 9"]
    peak: Float[Tensor, " b"]
    forward: Float[Tensor, "b 3 16 16 16"]
    rest_coverage: Float[Tensor, "bodies 1 16 16 16"]
    prior_forward: Float[Tensor, "b 3 16 16 16"]

    def mirrored(self, axis: int) -> LatticeBatch:
        """As `DeformationBatch.mirrored`."""
        return LatticeBatch(
            self.rest.flip(2 + axis), mirrored_condition(self.condition, axis), self.peak,
            mirrored_field(self.forward, axis), self.rest_coverage.flip(2 + axis),
            mirrored_field(self.prior_forward, axis),
        )  # fmt: skip

    def transposed(self) -> LatticeBatch:
        """As `DeformationBatch.transposed`."""
        return LatticeBatch(
            self.rest.transpose(2, 3), transposed_condition(self.condition), self.peak, transposed_field(self.forward),
            self.rest_coverage.transpose(2, 3), transposed_field(self.prior_forward),
        )  # fmt: skip


def _block_means(values: Float32[np.ndarray, "c 32 32 32"]) -> Float32[np.ndarray, "c 16 16 16"]:
    size = LATTICE_SIZE
    means: Float32[np.ndarray, "c 16 16 16"] = values.reshape(-1, size, 2, size, 2, size, 2).mean(axis=(2, 4, 6))
    return means
