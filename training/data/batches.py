"""A data set in memory, bit-packed, and batches of tensors from it, augmented by the symmetries of the problem."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Float16, Float32, Int, UInt8
from torch import Tensor

from training.data.store import Store, StoreError

GRID = (64, 64, 64)
FIELD = (32, 32, 32)


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
class DeformationSet:
    """Samples of bodies under loads; `body` maps each sample to its row of `rest`."""

    rest: UInt8[np.ndarray, "bodies bytes"]
    family: tuple[str, ...]
    body: Int[np.ndarray, " n"]
    condition: Float32[np.ndarray, "n 9"]
    deformed: UInt8[np.ndarray, "n bytes"]
    displacement: Float16[np.ndarray, "n 3 32 32 32"]
    coverage: UInt8[np.ndarray, "n 32 32 32"]
    peak: Float32[np.ndarray, " n"]
    identity_iou: Float32[np.ndarray, " n"]
    law: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.body)

    @classmethod
    def load(cls, root: Path, split: str) -> DeformationSet:
        """Read one split of a finished or growing store.

        Raises:
            StoreError: It holds no body of that split.
        """
        columns: dict[str, list[Any]] = {}
        rest: list[UInt8[np.ndarray, " bytes"]] = []
        body: list[Int[np.ndarray, " n"]] = []
        family: list[str] = []
        law: list[str] = []
        for index, group in Store(root).groups():
            if split_of(index) != split:
                continue
            body.append(np.full(len(group["sample"]), len(rest)))
            rest.append(group["rest"])
            family.append(str(group["family"]))
            law.extend(str(name) for name in group["law"])
            for key in ("condition", "deformed", "displacement", "coverage", "peak", "identity_iou"):
                columns.setdefault(key, []).append(group[key])
        if not rest:
            raise _no_body(root, split)
        return cls(
            rest=np.stack(rest), family=tuple(family), body=np.concatenate(body), law=tuple(law),
            **{key: np.concatenate(parts) for key, parts in columns.items()},
        )  # fmt: skip

    def batch(self, rows: Int[np.ndarray, " b"]) -> DeformationBatch:
        """The samples of these rows, each with its own body."""
        return self._batch(self.body[rows], rows)

    def batch_by_body(self, bodies: int, loads: int, rng: np.random.Generator) -> DeformationBatch:
        """Random loads on a few random bodies, which the encoder then sees once each."""
        chosen = rng.choice(len(self.rest), bodies, replace=False)
        rows = []
        for body in chosen:
            own = np.flatnonzero(self.body == body)
            rows.append(rng.choice(own, loads, replace=len(own) < loads))
        return self._batch(chosen, np.concatenate(rows))

    def _batch(self, bodies: Int[np.ndarray, " bodies"], rows: Int[np.ndarray, " b"]) -> DeformationBatch:
        return DeformationBatch(
            rest=unpack(self.rest[bodies]),
            condition=torch.from_numpy(self.condition[rows]),
            deformed=unpack(self.deformed[rows])[:, 0],
            displacement=torch.from_numpy(self.displacement[rows]).float(),
            coverage=torch.from_numpy(self.coverage[rows]).float()[:, None] / 8.0,
            peak=torch.from_numpy(self.peak[rows]),
        )


@dataclass(frozen=True)
class DeformationBatch:
    """Tensors of one step; the same number of consecutive loads belongs to each body."""

    rest: Float[Tensor, "bodies 1 64 64 64"]
    condition: Float[Tensor, "b 9"]
    deformed: Float[Tensor, "b 64 64 64"]
    displacement: Float[Tensor, "b 3 32 32 32"]
    coverage: Float[Tensor, "b 1 32 32 32"]
    peak: Float[Tensor, " b"]

    @property
    def rest_of_loads(self) -> Float[Tensor, "b 1 64 64 64"]:
        """The undeformed body of every load."""
        return self.rest.repeat_interleave(len(self.condition) // len(self.rest), dim=0)

    def mirrored(self, axis: int) -> DeformationBatch:
        """Mirror image in the plane through the middle of the cube across horizontal axis 0 or 1: still a solution."""
        condition, displacement = self.condition.clone(), self.displacement.flip(2 + axis)
        condition[:, axis] = 1.0 - condition[:, axis]
        condition[:, 3 + axis] *= -1.0
        displacement[:, axis] *= -1.0
        return DeformationBatch(
            self.rest.flip(2 + axis), condition, self.deformed.flip(1 + axis), displacement,
            self.coverage.flip(2 + axis), self.peak,
        )  # fmt: skip

    def transposed(self) -> DeformationBatch:
        """Mirror image in the vertical plane x = y; with `mirrored` it makes the quarter turns."""
        swap = [1, 0, 2]
        condition = torch.cat([self.condition[:, swap], self.condition[:, [4, 3, 5]], self.condition[:, 6:]], dim=1)
        return DeformationBatch(
            self.rest.transpose(2, 3), condition, self.deformed.transpose(1, 2),
            self.displacement[:, swap].transpose(2, 3), self.coverage.transpose(2, 3), self.peak,
        )  # fmt: skip


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
        """Read one split of a finished or growing store.

        Raises:
            StoreError: It holds no body of that split.
        """
        columns: dict[str, list[Any]] = {"observed": [], "free": [], "truth": []}
        family: list[str] = []
        for index, group in Store(root).groups():
            if split_of(index) != split:
                continue
            for key, parts in columns.items():
                parts.append(group[key])
            family.extend([str(group["family"])] * len(group["sample"]))
        if not family:
            raise _no_body(root, split)
        return cls(family=tuple(family), **{key: np.concatenate(parts) for key, parts in columns.items()})

    def batch(self, rows: Int[np.ndarray, " b"]) -> ViewBatch:
        view = torch.cat([unpack(self.observed[rows]), unpack(self.free[rows])], dim=1)
        return ViewBatch(view=view, truth=unpack(self.truth[rows])[:, 0])


@dataclass(frozen=True)
class ViewBatch:
    """Tensors of one step."""

    view: Float[Tensor, "b 2 64 64 64"]
    truth: Float[Tensor, "b 64 64 64"]

    def mirrored(self) -> ViewBatch:
        """Mirror image left to right; front and back, unlike left and right, differ for a camera."""
        return ViewBatch(self.view.flip(3), self.truth.flip(2))
