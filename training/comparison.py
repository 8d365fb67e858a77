"""Deformation networks beside what they must beat, on bodies that none of them was trained on."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Float32, Float64, Int
from torch import nn

from service.core.lookup import warp
from training.baselines import LinearFem, NearestNeighbours, NeoHookeanFem, mean_shape
from training.data.batches import DeformationBatch, DeformationSet
from training.data.priors import Priors
from training.evaluate import MOVED, uncertain
from training.metrics import calibration_curve, changed_voxel_iou, displacement_error, error_of_curve, iou, skill
from training.networks.deformation import DeformationNetwork
from training.networks.physnet import PhysNet
from training.predict import predict, relative_displacements
from training.simulation.body import BodyError
from training.simulation.loads import LoadError

TENTHS = 10
WORST = 10

STRICT = 0.8
"""The paper's threshold, printed beside ours."""

Occupancies: TypeAlias = Float32[np.ndarray, "b x=64 y=64 z=64"]
Displacements: TypeAlias = Float32[np.ndarray, "b axis=3 x=32 y=32 z=32"]
Answering: TypeAlias = Callable[[DeformationBatch], tuple[Occupancies, Displacements | None]]

NEIGHBOUR_SCALE = np.array([1.0, 1.0, 1.0, 0.5, 0.5, 0.5, 0.5, 0.5, 1.0])
"""Distances between conditions are measured in these units."""


ERRORS = ("displacement_error", "displacement_error_p95", "displacement_error_voxels", "displacement_error_voxels_p95")
"""As `evaluate.evaluate_deformation` names them: shares of the peak and voxels, mean and 95th percentile of a body."""


@dataclass(frozen=True)
class Contender:
    """Something that answers what a body will look like.

    Attributes:
        name: In the table.
        answer: Occupancy probabilities for a batch in which every load has a body of its own, and the backward
            displacement in edges of the grid; None of what has none on the nodes of the truth.
        threshold: Above it a voxel is filled.
        solves: Whether it starts from the coarse solve, whose time then counts as its own.
    """

    name: str
    answer: Answering
    threshold: float = 0.5
    solves: bool = False


@dataclass(frozen=True)
class Scores:
    """Of one contender, a row a sample; the calibration (`metrics.calibration_curve`) is of all samples together.

    `strict` is the IoU at the paper's threshold; `errors` are those of the displacement by the names of `ERRORS`, none
    where there is none.
    """

    name: str
    iou: Float[np.ndarray, " n"]
    strict: Float[np.ndarray, " n"]
    changed: Float[np.ndarray, " n"]
    errors: dict[str, Float[np.ndarray, " n"]]
    calibration: Float64[np.ndarray, "3 bins"]
    ms: float

    def figures(self, identity: Float[np.ndarray, " n"], rows: Bool[np.ndarray, " n"]) -> dict[str, float]:
        """Means over some samples; skill over those of them that moved."""
        moved = rows & (identity < MOVED)
        gained = skill(self.iou[moved], identity[moved])
        return {
            "iou": float(self.iou[rows].mean()),
            "iou_p10": float(np.quantile(self.iou[rows], 0.1)),
            "iou_at_0.8": float(self.strict[rows].mean()),
            "skill": float(gained.mean()) if moved.any() else 0.0,
            "iou_changed_voxels": float(self.changed[moved].mean()) if moved.any() else 0.0,
            **{name: float(np.nanmean(values[rows])) for name, values in self.errors.items()},
        }


def deforming(network: nn.Module) -> DeformationNetwork | PhysNet:
    """The network, if it is one that deforms.

    Raises:
        TypeError: It is not.
    """
    if not isinstance(network, (DeformationNetwork, PhysNet)):
        raise TypeError(f"a {type(network).__name__} deforms nothing")
    return network


def contenders(
    network: nn.Module,
    threshold: float,
    training: DeformationSet,
    cells: Sequence[int],
    nonlinear_cells: Sequence[int] = (),
) -> list[Contender]:
    """The network, and all that stands beside it in the table.

    Args:
        network: The network.
        threshold: Of the network and of the solve that it starts from.
        training: What is known already.
        cells: Of linear finite elements, along an edge; one rival each.
        nonlinear_cells: Of neo-Hookean ones likewise.

    Raises:
        TypeError: The network does not deform.
    """
    own = deforming(network)
    average = mean_shape(training.deformed)
    neighbours = NearestNeighbours(training.condition, training.deformed, NEIGHBOUR_SCALE)
    rivals = [
        Contender("nothing moves", lambda batch: (batch.rest[:, 0].numpy(), np.zeros_like(batch.displacement.numpy()))),
        Contender("mean training shape", lambda batch: (np.stack([average] * len(batch.condition)), None)),
        Contender("4 nearest conditions", lambda batch: (neighbours(batch.condition.numpy()), None)),
        *(Contender(f"linear FEM, {n}³", _finite_elements(LinearFem, n)) for n in cells),
        *(Contender(f"neo-Hookean FEM, {n}³", _finite_elements(NeoHookeanFem, n)) for n in nonlinear_cells),
        Contender("coarse solve alone", _coarse_solve, threshold, solves=True),
    ]

    def answer(batch: DeformationBatch) -> tuple[Occupancies, Displacements | None]:
        found = predict(own, batch)
        return found.probability, found.field

    solves = isinstance(own, DeformationNetwork) and own.config.prior
    return [*rivals, Contender("network", answer, threshold, solves)]


def compare(rivals: Sequence[Contender], samples: DeformationSet, rows: Int[np.ndarray, " n"]) -> list[Scores]:
    """Score each on the same samples, one at a time as a robot asks; ms is processor time from voxels to voxels."""
    return [_scores(rival, samples, rows) for rival in rivals]


def _scores(rival: Contender, samples: DeformationSet, rows: Int[np.ndarray, " n"]) -> Scores:
    scores, errors, curves, elapsed_s = [], [], [], 0.0
    for row in rows:
        batch = samples.batch(np.array([row]))
        started = time.process_time()
        if rival.solves:  # again: the set solves all loads on a body at once, and keeps the answers
            Priors(samples.rest, samples.body[row : row + 1], samples.condition[row : row + 1])(np.array([0]))
        probabilities, fields = rival.answer(batch)
        elapsed_s += time.process_time() - started
        probability = probabilities[0]
        rest, truth = batch.rest[0, 0].numpy() > 0.5, batch.deformed[0].numpy() > 0.5
        predicted = probability > rival.threshold
        overlaps = iou(predicted, truth), iou(probability > STRICT, truth)
        scores.append((*overlaps, changed_voxel_iou(predicted, truth, rest)))
        if fields is not None:
            errors.append(_errors(fields, batch))
        counts = uncertain(probability, truth)
        curves.append(calibration_curve(probability[counts], truth[counts]))
    overlap, strict, changed = np.array(scores).T
    of_field = dict(zip(ERRORS, np.array(errors).T, strict=False))
    ms = 1e3 * elapsed_s / len(rows)
    return Scores(rival.name, overlap, strict, changed, of_field, np.sum(curves, axis=0), ms)


def _errors(fields: Displacements, batch: DeformationBatch) -> tuple[float, float, float, float]:
    """Of one sample, see `ERRORS`; none of a body that has left the grid."""
    inside = batch.coverage[0, 0].numpy() > 0
    if not inside.any():
        return (np.nan,) * 4
    of_body = displacement_error(fields[0], batch.displacement[0].numpy(), inside)
    relative = float(relative_displacements(fields, batch)[0])
    return relative, of_body["p95_of_peak"], of_body["mean_voxels"], of_body["p95_voxels"]


def report(table: Sequence[Scores], samples: DeformationSet, rows: Int[np.ndarray, " n"]) -> dict[str, Any]:
    """Figures of all samples and of bands of them, and the worst ten of the last row of the table."""
    identity = samples.identity_iou[rows].astype(float)
    load, peak = samples.condition[rows, 6], samples.peak[rows]
    families = np.array(samples.family)[samples.body[rows]]
    along = {"log10 of the load number": load, "peak displacement, edges of the grid": peak}
    bands = {"all": np.ones(len(rows), bool)}
    for name, values in (("load number", load), ("peak displacement", peak)):
        third = np.argsort(np.argsort(values, kind="stable")) * 3 // len(values)
        bands |= {f"{name}: {part} third": third == i for i, part in enumerate(("lowest", "middle", "highest"))}
    bands |= {f"family: {family}": families == family for family in np.unique(families)}
    worst = np.argsort(table[-1].iou)[:WORST]
    return {
        "samples": len(rows),
        "identity": float(identity.mean()),
        "ms": {scores.name: scores.ms for scores in table},
        "bands": {
            band: {"samples": int(chosen.sum()), **{s.name: s.figures(identity, chosen) for s in table}}
            for band, chosen in bands.items()
            if chosen.any()
        },
        "curves": {name: _curve(values, table) for name, values in along.items()},
        "calibration": {scores.name: scores.calibration.tolist() for scores in table},
        "calibration_error": {scores.name: error_of_curve(scores.calibration) for scores in table},
        "worst": [
            {"row": int(rows[i]), "family": str(families[i]), "identity": float(identity[i]),
             "iou": float(table[-1].iou[i]), "log10_load_number": float(load[i])}
            for i in worst
        ],
    }  # fmt: skip


def _curve(values: Float[np.ndarray, " n"], table: Sequence[Scores]) -> list[dict[str, Any]]:
    """Mean IoU of every contender over tenths of the samples, from the least of these values to the largest."""
    tenths = [part for part in np.array_split(np.argsort(values, kind="stable"), TENTHS) if len(part)]
    return [
        {"middle": float(np.median(values[part])), "samples": len(part),
         "iou": {scores.name: float(scores.iou[part].mean()) for scores in table}}
        for part in tenths
    ]  # fmt: skip


def markdown(found: dict[str, Any]) -> str:
    """The report as tables."""
    names = list(found["ms"])
    lines = [
        "| | IoU | worst tenth below | IoU at 0.8 | skill | IoU of changed voxels | displacement error: mean, 95th "
        "percentile, of the peak | in voxels | calibration error | ms |",
        "|---" * 10 + "|",
    ]
    for name in names:
        row = found["bands"]["all"][name]
        shares, voxels = "", ""
        if ERRORS[0] in row:
            share, share_p95, mean, p95 = (row[key] for key in ERRORS)
            shares, voxels = f"{share:.1%}, {share_p95:.1%}", f"{mean:.2f}, {p95:.2f}"
        lines.append(
            f"| {name} | {row['iou']:.3f} | {row['iou_p10']:.3f} | {row['iou_at_0.8']:.3f} | {row['skill']:.3f} | "
            f"{row['iou_changed_voxels']:.3f} | {shares} | {voxels} | {found['calibration_error'][name]:.3f} | "
            f"{found['ms'][name]:.0f} |"
        )
    lines += ["", "| skill by band | samples | " + " | ".join(names) + " |", "|---" * (len(names) + 2) + "|"]
    for band, row in found["bands"].items():
        if band != "all":
            cells = " | ".join(f"{row[name]['skill']:.2f}" for name in names)
            lines.append(f"| {band} | {row['samples']} | {cells} |")
    lines += ["", "| the ten worst | where nothing moves | IoU | log10 of the load number |", "|---|---|---|---|"]
    lines += [
        f"| {row['family']} | {row['identity']:.3f} | {row['iou']:.3f} | {row['log10_load_number']:.2f} |"
        for row in found["worst"]
    ]
    return "\n".join(lines) + "\n"


def _coarse_solve(batch: DeformationBatch) -> tuple[Occupancies, Displacements]:
    """What the network starts from, uncorrected."""
    bodies = batch.rest[:, 0].numpy() > 0.5
    fields = batch.prior_backward.numpy()
    return np.stack([warp(body, field) for body, field in zip(bodies, fields, strict=True)]), fields


def _finite_elements(kind: type[LinearFem], cells: int) -> Answering:
    def answer(batch: DeformationBatch) -> tuple[Occupancies, None]:
        """The body as it was where the mesh is too coarse to hold it or to push it."""
        answers = []
        for rest, condition in zip(batch.rest[:, 0].numpy() > 0.5, batch.condition.numpy(), strict=True):
            try:
                answers.append(kind(rest, cells)(condition).deformed.astype(np.float32))
            except (BodyError, LoadError):
                answers.append(rest.astype(np.float32))
        return np.stack(answers), None

    return answer
