"""The coarse elastic solve of every sample, worked out when a body is first asked for and kept."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float16, Float32, Int, UInt8

from service.core.grids import unpack_bits
from service.core.prior import ElasticPrior
from service.core.prior_field import FIELD_SIZE
from service.core.prior_lattice import LATTICE_SIZE

FORWARD = (3, LATTICE_SIZE, LATTICE_SIZE, LATTICE_SIZE)
BACKWARD = (3, FIELD_SIZE, FIELD_SIZE, FIELD_SIZE)


@dataclass(frozen=True, eq=False)
class Priors:
    """`service.core.prior` of the samples of a set; 2 to 3 ms of a shared core and 216 KiB a sample.

    Attributes:
        rest: Bits of the bodies.
        body: Row of each sample's body in `rest`.
        condition: Of each sample.
    """

    rest: UInt8[np.ndarray, "bodies bytes"]
    body: Int[np.ndarray, " n"]
    condition: Float32[np.ndarray, "n 9"]
    _known: dict[int, tuple[Float16[np.ndarray, "..."], Float16[np.ndarray, "..."]]] = field(default_factory=dict)

    def __call__(
        self, rows: Int[np.ndarray, " b"]
    ) -> tuple[Float32[np.ndarray, "b 3 16 16 16"], Float32[np.ndarray, "b 3 32 32 32"]]:
        """u(x) at rest and u_b(y) of these samples, in edges of the grid."""
        for body in {int(self.body[row]) for row in rows if int(row) not in self._known}:
            self._solve(body)
        known = [self._known[int(row)] for row in rows]
        forward, backward = (np.stack([answer[i] for answer in known]).astype(np.float32) for i in (0, 1))
        return forward, backward

    def only(self, rows: Int[np.ndarray, " k"]) -> Priors:
        """Those of some samples, with what is known of them already."""
        known = {i: self._known[row] for i, row in enumerate(rows.tolist()) if row in self._known}
        return Priors(self.rest, self.body[rows], self.condition[rows], known)

    def _solve(self, body: int) -> None:
        """All samples of a body, those of one Poisson's ratio at once."""
        occupancy = unpack_bits(self.rest[body])
        own = np.flatnonzero(self.body == body)
        for ratio in np.unique(self.condition[own, 7]):
            rows = own[self.condition[own, 7] == ratio]
            answer = ElasticPrior(occupancy, float(ratio)).displacements(list(self.condition[rows]))
            for row, forward, backward in zip(rows, answer.forward, answer.backward, strict=True):
                self._known[int(row)] = (forward.astype(np.float16), backward.astype(np.float16))
