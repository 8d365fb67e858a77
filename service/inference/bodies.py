"""Bodies that were asked about: a planner asks about the same one again, and what its loads share is kept."""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import partial
from typing import TypeAlias

import numpy as np
from jaxtyping import Float32

from service.core.arrays import Occupancy
from service.core.condition import POISSON_RATIO_MAX
from service.core.lookup import Inside, Warp
from service.core.prior import ElasticPrior
from service.core.spread import Spread
from service.inference.spare_cores import Once

KEPT_BODIES = 4
"""Of 1 to 5 MiB each."""

KEPT_SOLVERS = 2
"""Of each body, for as many Poisson's ratios."""

Features: TypeAlias = dict[str, np.ndarray]
Encode: TypeAlias = Callable[[Float32[np.ndarray, "..."]], Features]


class PreparedBody:
    """A body, ready for any load; each of its parts is worked out when it is first asked for.

    Args:
        rest: The body.
        inside: See `service.core.lookup.Warp`.
        encode: Encodes it for the network.
        spread: Cores for the solve's set-up.

    Attributes:
        features: What the network makes of the body alone, by name.
        warp: Its occupancy, to be looked up.
    """

    def __init__(self, rest: Occupancy, inside: Inside | None, encode: Encode, spread: Spread) -> None:
        self.rest = rest
        self.inside = inside
        self.features = Once(lambda: encode(rest.astype(np.float32)[None, None]))
        self.warp = Once(lambda: Warp(rest, inside))
        self._spread = spread
        self._lock = threading.Lock()
        self._solvers: dict[np.float32, Once[ElasticPrior]] = {}

    def solver(self, poisson_ratio: float) -> Once[ElasticPrior]:
        """Its factorised solve for a Poisson's ratio, as precise as in a condition."""
        ratio = np.float32(min(poisson_ratio, POISSON_RATIO_MAX))
        with self._lock:
            found = self._solvers.pop(ratio, None) or Once(
                partial(ElasticPrior, self.rest, float(ratio), spread=self._spread)
            )
            self._solvers[ratio] = found
            if len(self._solvers) > KEPT_SOLVERS:
                del self._solvers[next(iter(self._solvers))]
            return found


class Bodies:
    """The bodies asked about last. Any thread may use them.

    Args:
        encode: See `PreparedBody`.
        spread: See `PreparedBody`.
    """

    def __init__(self, encode: Encode, spread: Spread) -> None:
        self._encode = encode
        self._spread = spread
        self._kept: list[PreparedBody] = []
        self._lock = threading.Lock()

    def find(self, rest: Occupancy, inside: Inside | None) -> PreparedBody:
        """A body, kept if it is the same array that was asked about before."""
        with self._lock:
            for body in self._kept:
                if body.rest is rest and body.inside is inside:
                    self._kept.remove(body)
                    break
            else:
                body = PreparedBody(rest, inside, self._encode, self._spread)
            self._kept = [*self._kept, body][-KEPT_BODIES:]
            return body
