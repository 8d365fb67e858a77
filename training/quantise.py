"""An exported reconstruction graph in whole numbers of eight bits: half the time, and refused if it says less.

Weights and activations become integers times a scale (a channel of a weight has its own), which CPUs multiply four at
a time. The scales of activations come from training views, and what the graph is worth after that from views it was
never shown.
"""

from __future__ import annotations

import contextlib
import json
import logging
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime
import torch
from jaxtyping import Float
from onnxruntime.quantization import CalibrationDataReader, CalibrationMethod, QuantFormat, QuantType, quantize_static
from onnxruntime.quantization.shape_inference import quant_pre_process
from torch import Tensor

from service.core.manifest import Manifest
from training.data.batches import ViewSet, spread_rows
from training.evaluate import evaluate_reconstruction
from training.export import ExportError, write_manifest
from training.metrics import iou

CALIBRATION_VIEWS = 30
CALIBRATION_PERCENTILE = 99.999
"""Of each activation: with scales by the extremes, 0.004 of IoU were lost where these lose nothing."""
CHECKED_VIEWS = 160
LARGEST_LOSS = 0.005
"""Of the IoU on validation views."""


class Graph:
    """An exported reconstruction graph on one thread; answers as a network of torch would."""

    def __init__(self, path: Path) -> None:
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        self._session = onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])

    def __call__(self, view: Float[Tensor, "batch 2 64 64 64"]) -> Float[Tensor, "batch 64 64 64"]:
        """Logit of every voxel."""
        answers = [self._session.run(["probability"], {"view": one[None].numpy()})[0] for one in view]
        return torch.logit(torch.from_numpy(np.concatenate(answers)), eps=1e-7)


def quantise(folder: Path, data: Path) -> Manifest:
    """Put an exported reconstruction model into 8-bit integers, in its own folder, and score it anew.

    Args:
        folder: `models/<name>/<version>`, as `export_model` wrote it: its graph was held to torch's answers there.
        data: The `views` set; scales from its training split, the check on validation, the figures on test.

    Raises:
        ExportError: It is no reconstruction model in floats, or loses more than 0.005 of IoU on validation; the folder
            stays as it is.
    """
    manifest = Manifest.from_json(json.loads((folder / "manifest.json").read_text()))
    if manifest.kind != "reconstruction" or "arithmetic" in manifest.evaluation:
        raise ExportError(f"{folder} holds no reconstruction network in floating point")
    graph = folder / manifest.graph
    training, validation = ViewSet.load(data, "train"), ViewSet.load(data, "validation")
    with tempfile.TemporaryDirectory(dir=folder) as scratch:
        candidate = Path(scratch) / "model.onnx"
        write_integers(graph, candidate, training)
        before, after = (mean_iou(Graph(path), validation, manifest.threshold) for path in (graph, candidate))
        if before - after > LARGEST_LOSS:
            raise ExportError(
                f"in 8-bit integers the validation IoU falls from {before:.4f} to {after:.4f} "
                f"(by {LARGEST_LOSS} at most); the graph stays in floating point"
            )
        figures = evaluate_reconstruction(Graph(candidate), ViewSet.load(data, "test"), manifest.threshold)
        candidate.replace(graph)
    told = manifest.evaluation
    evaluation: dict[str, Any] = {
        **{key: told[key] for key in ("split", "temperature") if key in told}, **figures,
        "arithmetic": "8-bit integers", "validation_iou_in_floats": before,
        "validation_iou_in_integers": after,
    }  # fmt: skip
    return write_manifest(folder, replace(manifest, evaluation=evaluation))


def write_integers(graph: Path, path: Path, views: ViewSet, count: int = CALIBRATION_VIEWS) -> None:
    """The graph with quantised operators, scales by an evenly spread part of the views.

    Weights get seven bits of the eight: pairs of products then fit sixteen, in which older CPUs add them up.
    """
    with tempfile.TemporaryDirectory() as scratch, _quiet(), contextlib.redirect_stdout(sys.stderr):
        prepared = Path(scratch) / "prepared.onnx"
        quant_pre_process(str(graph), str(prepared), skip_symbolic_shape=True)
        left = _last_products(onnx.load(str(prepared)).graph)
        quantize_static(
            str(prepared), str(path), _Views(views, count), quant_format=QuantFormat.QDQ, per_channel=True,
            reduce_range=True, activation_type=QuantType.QUInt8, weight_type=QuantType.QInt8,
            calibrate_method=CalibrationMethod.Percentile, nodes_to_exclude=left,
            extra_options={
                "WeightSymmetric": True, "ForceQuantizeNoInputCheck": True, "CalibPercentile": CALIBRATION_PERCENTILE,
            },
        )  # fmt: skip


def _last_products(graph: onnx.GraphProto) -> list[str]:
    """Names of the products that the answer is the sum of, and of all that follows them.

    They stay in floats: logits span so much that a 256th of it moves the surface, and these are not faster in integers.
    """
    makers = {output: node for node in graph.node for output in node.output}
    asked, names = [graph.output[0].name], []
    while asked:
        node = makers.get(asked.pop())
        if node is not None and node.name not in names:
            names.append(node.name)
            asked += [] if node.op_type in ("MatMul", "Gemm", "Conv") else list(node.input)
    return names


def mean_iou(graph: Graph, views: ViewSet, threshold: float, count: int = CHECKED_VIEWS) -> float:
    """Over an evenly spread part of the views; free space overrules the graph, as in the service."""
    scores = []
    for row in spread_rows(len(views), count):
        batch = views.batch(np.array([row]))
        filled = (torch.sigmoid(graph(batch.view)) > threshold) & (batch.view[:, 1] < 0.5)
        scores.append(iou(filled.numpy(), batch.truth.numpy() > 0.5))
    return float(np.mean(scores))


class _Views(CalibrationDataReader):  # type: ignore[misc]
    """Inputs one by one, as the quantiser asks for them."""

    def __init__(self, views: ViewSet, count: int) -> None:
        self._left: Iterator[int] = iter(spread_rows(len(views), count).tolist())
        self._views = views

    def get_next(self) -> dict[str, np.ndarray] | None:
        row = next(self._left, None)
        return None if row is None else {"view": self._views.batch(np.array([row])).view.numpy()}


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """The quantiser recommends its own preparation after it was made."""
    root = logging.getLogger()
    level = root.level
    root.setLevel(logging.ERROR)
    try:
        yield
    finally:
        root.setLevel(level)
