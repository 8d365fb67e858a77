"""A larger network that begins as a smaller one answers as it does, and learns beyond it."""

import dataclasses

import torch

from tests.training import tiny
from training.networks.growth import grow
from training.networks.reconstruction import ReconstructionConfig, ReconstructionNetwork

LARGER = ReconstructionConfig(
    channels=tuple(width + 4 * (i + 1) for i, width in enumerate(tiny.RECONSTRUCTION.channels)),  # type: ignore[arg-type]
    blocks=tuple(number + 2 for number in tiny.RECONSTRUCTION.blocks),  # type: ignore[arg-type]
    detail=tiny.RECONSTRUCTION.detail + 3,
)


def trained() -> ReconstructionNetwork:
    """Every part of it counts."""
    network = tiny.reconstruction_network()
    torch.nn.init.normal_(network.detail.weight, std=0.3)
    torch.nn.init.normal_(network.local.block.norm.weight)
    return network


def views() -> torch.Tensor:
    return torch.rand(2, 2, 64, 64, 64, generator=torch.Generator().manual_seed(3)).round()


@torch.no_grad()
def test_wider_and_deeper_it_answers_alike() -> None:
    network = trained()
    larger = ReconstructionNetwork(LARGER).eval()
    taken = grow(larger, network.state_dict())
    assert set(taken) == set(network.state_dict())
    expected = network(views())
    assert expected.std() > 0.1
    torch.testing.assert_close(larger(views()), expected, atol=1e-5, rtol=1e-5)


def test_what_is_new_can_be_learned() -> None:
    """Where nothing new reached the answer a gradient would never wake it."""
    torch.manual_seed(1)
    larger = ReconstructionNetwork(LARGER)
    grow(larger, trained().state_dict())
    before = {name: weight.detach().clone() for name, weight in larger.named_parameters()}
    optimizer = torch.optim.SGD(larger.parameters(), lr=1.0)
    for _ in range(2):  # the first step gives new blocks a scale, the second moves what they weigh
        optimizer.zero_grad()
        torch.autograd.backward((larger.train()(views()) ** 2).mean())
        optimizer.step()
    still = [name for name, weight in larger.named_parameters() if torch.equal(weight, before[name])]
    assert not still


def test_a_smaller_network_takes_nothing_of_what_is_larger() -> None:
    network = ReconstructionNetwork(tiny.RECONSTRUCTION)
    own = network.detail.weight.clone()
    larger = ReconstructionNetwork(dataclasses.replace(tiny.RECONSTRUCTION, detail=tiny.RECONSTRUCTION.detail + 1))
    assert "detail.weight" not in grow(network, larger.state_dict())
    assert torch.equal(network.detail.weight, own)
