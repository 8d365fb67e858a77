import dataclasses
from pathlib import Path

import pytest
import torch

from tests.training import tiny
from training.networks.build import build_saved
from training.networks.checkpoint import load_network, take_weights
from training.networks.deformation import DeformationNetwork
from training.networks.physnet import PhysNet
from training.networks.recgan import RecGan
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
        expected, got = (n(rest, tiny.conditions(1), torch.ones(1, 3), tiny.priors(1))[0] for n in (network, loaded))
    assert torch.equal(expected, got)


def test_the_kind_is_recognised(tmp_path: Path) -> None:
    network = tiny.reconstruction_network()
    loaded, _ = load_network(tiny.save_checkpoint(network, tiny.FIT_RECONSTRUCTION, tmp_path))
    assert isinstance(loaded, ReconstructionNetwork)
    assert loaded.config == tiny.RECONSTRUCTION
    view = torch.zeros(1, 2, 64, 64, 64)
    with torch.no_grad():
        assert torch.equal(network(view), loaded(view))


def test_the_papers_networks_come_back_with_their_encoding(tmp_path: Path) -> None:
    network = PhysNet(tiny.PHYSNET)
    config = dataclasses.replace(tiny.FIT_DEFORMATION, network=tiny.PHYSNET)
    loaded, _ = load_network(tiny.save_checkpoint(network, config, tmp_path / "physnet"))
    assert isinstance(loaded, PhysNet)
    assert loaded.config == tiny.PHYSNET
    config = dataclasses.replace(tiny.FIT_RECONSTRUCTION, network=tiny.RECGAN)
    loaded, _ = load_network(tiny.save_checkpoint(RecGan(tiny.RECGAN), config, tmp_path / "recgan"))
    assert isinstance(loaded, RecGan)
    assert loaded.config == tiny.RECGAN


def test_weights_are_taken_where_they_fit(tmp_path: Path) -> None:
    """A head of another width stays as it was; the account names run, step, data and how much was taken."""
    checkpoint = tiny.save_checkpoint(tiny.reconstruction_network(), tiny.FIT_RECONSTRUCTION, tmp_path / "first")
    torch.manual_seed(5)
    wider = ReconstructionNetwork(dataclasses.replace(tiny.RECONSTRUCTION, detail=7))
    before, source = wider.detail.weight.clone(), torch.load(checkpoint, weights_only=True)["network"]
    account = take_weights(wider, checkpoint)
    own = wider.state_dict()
    taken = [name for name in own if source[name].shape == own[name].shape]
    assert all(torch.equal(own[name], source[name]) for name in taken)
    assert torch.equal(wider.detail.weight, before)
    assert account == f"first at step 7, trained on sha256:0: {len(taken)} of {len(own)} tensors"
    assert 0 < len(taken) < len(own)


def test_a_deeper_network_begins_with_what_the_shallower_one_knew(tmp_path: Path) -> None:
    known = tiny.reconstruction_network()
    checkpoint = tiny.save_checkpoint(known, tiny.FIT_RECONSTRUCTION, tmp_path / "first")
    blocks = tuple(count + 2 for count in tiny.RECONSTRUCTION.blocks)
    deeper = ReconstructionNetwork(dataclasses.replace(tiny.RECONSTRUCTION, blocks=blocks, silent=True))
    take_weights(deeper, checkpoint)
    assert len(deeper.state_dict()) > len(known.state_dict())
    view = torch.rand(1, 2, 64, 64, 64, generator=torch.Generator().manual_seed(1)).round()
    with torch.no_grad():
        torch.testing.assert_close(deeper.eval()(view), known.eval()(view))


def test_weights_of_another_kind_are_refused(tmp_path: Path) -> None:
    checkpoint = tiny.save_checkpoint(tiny.deformation_network(), tiny.FIT_DEFORMATION, tmp_path)
    with pytest.raises(ValueError, match=r"no weight of .*checkpoint\.pt fits this network"):
        take_weights(torch.nn.Linear(2, 2), checkpoint)


def test_a_configuration_of_no_network_is_named() -> None:
    with pytest.raises(ValueError, match="no network has a configuration of layers, width"):
        build_saved({"layers": 3, "width": 8})
