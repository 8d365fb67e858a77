import pytest
import torch

from tests.training import tiny
from training.networks.blocks import cell_centres
from training.networks.deformation import (
    CLAMP_HEIGHT,
    DeformationNetwork,
    at_voxels,
    sample_field,
    soft_warp,
    warp,
)


def body() -> torch.Tensor:
    return torch.from_numpy(tiny.box(3)).float()[None, None]


# --- looking fields up ---


def test_a_linear_field_is_looked_up_exactly_between_its_nodes() -> None:
    centres = cell_centres(32, torch.zeros(1))
    slopes = torch.tensor([[1.0, 0.0, 0.0], [0.0, -2.0, 0.5], [0.3, 0.2, 0.1]])
    field = torch.einsum("ca,axyz->cxyz", slopes, centres)[None] + 0.25
    points = 0.05 + 0.9 * torch.rand(1, 200, 3, generator=torch.Generator().manual_seed(0))
    expected = torch.einsum("ca,bna->bcn", slopes, points) + 0.25
    torch.testing.assert_close(sample_field(field, points), expected, atol=1e-5, rtol=1e-5)


def test_a_voxel_centre_gives_the_voxel() -> None:
    field = torch.zeros(1, 1, 64, 64, 64)
    field[0, 0, 3, 40, 17] = 1.0
    point = (torch.tensor([[[3.0, 40.0, 17.0]]]) + 0.5) / 64
    assert float(sample_field(field, point)) == pytest.approx(1.0, abs=1e-5)


def test_outside_the_cube_the_nearest_value_holds() -> None:
    field = torch.zeros(1, 1, 8, 8, 8)
    field[..., 0] = 1.0  # what stands on the floor
    below = torch.tensor([[[0.5, 0.5, -0.2]]])
    assert float(sample_field(field, below)) == pytest.approx(1.0)
    assert float(sample_field(field, below, outside="zeros")) == 0.0


# --- warping ---


def test_no_displacement_gives_the_body_back() -> None:
    torch.testing.assert_close(warp(body(), torch.zeros(1, 3, 32, 32, 32)), body()[:, 0], atol=2e-5, rtol=0)


@pytest.mark.parametrize("shift", [(5, 0, 0), (0, -3, 0), (0, 0, 4), (2, 3, 6)])
def test_a_constant_displacement_moves_the_body_by_that_many_voxels(shift: tuple[int, int, int]) -> None:
    field = (torch.tensor(shift) / 64.0)[None, :, None, None, None].expand(1, 3, 32, 32, 32).contiguous()
    raised = torch.roll(body(), 12, dims=4)  # off the floor, which would hold its sole
    moved = warp(raised, field)[0]
    expected = torch.roll(raised[0, 0], shift, dims=(0, 1, 2))
    torch.testing.assert_close(moved, expected, atol=1e-4, rtol=0)


def test_the_sole_does_not_move_and_nothing_moves_farther_than_it_is_high() -> None:
    field = torch.full((2, 3, 32, 32, 32), 0.3)
    rest = torch.cat([body(), torch.roll(body(), 5, dims=2)])
    fine = at_voxels(field, rest)
    sole = rest[:, 0, :, :, 0] > 0.5
    assert fine[:, :, :, :, 0].abs().amax(dim=1)[sole].max() == 0.0
    height = (torch.arange(64) + 0.5) / 64
    longest = fine.norm(dim=1).amax(dim=(0, 1, 2))
    assert bool((longest <= height + 1e-6).all())
    # High enough, the field is what the nodes say.
    torch.testing.assert_close(fine[..., 40:], torch.full((2, 3, 64, 64, 24), 0.3))


def test_one_body_serves_all_loads() -> None:
    field = 0.05 * torch.rand(3, 3, 32, 32, 32, generator=torch.Generator().manual_seed(0))
    together = warp(body(), field)
    for i in range(3):
        torch.testing.assert_close(together[i], warp(body(), field[i : i + 1])[0])


def test_the_warp_with_a_gradient_is_the_one_that_serves() -> None:
    field = 0.05 * torch.rand(1, 3, 32, 32, 32, generator=torch.Generator().manual_seed(0))
    field.requires_grad_(True)
    soft = soft_warp(body(), field)
    torch.testing.assert_close(soft.detach(), warp(body(), field.detach()), atol=2e-4, rtol=0)
    torch.autograd.backward(soft.sum())
    assert field.grad is not None
    assert field.grad.abs().max() > 0


# --- the network ---


def test_field_and_latent_have_their_shapes() -> None:
    field, mean, log_variance = tiny.deformation_network()(body(), tiny.conditions(2), torch.zeros(2, 3))
    assert field.shape == (2, 3, 32, 32, 32)
    assert mean.shape[1] == log_variance.shape[1] == 3


def test_the_field_vanishes_towards_the_clamp() -> None:
    """tanh(z/h) times a field of the head: the lowest nodes move by at most that share of the peak."""
    network = tiny.deformation_network()
    torch.nn.init.zeros_(network.generator.head.weight)
    torch.nn.init.ones_(network.generator.head.bias)
    with torch.no_grad():
        field = network(body(), tiny.conditions(1), torch.zeros(1, 3))[0][0]
    heights = (torch.arange(32) + 0.5) / 32
    top = field[0, 0, 0, -1]
    torch.testing.assert_close(field[0, 5, 5] / top, torch.tanh(heights / CLAMP_HEIGHT), atol=1e-5, rtol=1e-5)
    assert field[:, :, :, 0].abs().max() < 0.25 * top


def held_gain() -> DeformationNetwork:
    """A network that does not look at the load number but for the scale of its answer."""
    network = tiny.deformation_network()
    network.generator.embed[0].weight.data[:, 6] = 0.0
    return network


def answer(network: DeformationNetwork, log_load: float) -> torch.Tensor:
    with torch.no_grad():
        field: torch.Tensor = network(body(), tiny.conditions(1, log_load), torch.zeros(1, 3))[0]
    return field


def test_displacement_is_linear_in_the_load_number_where_the_gain_is_held() -> None:
    network = held_gain()
    gentle, tenfold = answer(network, -4.0), answer(network, -3.0)
    assert gentle.abs().max() > 0
    torch.testing.assert_close(tenfold, 10.0 * gentle, rtol=1e-4, atol=1e-9)


def test_the_scale_saturates_at_one_edge_of_the_grid() -> None:
    """10^min(log10 Λ + gain, 0): with a gain of 0 the scale is Λ up to 1, and 1 beyond."""
    network = held_gain()
    for parameter in network.generator.gain[-1].parameters():
        torch.nn.init.zeros_(parameter)
    whole = answer(network, 0.0)
    torch.testing.assert_close(answer(network, -1.0), 0.1 * whole, rtol=1e-4, atol=1e-9)
    torch.testing.assert_close(answer(network, 5.0), whole)


def test_loads_of_a_batch_do_not_know_of_each_other() -> None:
    network = tiny.deformation_network()
    condition, noise = tiny.conditions(3), torch.randn(3, 3, generator=torch.Generator().manual_seed(0))
    with torch.no_grad():
        together = network(body(), condition, noise)[0]
        alone = torch.cat([network(body(), condition[i : i + 1], noise[i : i + 1])[0] for i in range(3)])
    torch.testing.assert_close(together, alone, atol=1e-6, rtol=1e-4)


def test_loads_are_divided_evenly_among_the_bodies() -> None:
    network = tiny.deformation_network()
    bodies = torch.stack([torch.from_numpy(tiny.box(i)).float()[None] for i in (0, 5)])
    condition, noise = tiny.conditions(4), torch.zeros(4, 3)
    with torch.no_grad():
        together = network(bodies, condition, noise)[0]
        each = [network(bodies[b : b + 1], condition[2 * b : 2 * b + 2], noise[:2])[0] for b in (0, 1)]
    torch.testing.assert_close(together, torch.cat(each), atol=1e-6, rtol=1e-4)


def test_noise_moves_the_latent() -> None:
    network = tiny.deformation_network()
    with torch.no_grad():
        calm = network(body(), tiny.conditions(1), torch.zeros(1, 3))[0]
        shaken = network(body(), tiny.conditions(1), torch.full((1, 3), 3.0))[0]
    assert (calm - shaken).abs().max() > 1e-6


def test_every_weight_is_used() -> None:
    network = DeformationNetwork(tiny.DEFORMATION)
    field, mean, log_variance = network(torch.cat([body(), body()]), tiny.conditions(2), torch.ones(2, 3))
    torch.autograd.backward((field**2).mean() + (mean**2 + log_variance**2).mean())
    unused = [name for name, weight in network.named_parameters() if weight.grad is None]
    assert not unused
