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
    from matplotlib.ticker import LogLocator, NullFormatter, ScalarFormatter
except ModuleNotFoundError as missing:  # pragma: no cover
    raise ModuleNotFoundError("Pictures need matplotlib: pip install 'physnet[pictures]'") from missing

SHOWN = ("nothing moves", "coarse solve alone", "network")
"""Lines of the curves, beside the finest finite elements of each law."""

LAWS = ("linear FEM", "neo-Hookean FEM")

IN_A_ROW = 5
"""Pictures of the worst answers beside each other."""

ENOUGH = 100
"""Voxels that a bin of probabilities must hold for its share to be shown."""


def curves(found: dict[str, Any]) -> bytes:
    """IoU against load number and peak displacement, and how often voxels of a probability are filled, as an SVG.

    Args:
        found: See `comparison.report`.
    """
    figure = Figure(figsize=(11, 3.7), layout="constrained")
    axes = figure.subplots(1, 3)
    names = [name for name in found["ms"] if name in SHOWN]
    names += [elements[-1] for law in LAWS if (elements := _of_law(found, law))]
    colours = {name: f"C{number}" for number, name in enumerate(names)}
    for axis, (label, parts) in zip(axes, found["curves"].items(), strict=False):
        middles = [part["middle"] for part in parts]
        for name in names:
            axis.plot(middles, [part["iou"][name] for part in parts], marker=".", label=name, color=colours[name])
        axis.set(xlabel=label, ylabel="IoU, mean of a tenth of the samples")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=len(names), frameon=False)
    for name in ("coarse solve alone", "network"):
        voxels, said, true = np.array(found["calibration"][name])
        full = voxels >= ENOUGH
        shares = said[full] / voxels[full], true[full] / voxels[full]
        axes[2].plot(*shares, marker=".", color=colours[name])
    axes[2].plot([0, 1], [0, 1], color="0.7", linewidth=0.8)
    axes[2].set(xlabel="probability of a voxel", ylabel="share of them that is filled")
    return _svg(figure)


def frontier(found: dict[str, Any]) -> bytes:
    """IoU against processor time of finite elements of all sizes, the coarse solve and the network, as an SVG.

    Args:
        found: See `comparison.report`.
    """
    figure = Figure(figsize=(6, 4), layout="constrained")
    axes = figure.subplots()
    ms, iou = found["ms"], {name: row["iou"] for name, row in found["bands"]["all"].items() if name != "samples"}
    for law in LAWS:
        names = _of_law(found, law)
        axes.plot([ms[name] for name in names], [iou[name] for name in names], marker=".", label=law)
        for name in names:
            axes.annotate(name.split(", ")[1], (ms[name], iou[name]), (0, -12), textcoords="offset points", fontsize=8)
    for name in ("coarse solve alone", "network"):
        axes.plot(ms[name], iou[name], "*", markersize=11, label=name)
    axes.set(xscale="log", xlabel="processor time of an answer, ms", ylabel=f"IoU, mean of {found['samples']} samples")
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter(ScalarFormatter())
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.legend(frameon=False, fontsize="small")
    return _svg(figure)


def _of_law(found: dict[str, Any], law: str) -> list[str]:
    """Finite elements of a law, coarse to fine."""
    return [name for name in found["ms"] if name.startswith(law)]


def _svg(figure: Figure) -> bytes:
    target = io.BytesIO()
    figure.savefig(target, format="svg", metadata={"Date": None})
    return target.getvalue()


def worst(found: dict[str, Any], rival: Contender, samples: DeformationSet) -> bytes:
    """The worst answers as a PNG, five to a row: the body at rest behind the true answer, below it the given one."""
    truths, answers = [], []
    for row in found["worst"]:
        batch = samples.batch(np.array([row["row"]]))
        rest, truth = batch.rest[0, 0].numpy() > 0.5, batch.deformed[0].numpy() > 0.5
        answer = rival.answer(batch)[0][0] > rival.threshold
        truths.append(captioned(draw([(rest, REST), (truth, DEFORMED)]), row["family"], "true"))
        answers.append(captioned(draw([(rest, REST), (answer, DEFORMED)]), rival.name, f"IoU {row['iou']:.2f}"))
    columns = min(IN_A_ROW, len(truths))
    missing = [np.full_like(truths[0], 255)] * (-len(truths) % columns)
    pairs = [(truths + missing)[i : i + columns] + (answers + missing)[i : i + columns]
             for i in range(0, len(truths), columns)]  # fmt: skip
    return cv2.imencode(".png", arranged([tile for pair in pairs for tile in pair], columns))[1].tobytes()
