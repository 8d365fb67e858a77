from pathlib import Path

import torch

from tests.training import tiny
from training.networks.checkpoint import load_network
from training.networks.deformation import DeformationNetwork
from training.networks.reconstruction import ReconstructionNetwork


def test_the_network_of_a_checkpoint_answers_as_it_did(tmp_path: Path) -> None:
    network = tiny.deformation_network()
    loaded, state = load_network(tiny.save_checkpoint(network, tiny.FIT_DEFORMATION, tmp_path))
    assert isinstance(loaded, DeformationNetwork)
    assert not loaded.training
    assert loaded.config == tiny.DEFORMATION
    assert state["step"] == 7
    assert state["dataset"]["digest"] == "sha256:0"
    rest = torch.from_numpy(tiny.box(0)).float()[None, None]
    with torch.no_grad():
        expected, got = (n(rest, tiny.conditions(1), torch.ones(1, 3))[0] for n in (network, loaded))
    assert torch.equal(expected, got)


def test_the_kind_is_recognised(tmp_path: Path) -> None:
    network = tiny.reconstruction_network()
    loaded, _ = load_network(tiny.save_checkpoint(network, tiny.FIT_RECONSTRUCTION, tmp_path))
    assert isinstance(loaded, ReconstructionNetwork)
    assert loaded.config == tiny.RECONSTRUCTION
    view = torch.zeros(1, 2, 64, 64, 64)
    with torch.no_grad():
        assert torch.equal(network(view), loaded(view))
