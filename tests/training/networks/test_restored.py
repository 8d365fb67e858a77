"""A served graph goes back into a network that answers as it does and can be trained on."""

import copy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from tests.training import tiny
from training.data.batches import ViewSet
from training.export import export_model
from training.networks.blocks import PlaneBlock, Stem
from training.networks.reconstruction import ReconstructionNetwork
from training.networks.restored import WEIGHT_RMS, take_served_weights
from training.quantise import Graph, quantise


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tiny.write_views(tmp_path_factory.mktemp("views"))


@pytest.fixture(scope="module")
def views(folder: Path) -> torch.Tensor:
    return ViewSet.load(folder, "train").batch(np.arange(6)).view


@pytest.fixture(scope="module")
def trained(views: torch.Tensor) -> ReconstructionNetwork:
    """With normalisations that do something."""
    network = tiny.reconstruction_network().train()
    torch.nn.init.normal_(network.detail.weight, std=0.3)
    with torch.no_grad():
        for _ in range(30):
            network(views)
    return network.eval()


@pytest.fixture(scope="module")
def served(trained: ReconstructionNetwork, tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("served")
    checkpoint = tiny.save_checkpoint(trained, tiny.FIT_RECONSTRUCTION, root / "run")
    export_model(checkpoint, root, "tiny", "0.1.0", 0.45, {}, {"split": "test", "temperature": 1.25})
    return root / "tiny" / "0.1.0"


@torch.no_grad()
def test_it_answers_as_before_the_export(trained: ReconstructionNetwork, served: Path, views: torch.Tensor) -> None:
    network = ReconstructionNetwork(tiny.RECONSTRUCTION)
    account = take_served_weights(network, served, [views[:3], views[3:]])
    assert account == "tiny 0.1.0 as it is served, of run run"
    expected = trained(views)
    assert expected.std() > 0.1
    torch.testing.assert_close(network(views), expected, atol=1e-4, rtol=1e-4)


@torch.no_grad()
def test_normalising_by_the_batch_changes_nothing(served: Path, views: torch.Tensor) -> None:
    """A network whose kept moments were not those of its data would jump at the first step of training."""
    network = ReconstructionNetwork(tiny.RECONSTRUCTION)
    take_served_weights(network, served, [views])
    expected = network(views)
    answered = copy.deepcopy(network).train()(views)
    torch.testing.assert_close(answered, expected, atol=1e-3, rtol=1e-3)


def test_weights_are_as_large_as_those_of_a_long_training(served: Path, views: torch.Tensor) -> None:
    network = ReconstructionNetwork(tiny.RECONSTRUCTION)
    take_served_weights(network, served, [views])
    convolutions = [m.conv.weight for m in network.modules() if isinstance(m, PlaneBlock | Stem)]
    assert convolutions
    for weight in convolutions:
        assert weight.square().mean().sqrt().item() == pytest.approx(WEIGHT_RMS, rel=1e-3)


@torch.no_grad()
def test_integers_come_back_but_for_their_rounding(folder: Path, served: Path, views: torch.Tensor) -> None:
    exact, network = ReconstructionNetwork(tiny.RECONSTRUCTION), ReconstructionNetwork(tiny.RECONSTRUCTION)
    take_served_weights(exact, served, [views])
    quantise(served, folder)
    take_served_weights(network, served, [views])
    assert not torch.equal(network.seen.weight, exact.seen.weight)
    products = [name for name, parameter in exact.named_parameters() if parameter.ndim > 1]
    for name in products:
        one, other = network.get_parameter(name), exact.get_parameter(name)
        assert (one - other).abs().max() <= 0.02 * other.abs().max()
    graph = 1.25 * Graph(served / "model.onnx")(views)
    assert (network(views) - graph).abs().mean() < 0.1 * graph.std()


def test_a_model_of_another_shape_is_refused(served: Path, views: torch.Tensor) -> None:
    network = ReconstructionNetwork(replace(tiny.RECONSTRUCTION, detail=3))
    with pytest.raises(ValueError, match="no reconstruction network of this configuration"):
        take_served_weights(network, served, [views])


def test_a_deformation_model_is_refused() -> None:
    shipped = next((Path(__file__).parents[3] / "models" / "deformation-realtime").iterdir())
    with pytest.raises(ValueError, match="no reconstruction network of this configuration"):
        take_served_weights(ReconstructionNetwork(tiny.RECONSTRUCTION), shipped, [])
