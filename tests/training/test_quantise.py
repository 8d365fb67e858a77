"""Graphs in whole numbers: what they answer, what their manifest says, and when they are refused."""

import shutil
from pathlib import Path

import numpy as np
import onnx
import pytest
import torch

from service.inference.artefacts import read_manifest
from service.inference.session import open_sessions
from tests.training import tiny
from training import quantise as module
from training.data.batches import ViewSet
from training.export import ExportError, export_model
from training.quantise import Graph, mean_iou, quantise


@pytest.fixture(scope="module")
def views(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tiny.write_views(tmp_path_factory.mktemp("views"))


@pytest.fixture(scope="module")
def floats(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("floats")
    network = tiny.reconstruction_network()
    torch.nn.init.normal_(network.detail.weight, std=0.3)
    checkpoint = tiny.save_checkpoint(network, tiny.FIT_RECONSTRUCTION, root / "run")
    export_model(checkpoint, root, "tiny", "0.1.0", 0.45, {}, {"split": "test", "temperature": 1.25})
    return root / "tiny" / "0.1.0"


@pytest.fixture(scope="module")
def integers(floats: Path, views: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("integers") / "0.1.0"
    shutil.copytree(floats, folder)
    quantise(folder, views)
    return folder


def test_it_answers_nearly_as_the_graph_in_floats(floats: Path, integers: Path, views: Path) -> None:
    view = ViewSet.load(views, "test").batch(np.arange(4)).view
    exact, rounded = (torch.sigmoid(Graph(folder / "model.onnx")(view)) for folder in (floats, integers))
    assert exact.std() > 0.05
    assert (exact - rounded).abs().mean() < 0.02
    assert not torch.equal(exact, rounded)


def test_products_are_of_integers_that_no_processor_overflows(integers: Path) -> None:
    """Standard operators; weights of all but the last products are integers of seven bits."""
    graph = onnx.load(str(integers / "model.onnx")).graph
    assert {node.domain for node in graph.node} <= {"", "ai.onnx"}
    made_by = {output: node.op_type for node in graph.node for output in node.output}
    products = [node for node in graph.node if node.op_type in ("Conv", "MatMul", "Gemm")]
    assert products
    rounded = [{made_by.get(name) for name in node.input[:2]} == {"DequantizeLinear"} for node in products]
    assert sum(rounded) >= len(products) - 2  # the two that the answer is the sum of stay in floats
    weights = [onnx.numpy_helper.to_array(tensor) for tensor in graph.initializer]
    small = [weight for weight in weights if weight.dtype == np.int8 and weight.ndim > 1]
    assert len(small) >= len(products) // 2
    assert max(int(np.abs(weight.astype(int)).max()) for weight in small) <= 64


def test_the_manifest_says_so_and_the_service_opens_it(integers: Path, floats: Path, views: Path) -> None:
    manifest, before = read_manifest(integers), read_manifest(floats)
    assert manifest.evaluation["arithmetic"] == "8-bit integers"
    assert (manifest.evaluation["split"], manifest.evaluation["temperature"]) == ("test", 1.25)
    assert manifest.evaluation["samples"] == 4
    told = manifest.evaluation["validation_iou_in_integers"]
    assert told == mean_iou(Graph(integers / "model.onnx"), ViewSet.load(views, "validation"), 0.45)
    assert "8-bit integers" in (integers / "CARD.md").read_text()
    assert (manifest.parity, manifest.threshold, manifest.dataset) == (before.parity, 0.45, before.dataset)
    assert {path.name for path in integers.iterdir()} == {"model.onnx", "manifest.json", "CARD.md"}
    open_sessions(integers, manifest, threads=[1])


def test_a_graph_that_loses_too_much_is_refused(
    floats: Path, views: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scores = iter([0.800, 0.794])
    monkeypatch.setattr(module, "mean_iou", lambda *_: next(scores))
    folder = tmp_path / "model"
    shutil.copytree(floats, folder)
    with pytest.raises(ExportError, match=r"falls from 0.8000 to 0.7940 \(by 0.005 at most\)"):
        quantise(folder, views)
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == {
        path.name: path.read_bytes() for path in floats.iterdir()
    }


def test_integers_are_not_rounded_again(integers: Path, views: Path) -> None:
    with pytest.raises(ExportError, match="holds no reconstruction network in floating point"):
        quantise(integers, views)
