"""The comparison as pictures: accuracy against load and displacement, calibration, and the worst answers."""

from __future__ import annotations

import io
from typing import Any

import cv2
import numpy as np

from training.comparison import Contender
from training.data.batches import DeformationSet
from training.data.contact_sheet import DEFORMED, REST, arranged, captioned, draw

try:
    from matplotlib.figure import Figure
except ModuleNotFoundError as missing:  # pragma: no cover
    raise ModuleNotFoundError("Pictures need matplotlib: pip install 'physnet[pictures]'") from missing

SHOWN = ("nothing moves", "coarse solve alone", "network")
"""Lines of the curves, beside the finest of the finite elements."""

ENOUGH = 100
"""Voxels that a bin of probabilities must hold for its share to be shown."""


def curves(found: dict[str, Any]) -> bytes:
    """IoU against load number and peak displacement, and how often voxels of a probability are filled, as an SVG.

    Args:
        found: See `comparison.report`.
    """
    figure = Figure(figsize=(11, 3.4), layout="constrained")
    axes = figure.subplots(1, 3)
    names = [name for name in found["ms"] if name in SHOWN]
    elements = [name for name in found["ms"] if name.startswith("linear FEM")]
    for axis, (label, parts) in zip(axes, found["curves"].items(), strict=False):
        for name in [*names, *elements[-1:]]:
            axis.plot([part["middle"] for part in parts], [part["iou"][name] for part in parts], marker=".", label=name)
        axis.set(xlabel=label, ylabel="IoU, mean of a tenth of the samples")
    axes[0].legend(frameon=False, fontsize="small")
    for name in ("coarse solve alone", "network"):
        voxels, said, true = np.array(found["calibration"][name])
        full = voxels >= ENOUGH
        axes[2].plot(said[full] / voxels[full], true[full] / voxels[full], marker=".", label=name)
    axes[2].plot([0, 1], [0, 1], color="0.7", linewidth=0.8)
    axes[2].set(xlabel="probability of a voxel", ylabel="share of them that is filled")
    axes[2].legend(frameon=False, fontsize="small")
    target = io.BytesIO()
    figure.savefig(target, format="svg", metadata={"Date": None})
    return target.getvalue()


def worst(found: dict[str, Any], rival: Contender, samples: DeformationSet) -> bytes:
    """The worst answers as a PNG: above the body at rest behind the true answer, below behind the given one."""
    truths, answers = [], []
    for row in found["worst"]:
        batch = samples.batch(np.array([row["row"]]))
        rest, truth = batch.rest[0, 0].numpy() > 0.5, batch.deformed[0].numpy() > 0.5
        answer = rival.answer(batch)[0] > rival.threshold
        truths.append(captioned(draw([(rest, REST), (truth, DEFORMED)]), row["family"], "true"))
        answers.append(captioned(draw([(rest, REST), (answer, DEFORMED)]), rival.name, f"IoU {row['iou']:.2f}"))
    return cv2.imencode(".png", arranged([*truths, *answers], columns=len(truths)))[1].tobytes()
