"""What a deformation network gives beyond the test split: other bodies, and bands of questions it was kept from."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int

from training.comparison import Contender, compare, contenders, deforming
from training.configs import HeldOut
from training.data.batches import DeformationSet, spread_rows
from training.evaluate import as_served
from training.networks.checkpoint import load_network

CELLS = (16,)
"""Of the linear finite elements beside the networks here."""

KEPT = "network, trained on it"
"""The network of the report, on what another one was kept from."""


@dataclass(frozen=True)
class Split:
    """Samples that a network was not trained on the like of.

    Attributes:
        name: In the table.
        samples: A set that holds them.
        rows: Which of its samples.
        rivals: What answers; the last but `KEPT` is the network that never saw the like.
    """

    name: str
    samples: DeformationSet
    rows: Int[np.ndarray, " n"]
    rivals: list[Contender]

    def figures(self) -> dict[str, Any]:
        """Those of every rival, by its name."""
        identity = self.samples.identity_iou[self.rows].astype(float)
        everywhere = np.ones(len(self.rows), bool)
        table = compare(self.rivals, self.samples, self.rows)
        return {
            "split": self.name,
            "samples": len(self.rows),
            **{scores.name: {**scores.figures(identity, everywhere), "ms": scores.ms} for scores in table},
        }


def other_bodies(data: Path, rivals: list[Contender], count: int) -> Split:
    """All bodies of another data set, which none of the rivals has seen: scanned meshes, for instance.

    Raises:
        StoreError: It cannot be read.
    """
    samples = DeformationSet.load(data, "all")
    return Split(f"bodies of {data.name}", samples, spread_rows(len(samples), count), rivals)


def held_out(
    run: Path,
    network: Contender,
    training: DeformationSet,
    validation: DeformationSet,
    test: DeformationSet,
    count: int,
) -> Split:
    """What another run was kept from (`configs.HeldOut`), answered by its network, beside one that was trained on it.

    Raises:
        ValueError: It was kept from nothing, or from nothing that is in the test split.
    """
    kept, state = load_network(run / "checkpoint.pt")
    found = state["config"].get("held_out")
    if not found:
        raise ValueError(f"{run} was trained on everything; there is nothing that it was kept from")
    held = HeldOut(**{**found, "families": tuple(found["families"])})
    own, threshold, _ = as_served(deforming(kept), validation.only(~held.holds(validation)))
    samples = test.only(held.holds(test))
    if not len(samples):
        raise ValueError(f"the split holds none of what {run} was kept from: {words(held)}")
    seen = training.only(~held.holds(training))
    rivals = [
        *contenders(own, threshold, seen, CELLS),
        Contender(KEPT, network.answer, network.threshold, network.solves),
    ]
    return Split(f"{words(held)}, never trained on", samples, spread_rows(len(samples), count), rivals)


def words(held: HeldOut) -> str:
    """What is held out, as the table names it."""
    parts = [", ".join(held.families)] if held.families else []
    if held.field is not None:
        low = "" if held.low == -math.inf else f"{held.low:g} ≤ "
        high = "" if held.high == math.inf else f" ≤ {held.high:g}"
        parts.append(f"{low}{held.field}{high}")
    return "; ".join(parts)


def splits_markdown(found: Sequence[dict[str, Any]]) -> str:
    """IoU of every contender on every split, as a table; a contender that was not asked has an empty cell."""
    names = list(dict.fromkeys(name for row in found for name in row if name not in ("split", "samples")))
    lines = ["| IoU by split | samples | " + " | ".join(names) + " |", "|---" * (len(names) + 2) + "|"]
    for row in found:
        cells = " | ".join(f"{row[name]['iou']:.3f}" if name in row else "" for name in names)
        lines.append(f"| {row['split']} | {row['samples']} | {cells} |")
    return "\n".join(lines) + "\n"
