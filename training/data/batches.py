"""A data set in memory, bit-packed, and batches of tensors from it, augmented by the symmetries of the problem."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float, Float16, Float32, Float64, Int, UInt8
from torch import Tensor

from service.core.grids import unpack_bits
from training.data.fields import unpack_nodes
from training.data.priors import BACKWARD, FORWARD, Priors
from training.data.store import Store, StoreError
from training.data.view_augmentation import Seen, ViewAugmentation, augmented

GRID = (64, 64, 64)
FIELD = (32, 32, 32)

COLUMNS = (
    "condition", "deformed", "peak", "identity_iou", "strain_energy", "smallest_jacobian", "reaction",
    "young_modulus_pa", "force_n", "location",
)  # fmt: skip
"""Arrays of a group with one row a sample that are read as they are."""


def split_of(group: int) -> str:
    """Split by body, never by load or view: one body in twenty validates, one in ten tests, the rest trains."""
    remainder = group % 20
    return "validation" if remainder == 0 else "test" if remainder in (1, 2) else "train"


def _no_body(root: Path, split: str) -> StoreError:
    return StoreError(f"{root} holds no body of the {split} split; draw more groups with `physnet-train simulate`")


def unpack(bits: UInt8[np.ndarray, "n bytes"]) -> Float[Tensor, "n 1 64 64 64"]:
    """Bit-packed grids to floats."""
    voxels = np.unpackbits(bits, axis=1, bitorder="little").reshape(len(bits), 1, *GRID)
    return torch.from_numpy(voxels).float()


@dataclass(frozen=True)
class Fields:
    """Displacement fields of the loads on one body, at the nodes near it.

    Attributes:
        nodes: Flat index of the k nodes.
        backward: u(y) at nodes of the deformed body and a little beyond.
        forward: u(x) at nodes of the body at rest and a little beyond.
    """

    nodes: Int[np.ndarray, " k"]
    backward: Float16[np.ndarray, "loads 3 k"]
    forward: Float16[np.ndarray, "loads 3 k"]


@dataclass(frozen=True)
class DeformationSet:
    """Samples of bodies under loads; `body` maps each to its row of `rest` and `fields`, `step` to its row in these."""

    rest: UInt8[np.ndarray, "bodies bytes"]
    family: tuple[str, ...]
    fields: tuple[Fields, ...]
    body: Int[np.ndarray, " n"]
    step: Int[np.ndarray, " n"]
    condition: Float32[np.ndarray, "n 9"]
    deformed: UInt8[np.ndarray, "n bytes"]
    peak: Float32[np.ndarray, " n"]
    identity_iou: Float32[np.ndarray, " n"]
    strain_energy: Float32[np.ndarray, " n"]
    smallest_jacobian: Float32[np.ndarray, " n"]
    reaction: Float32[np.ndarray, "n 6"]
    young_modulus_pa: Float64[np.ndarray, " n"]
    force_n: Float64[np.ndarray, " n"]
    location: Float32[np.ndarray, "n 2"]
    law: tuple[str, ...]
    prior: Priors | None

    def __len__(self) -> int:
        return len(self.body)

    @classmethod
    def load(cls, root: Path, split: str, prior: bool = True) -> DeformationSet:
        """Read one split of a finished or growing store; `all` is every body.

        Args:
            root: Folder of the data set.
            split: `train`, `validation`, `test` or `all`.
            prior: False where nobody asks for the coarse solve: batches hold zeros in its place.

        Raises:
            StoreError: It holds no body of that split, or it is of another store version.
        """
        columns: dict[str, list[Any]] = {}
        rest: list[UInt8[np.ndarray, " bytes"]] = []
        fields: list[Fields] = []
        body: list[Int[np.ndarray, " n"]] = []
        step: list[Int[np.ndarray, " n"]] = []
        family: list[str] = []
        law: list[str] = []
        for index, group in Store(root).groups():
            if split not in ("all", split_of(index)):
                continue
            body.append(np.full(len(group["sample"]), len(rest)))
            step.append(np.arange(len(group["sample"])))
            rest.append(group["rest"])
            nodes = np.flatnonzero(unpack_nodes(group["nodes"]))
            fields.append(Fields(nodes, group["displacement"], group["forward"]))
            family.append(str(group["family"]))
            law.extend(str(name) for name in group["law"])
            for key in COLUMNS:
                columns.setdefault(key, []).append(group[key])
        if not rest:
            raise _no_body(root, split)
        bodies, of_sample = np.stack(rest), np.concatenate(body)
        values = {key: np.concatenate(parts) for key, parts in columns.items()}
        return cls(
            rest=bodies, family=tuple(family), fields=tuple(fields), body=of_sample, step=np.concatenate(step),
            law=tuple(law), prior=Priors(bodies, of_sample, values["condition"]) if prior else None, **values,
        )  # fmt: skip

    def only(self, chosen: Bool[np.ndarray, " n"]) -> DeformationSet:
        """Some of the samples; all bodies stay, those without a sample too."""
        rows = np.flatnonzero(chosen)
        columns = {key: getattr(self, key)[rows] for key in ("body", "step", *COLUMNS)}
        law = tuple(self.law[row] for row in rows)
        return replace(self, law=law, prior=self.prior.only(rows) if self.prior else None, **columns)

    def joined(self, others: Sequence[DeformationSet]) -> DeformationSet:
        """These samples and then those of other sets; coarse solves are made anew."""
        sets = (self, *others)
        rest, columns = np.concatenate([s.rest for s in sets]), ("step", *COLUMNS)
        starts = np.cumsum([0, *(len(s.rest) for s in sets[:-1])])
        body = np.concatenate([start + s.body for start, s in zip(starts, sets, strict=True)])
        values = {key: np.concatenate([getattr(s, key) for s in sets]) for key in columns}
        return DeformationSet(
            rest=rest, body=body, family=tuple(name for s in sets for name in s.family),
            fields=tuple(field for s in sets for field in s.fields), law=tuple(name for s in sets for name in s.law),
            prior=Priors(rest, body, values["condition"]) if self.prior else None, **values,
        )  # fmt: skip

    def batch(self, rows: Int[np.ndarray, " b"]) -> DeformationBatch:
        """The samples of these rows, each with its own body."""
        return self._batch(self.body[rows], rows)

    def batch_by_body(self, bodies: int, loads: int, rng: np.random.Generator) -> DeformationBatch:
        """Random loads on a few random bodies, which the encoder then sees once each."""
        return self._batch(*self.draw(bodies, loads, rng))

    def draw(
        self, bodies: int, loads: int, rng: np.random.Generator
    ) -> tuple[Int[np.ndarray, " bodies"], Int[np.ndarray, " b"]]:
        """Random bodies, all alike, and the rows of random loads on each of them."""
        chosen = rng.choice(np.unique(self.body), bodies, replace=False)
        rows = []
        for body in chosen:
            own = np.flatnonzero(self.body == body)
            rows.append(rng.choice(own, loads, replace=len(own) < loads))
        return chosen, np.concatenate(rows)

    def _batch(self, bodies: Int[np.ndarray, " bodies"], rows: Int[np.ndarray, " b"]) -> DeformationBatch:
        rest, deformed = unpack(self.rest[bodies]), unpack(self.deformed[rows])
        shape = (len(rows), 3, FIELD[0] * FIELD[1] * FIELD[2])
        backward, forward = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
        for i, row in enumerate(rows):
            fields, step = self.fields[self.body[row]], self.step[row]
            backward[i][:, fields.nodes] = fields.backward[step]
            forward[i][:, fields.nodes] = fields.forward[step]
        if self.prior is not None:
            prior_forward, prior_backward = self.prior(rows)
        else:
            prior_forward, prior_backward = (np.zeros((len(rows), *of), np.float32) for of in (FORWARD, BACKWARD))
        return DeformationBatch(
            rest=rest,
            condition=torch.from_numpy(self.condition[rows]),
            deformed=deformed[:, 0],
            displacement=torch.from_numpy(backward).view(-1, 3, *FIELD),
            coverage=coverage(deformed),
            peak=torch.from_numpy(self.peak[rows]),
            forward=torch.from_numpy(forward).view(-1, 3, *FIELD),
            rest_coverage=coverage(rest),
            prior_forward=torch.from_numpy(prior_forward),
            prior_backward=torch.from_numpy(prior_backward),
        )


def coverage(occupancy: Float[Tensor, "n 1 64 64 64"]) -> Float[Tensor, "n 1 32 32 32"]:
    """Part of each node's block of 2³ voxels that lies in the body: where a field is more than carried on."""
    return torch.nn.functional.avg_pool3d(occupancy, 2)


@dataclass(frozen=True)
class DeformationBatch:
    """Tensors of one step; the same number of consecutive loads belongs to each body.

    Attributes:
        displacement: Backward, u(y) on nodes of the deformed body and two beyond, zero elsewhere.
        coverage: Part of each node's block in the deformed body.
        forward: u(x) on nodes of the body at rest and two beyond.
        rest_coverage: Part of each node's block in the body at rest.
        prior_forward: u(x) of the coarse solve.
        prior_backward: u(y) of the coarse solve.
    """

    rest: Float[Tensor, "bodies 1 64 64 64"]
    condition: Float[Tensor, "b 9"]
    deformed: Float[Tensor, "b 64 64 64"]
    displacement: Float[Tensor, "b 3 32 32 32"]
    coverage: Float[Tensor, "b 1 32 32 32"]
    peak: Float[Tensor, " b"]
    forward: Float[Tensor, "b 3 32 32 32"]
    rest_coverage: Float[Tensor, "bodies 1 32 32 32"]
    prior_forward: Float[Tensor, "b 3 16 16 16"]
    prior_backward: Float[Tensor, "b 3 32 32 32"]

    @property
    def rest_of_loads(self) -> Float[Tensor, "b 1 64 64 64"]:
        """The undeformed body of every load."""
        return self.rest.repeat_interleave(len(self.condition) // len(self.rest), dim=0)

    def mirrored(self, axis: int) -> DeformationBatch:
        """Mirror image in the plane through the middle of the cube across horizontal axis 0 or 1: still a solution."""
        condition = mirrored_condition(self.condition, axis)
        displacement, forward, prior_forward, prior_backward = (
            mirrored_field(field, axis) for field in self._vector_fields
        )
        return DeformationBatch(
            self.rest.flip(2 + axis), condition, self.deformed.flip(1 + axis), displacement,
            self.coverage.flip(2 + axis), self.peak, forward, self.rest_coverage.flip(2 + axis), prior_forward,
            prior_backward,
        )  # fmt: skip

    def transposed(self) -> DeformationBatch:
        """Mirror image in the vertical plane x = y; with `mirrored` it makes the quarter turns."""
        condition = transposed_condition(self.condition)
        displacement, forward, prior_forward, prior_backward = map(transposed_field, self._vector_fields)
        return DeformationBatch(
            self.rest.transpose(2, 3), condition, self.deformed.transpose(1, 2), displacement,
            self.coverage.transpose(2, 3), self.peak, forward, self.rest_coverage.transpose(2, 3), prior_forward,
            prior_backward,
        )  # fmt: skip

    @property
    def _vector_fields(self) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        return self.displacement, self.forward, self.prior_forward, self.prior_backward


def mirrored_condition(condition: Float[Tensor, "b 9"], axis: int) -> Float[Tensor, "b 9"]:
    """Of the mirror image across horizontal axis 0 or 1."""
    mirrored = condition.clone()
    mirrored[:, axis] = 1.0 - mirrored[:, axis]
    mirrored[:, 3 + axis] *= -1.0
    return mirrored


def transposed_condition(condition: Float[Tensor, "b 9"]) -> Float[Tensor, "b 9"]:
    """Of the mirror image in the plane x = y."""
    return torch.cat([condition[:, [1, 0, 2]], condition[:, [4, 3, 5]], condition[:, 6:]], dim=1)


def mirrored_field(field: Float[Tensor, "b 3 x y z"], axis: int) -> Float[Tensor, "b 3 x y z"]:
    """Vectors of the mirror image across horizontal axis 0 or 1."""
    mirrored = field.flip(2 + axis)
    mirrored[:, axis] *= -1.0
    return mirrored


def transposed_field(field: Float[Tensor, "b 3 x y z"]) -> Float[Tensor, "b 3 y x z"]:
    """Vectors of the mirror image in the plane x = y."""
    return field[:, [1, 0, 2]].transpose(2, 3)


def spread_rows(size: int, count: int) -> Int[np.ndarray, " n"]:
    """At most `count` of `size` rows, evenly spread."""
    return np.unique(np.linspace(0, size - 1, count).astype(int))


@dataclass(frozen=True)
class ViewSet:
    """Views of bodies in their view grids."""

    observed: UInt8[np.ndarray, "n bytes"]
    free: UInt8[np.ndarray, "n bytes"]
    truth: UInt8[np.ndarray, "n bytes"]
    family: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.observed)

    @classmethod
    def load(cls, root: Path, split: str) -> ViewSet:
        """Read one split of a finished or growing store; `all` is every body.

        Raises:
            StoreError: It holds no body of that split, or it is of another store version.
        """
        columns: dict[str, list[Any]] = {"observed": [], "free": [], "truth": []}
        family: list[str] = []
        for index, group in Store(root).groups():
            if split not in ("all", split_of(index)):
                continue
            for key, parts in columns.items():
                parts.append(group[key])
            family.extend([str(group["family"])] * len(group["sample"]))
        if not family:
            raise _no_body(root, split)
        return cls(family=tuple(family), **{key: np.concatenate(parts) for key, parts in columns.items()})

    def joined(self, others: Sequence[ViewSet]) -> ViewSet:
        """These views and then those of other sets."""
        sets = (self, *others)
        kinds = ("observed", "free", "truth")
        return ViewSet(
            family=tuple(name for s in sets for name in s.family),
            **{kind: np.concatenate([getattr(s, kind) for s in sets]) for kind in kinds},
        )

    def batch(self, rows: Int[np.ndarray, " b"]) -> ViewBatch:
        view = torch.cat([unpack(self.observed[rows]), unpack(self.free[rows])], dim=1)
        return ViewBatch(view=view, truth=unpack(self.truth[rows])[:, 0])

    def augmented_batch(
        self, rows: Int[np.ndarray, " b"], config: ViewAugmentation, rng: np.random.Generator
    ) -> ViewBatch:
        """The same after each view was changed, see `training.data.view_augmentation`."""
        kinds = (self.observed, self.free, self.truth)
        views = [augmented(Seen(*(unpack_bits(bits[row]) for bits in kinds)), config, rng) for row in rows]
        view = np.stack([np.stack([each.observed, each.free]) for each in views])
        truth = np.stack([each.truth for each in views])
        return ViewBatch(view=torch.from_numpy(view).float(), truth=torch.from_numpy(truth).float())


@dataclass(frozen=True)
class ViewBatch:
    """Tensors of one step."""

    view: Float[Tensor, "b 2 64 64 64"]
    truth: Float[Tensor, "b 64 64 64"]

    def mirrored(self) -> ViewBatch:
        """Mirror image left to right; front and back, unlike left and right, differ for a camera."""
        return ViewBatch(self.view.flip(3), self.truth.flip(2))
