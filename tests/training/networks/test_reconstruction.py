import torch

from tests.training import tiny
from training.networks.reconstruction import ReconstructionConfig, ReconstructionNetwork, spoken, tempered


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


def test_the_view_reaches_the_answer_at_full_resolution() -> None:
    """With the coarse features switched off, a column's logits follow from what was seen of that column alone."""
    network = tiny.reconstruction_network()
    with torch.no_grad():
        for part in (network.head, network.spread):
            for weight in part.parameters():
                weight.zero_()
        torch.nn.init.normal_(network.detail.weight)
        empty = torch.zeros(1, 2, 64, 64, 64)
        dot = empty.clone()
        dot[0, 0, 21, 34, 20:24] = 1.0
        change = (network(dot) - network(empty))[0].abs().sum(dim=2)
    assert change[21, 34] > 1e-3
    change[21, 34] = 0.0
    assert not change.any()


def test_parts_of_a_pixel_lie_as_pixel_shuffle_lays_them() -> None:
    torch.manual_seed(0)
    conv = torch.nn.Conv2d(3, 8, 1)
    x = torch.randn(2, 3, 4, 6)
    expected = torch.nn.functional.pixel_shuffle(conv(x), 2).permute(0, 2, 3, 1)
    torch.testing.assert_close(spoken(x.permute(0, 2, 3, 1), conv), expected)


def test_a_temperature_divides_the_logits() -> None:
    network = tiny.reconstruction_network()
    view = torch.rand(1, 2, 64, 64, 64, generator=torch.Generator().manual_seed(1)).round()
    with torch.no_grad():
        plain, divided, again = network(view), tempered(network, 1.6)(view), network(view)
    torch.testing.assert_close(divided, plain / 1.6)
    assert torch.equal(plain, again)
