"""What is in a data set, in numbers."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float64

from training.data.batches import split_of
from training.data.store import Store

BAR = 30
"""Characters of the longest bar of a histogram."""
BINS = 10


@dataclass(frozen=True)
class Description:
    """Counts and distributions of a set.

    Attributes:
        manifest: As it was written; empty where the set is not finished.
        digest: Of the arrays as they are now.
        groups: Groups found.
        samples: Samples found.
        families: Groups of each family.
        splits: Groups of each split.
        laws: Samples by law.
        values: Distributions by name, with the unit in the name.
    """

    manifest: dict[str, Any]
    digest: str
    groups: int
    samples: int
    families: Counter[str]
    splits: Counter[str]
    laws: Counter[str]
    values: dict[str, Float64[np.ndarray, " n"]]

    @property
    def is_intact(self) -> bool:
        """Whether the arrays are those that the manifest was written over; False where there is none."""
        return bool(self.manifest) and self.manifest["digest"] == self.digest

    def lines(self) -> Iterator[str]:
        """For a terminal."""
        configuration = self.manifest.get("configuration", {})
        yield f"set                 {configuration.get('set', 'unfinished: no manifest')}"
        yield f"groups, samples     {self.groups}, {self.samples}"
        drops = self.manifest.get("dropped", {})
        draws = self.groups + sum(drops.values())
        yield f"dropped             {sum(drops.values())} of {draws}: {_counts(drops) or 'none'}"
        yield f"digest              {self.digest[:23]}… {self._verdict}"
        if self.manifest:
            yield f"code                {self.manifest['code']}"
        yield f"splits              {_counts(self.splits)}"
        yield f"families            {_counts(self.families)}"
        if self.laws:
            yield f"laws                {_counts(self.laws)}"
        for name, values in self.values.items():
            low, median, high = np.quantile(values, [0.1, 0.5, 0.9])
            yield f"{name:19} median {median:.4g}, 10 % below {low:.4g}, 10 % above {high:.4g}"
        if "identity IoU" in self.values:
            yield from histogram(self.values["identity IoU"])

    @property
    def _verdict(self) -> str:
        if not self.manifest:
            return "(not finished)"
        if self.is_intact:
            return "as in the manifest"
        return f"DIFFERS from the manifest's {self.manifest['digest'][:23]}…"


def describe(store: Store) -> Description:
    """Read a whole set, finished or growing.

    Raises:
        StoreError: It holds nothing, is of another version, or is damaged.
    """
    families: Counter[str] = Counter()
    splits: Counter[str] = Counter()
    laws: Counter[str] = Counter()
    columns: dict[str, list[np.ndarray]] = {}
    for index, group in store.groups():
        families[str(group["family"])] += 1
        splits[split_of(index)] += 1
        laws.update(str(law) for law in group.get("law", ()))
        for name, column in _distributions(group).items():
            columns.setdefault(name, []).append(np.asarray(column, np.float64))
    digest, groups, samples = store.digest()
    manifest = store.manifest() if store.manifest_path.exists() or not groups else {}
    values = {name: np.concatenate(parts) for name, parts in columns.items()}
    finite = {name: part[np.isfinite(part)] for name, part in values.items()}
    return Description(
        manifest, digest, groups, samples, families, splits, laws, {k: v for k, v in finite.items() if len(v)}
    )


def _distributions(group: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """What is worth a distribution, of whatever kind the set is."""
    found: dict[str, np.ndarray] = {}
    if "identity_iou" in group:
        found["identity IoU"] = group["identity_iou"]
    if "condition" in group:
        condition = group["condition"]
        found |= {"log10 load number": condition[:, 6], "Poisson's ratio": condition[:, 7]}
        found |= {"peak / L": group["peak"], "E / Pa": group["young_modulus_pa"], "F / N": group["force_n"]}
        found["smallest Jacobian"] = group["smallest_jacobian"]
        if "peak_von_mises" in group:
            found["peak stress / E"] = group["peak_von_mises"]
    if "truth" in group:
        found["size / m"] = group["sample"][:, 1]
        found["observed voxels"] = np.unpackbits(group["observed"], axis=1).sum(axis=1)
    return found


def histogram(values: Float64[np.ndarray, " n"]) -> Iterator[str]:
    """Bars over [0, 1], a line a tenth."""
    counts, edges = np.histogram(values, BINS, (0.0, 1.0))
    for count, low, high in zip(counts, edges[:-1], edges[1:], strict=True):
        bar = "█" * round(BAR * count / max(int(counts.max()), 1))
        yield f"    {low:.1f} to {high:.1f}  {count:7d}  {bar}"


def _counts(counter: dict[str, int]) -> str:
    return ", ".join(f"{name} {count}" for name, count in sorted(counter.items(), key=lambda item: -item[1]))
