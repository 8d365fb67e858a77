import copy
import json
import shutil
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest
import torch
from torch import nn

from service.core.condition import CONDITION_FIELDS
from service.core.errors import ModelMismatch
from service.core.manifest import Manifest
from service.inference.artefacts import read_manifest
from service.inference.graph import Graph
from service.inference.session import open_sessions
from tests.training import tiny
from training import export
from training.export import PARITY_TOLERANCE, ExportError, Part, condition_range_of, export_model

RANGES = {field: (-1.0, 1.0) for field in CONDITION_FIELDS}
FIGURES = {"split": "test", "samples": 4, "iou": 0.875}


def exported(kind: str, root: Path) -> tuple[Path, Manifest]:
    if kind == "deformation":
        checkpoint = tiny.save_checkpoint(tiny.deformation_network(), tiny.FIT_DEFORMATION, root / "runs" / "tiny-a")
    else:
        checkpoint = tiny.save_checkpoint(
            tiny.reconstruction_network(), tiny.FIT_RECONSTRUCTION, root / "runs" / "tiny-a"
        )
    manifest = export_model(
        checkpoint, root / "models", f"{kind}-tiny", "0.1.0", 0.45, RANGES if kind == "deformation" else {}, FIGURES
    )
    return root / "models" / f"{kind}-tiny" / "0.1.0", manifest


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[Path, Manifest]]:
    return {kind: exported(kind, tmp_path_factory.mktemp(kind)) for kind in ("deformation", "reconstruction")}


@pytest.mark.parametrize("kind", ["deformation", "reconstruction"])
def test_the_service_reads_what_was_exported(kind: str, folders: dict[str, tuple[Path, Manifest]]) -> None:
    folder, manifest = folders[kind]
    assert read_manifest(folder) == manifest
    assert (manifest.kind, manifest.name, manifest.version) == (kind, f"{kind}-tiny", "0.1.0")
    assert manifest.run == "tiny-a"
    assert manifest.threshold == 0.45
    assert manifest.dataset == tiny.DATASET
    assert manifest.evaluation == FIGURES
    assert manifest.parity < 1e-4
    field, value = ("condition", 8) if kind == "deformation" else ("channels", [4, 4, 4, 4])
    assert manifest.configuration["network"][field] == value
    graphs = {"encoder.onnx", "generator.onnx"} if kind == "deformation" else {"model.onnx"}
    assert {path.name for path in folder.iterdir()} == {*graphs, "manifest.json", "CARD.md"}
    open_sessions(folder, manifest, [1] * len(manifest.graphs))  # tensors are those of the manifest, or this raises


def test_a_graph_is_one_file_of_standard_operators(folders: dict[str, tuple[Path, Manifest]]) -> None:
    for path in [folder / graph for folder, manifest in folders.values() for graph in manifest.graphs]:
        graph = onnx.load(str(path), load_external_data=False)
        assert {node.domain for node in graph.graph.node} <= {"", "ai.onnx"}
        assert all(tensor.data_location == onnx.TensorProto.DEFAULT for tensor in graph.graph.initializer)
        # Batch normalisation is folded into the convolutions.
        assert "BatchNormalization" not in {node.op_type for node in graph.graph.node}


def test_the_graphs_answer_for_any_number_of_loads_as_torch_does(folders: dict[str, tuple[Path, Manifest]]) -> None:
    folder, manifest = folders["deformation"]
    graph = Graph(open_sessions(folder, manifest, [1] * len(manifest.graphs)), manifest)
    network = tiny.deformation_network()
    rest = torch.from_numpy(tiny.box(2)).float()[None, None]
    for loads in (1, 2, 5):
        condition, noise, prior = tiny.conditions(loads), torch.ones(loads, 3), tiny.priors(loads)
        with torch.no_grad():
            expected = network(rest, condition, noise, prior)[0].numpy()
        given = {"rest": rest, "condition": condition, "noise": noise, "prior": prior}
        (correction,) = graph.run({name: tensor.numpy() for name, tensor in given.items()}).values()
        assert np.abs(expected).max() > 1e-3
        np.testing.assert_allclose(correction, expected, atol=1e-5)


def test_the_graph_gives_probabilities_not_logits(folders: dict[str, tuple[Path, Manifest]]) -> None:
    folder, _ = folders["reconstruction"]
    session = onnxruntime.InferenceSession(str(folder / "model.onnx"), providers=["CPUExecutionProvider"])
    view = torch.zeros(1, 2, 64, 64, 64)
    view[0, 0, 20:30, 20:30, :20] = 1.0
    (probability,) = session.run(["probability"], {"view": view.numpy()})
    with torch.no_grad():
        expected = torch.sigmoid(tiny.reconstruction_network()(view)).numpy()
    np.testing.assert_allclose(probability, expected, atol=1e-5)


@pytest.mark.parametrize("kind", ["deformation", "reconstruction"])
def test_a_graph_that_differs_from_torch_is_not_written(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write = export._write_onnx

    def write_another(part: Part, folder: Path) -> None:
        other = copy.deepcopy(part)
        for name, parameter in other.graph.named_parameters():
            if name.endswith(("head.0.bias", "generator.own.bias", "encoder.latent.bias")):
                torch.nn.init.constant_(parameter, 0.5)
        write(other, folder)

    monkeypatch.setattr(export, "_write_onnx", write_another)
    with pytest.raises(ExportError, match=r"differ by .* \(at most 1e-04\); not written"):
        exported(kind, tmp_path)
    assert PARITY_TOLERANCE == 1e-4
    assert not [path for path in (tmp_path / "models").rglob("*") if path.is_file()]


def test_a_changed_byte_is_refused(folders: dict[str, tuple[Path, Manifest]], tmp_path: Path) -> None:
    folder = tmp_path / "model"
    shutil.copytree(folders["reconstruction"][0], folder)
    content = bytearray((folder / "model.onnx").read_bytes())
    content[len(content) // 2] ^= 1
    (folder / "model.onnx").write_bytes(content)
    with pytest.raises(ModelMismatch, match="is not the file that was exported"):
        read_manifest(folder)


@pytest.mark.parametrize(("field", "name"), [("grid_contract", "grid"), ("condition_contract", "condition")])
def test_another_contract_is_refused(
    field: str, name: str, folders: dict[str, tuple[Path, Manifest]], tmp_path: Path
) -> None:
    folder = tmp_path / "model"
    shutil.copytree(folders["deformation"][0], folder)
    document = json.loads((folder / "manifest.json").read_text())
    (folder / "manifest.json").write_text(json.dumps({**document, field: "0"}))
    with pytest.raises(ModelMismatch, match=f"{name} contract is 0"):
        read_manifest(folder)


def test_the_card_tells_data_network_and_figures(folders: dict[str, tuple[Path, Manifest]]) -> None:
    folder, manifest = folders["deformation"]
    card = (folder / "CARD.md").read_text()
    for part in ("# deformation-tiny 0.1.0", "| iou | 0.8750 |", "threshold: 0.45", "run `tiny-a`", manifest.commit,
                 "12 samples in 6 groups, `sha256:0`", '"latent": 3'):  # fmt: skip
        assert part in card


def test_ranges_are_those_of_the_training_set_and_of_its_mirror_images() -> None:
    conditions = np.array(
        [[0.3, 0.4, 0.10004, 0.6, 0, -0.8, -3.21456, 0, 0.08], [0.5, 0.6, 0.7, 0, 1, 0, -1.5, 0.49, 0.2]], np.float32
    )
    ranges = condition_range_of(conditions)
    assert ranges["contact_x"] == ranges["contact_y"] == (0.0, 1.0)
    assert ranges["direction_z"] == (-1.0, 1.0)
    # A hundredth of 0.6 and of 1.71456 wider on either side.
    assert ranges["contact_z"] == pytest.approx((0.094, 0.706), abs=1e-4)
    assert ranges["log10_load_number"] == pytest.approx((-3.2317, -1.4829), abs=1e-4)
    # Every condition of the set lies within.
    for column, field in enumerate(CONDITION_FIELDS):
        assert ranges[field][0] <= conditions[:, column].min()
        assert conditions[:, column].max() <= ranges[field][1]


def test_only_the_two_networks_are_exported() -> None:
    with pytest.raises(ExportError, match="no served graph for a Linear"):
        export._parts(nn.Linear(1, 1))
