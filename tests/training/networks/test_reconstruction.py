import torch

from tests.training import tiny
from training.networks.reconstruction import ReconstructionConfig, ReconstructionNetwork


def test_a_logit_for_every_voxel() -> None:
    network = tiny.reconstruction_network()
    view = torch.zeros(2, 2, 64, 64, 64)
    assert network(view).shape == (2, 64, 64, 64)


def test_views_of_a_batch_do_not_know_of_each_other() -> None:
    network = tiny.reconstruction_network()
    view = torch.rand(2, 2, 64, 64, 64, generator=torch.Generator().manual_seed(1)).round()
    with torch.no_grad():
        together, alone = network(view), torch.cat([network(view[:1]), network(view[1:])])
    torch.testing.assert_close(together, alone, atol=1e-5, rtol=1e-5)


def test_observed_and_free_are_told_apart() -> None:
    network = tiny.reconstruction_network()
    view = torch.zeros(1, 2, 64, 64, 64)
    view[0, 0, 20:40, 20:40, 0:30] = 1.0
    with torch.no_grad():
        assert (network(view) - network(view.flip(1))).abs().max() > 1e-3


def test_a_column_of_voxels_speaks_of_its_own_place() -> None:
    """Fine features pass by the coarse ones: of a random network the answer differs most where the view does."""
    network = tiny.reconstruction_network()
    empty = torch.zeros(1, 2, 64, 64, 64)
    dot = empty.clone()
    dot[0, 0, 8:12, 40:44, 20:24] = 1.0
    with torch.no_grad():
        change = (network(dot) - network(empty))[0].abs()
    column = change[8:12, 40:44].mean()
    assert column > 4 * change.mean()


def test_every_weight_is_used() -> None:
    network = ReconstructionNetwork(ReconstructionConfig(channels=(2, 2, 2, 2), blocks=(1, 1, 1, 1)))
    view = torch.rand(2, 2, 64, 64, 64, generator=torch.Generator().manual_seed(1)).round()
    torch.autograd.backward((network(view) ** 2).mean())
    unused = [name for name, weight in network.named_parameters() if weight.grad is None]
    assert not unused


def test_the_shipped_size_stays_within_its_budget() -> None:
    """12 MB of weights at 4 bytes each."""
    network = ReconstructionNetwork(ReconstructionConfig())
    assert sum(weight.numel() for weight in network.parameters()) < 3.2e6
