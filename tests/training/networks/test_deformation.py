import dataclasses

import numpy as np
import pytest
import torch

from service.core import lookup
from service.core.displacement import at_voxels, corrected
from tests.training import tiny
from training.networks.blocks import cell_centres
from training.networks.deformation import (
    CLAMP_HEIGHT,
    DeformationNetwork,
    displacement_at,
    sample_field,
    shrunk,
    smoothed,
    soft_warp,
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


# --- as served ---


def smooth_field(size: int, seed: int, peak: float) -> torch.Tensor:
    coarse = torch.rand(1, 3, 4, 4, 4, generator=torch.Generator().manual_seed(seed)) - 0.5
    field = torch.nn.functional.interpolate(coarse, size=(size,) * 3, mode="trilinear")
    return 2 * peak * field


def test_the_corrected_field_is_the_one_that_serves() -> None:
    backward, correction = smooth_field(32, 0, 0.08), smooth_field(16, 1, 0.03)
    nodes = cell_centres(32, backward)
    points = nodes.flatten(1).T[None]
    found = displacement_at(correction, backward, points).reshape(3, 32, 32, 32).numpy()
    served = corrected(backward[0].numpy(), correction[0].numpy())
    free = np.linalg.norm(found, axis=0) < nodes[2].numpy()  # the floor holds the others
    assert free.mean() > 0.8
    np.testing.assert_allclose(served[:, free], found[:, free], atol=1e-4)


def test_smoothing_is_that_of_the_service() -> None:
    rest = torch.rand(2, 1, 64, 64, 64, generator=torch.Generator().manual_seed(0)).round()
    for one, found in zip(rest, smoothed(rest), strict=True):
        np.testing.assert_allclose(found[0].numpy(), lookup.smoothed(one[0].numpy() > 0.5), atol=1e-6)


def test_the_warp_with_a_gradient_is_the_one_that_serves() -> None:
    """But for the floor, and for the lattice of 32³ between the two."""
    raised = torch.roll(body(), 14, dims=4)
    backward, correction = smooth_field(32, 2, 0.04), smooth_field(16, 3, 0.02)
    correction.requires_grad_(True)
    soft = soft_warp(raised, correction, backward)
    rest = raised[0, 0].numpy() > 0.5
    served = lookup.warp(rest, at_voxels(corrected(backward[0].numpy(), correction[0].detach().numpy()), rest))
    assert np.abs(soft[0].detach().numpy() - served).max() < 0.1
    torch.autograd.backward(soft.sum())
    assert correction.grad is not None
    assert correction.grad.abs().max() > 0


# --- the network ---


def answer(network: DeformationNetwork, prior: torch.Tensor, log_load: float = -2.5) -> torch.Tensor:
    loads = len(prior)
    with torch.no_grad():
        found: torch.Tensor = network(body(), tiny.conditions(loads, log_load), torch.zeros(loads, 3), prior)[0]
    return found


def test_correction_and_latent_have_their_shapes() -> None:
    network = tiny.deformation_network()
    correction, mean, log_variance = network(body(), tiny.conditions(2), torch.zeros(2, 3), tiny.priors(2))
    assert correction.shape == (2, 3, 16, 16, 16)
    assert mean.shape[1] == log_variance.shape[1] == 3


def test_training_starts_at_the_prior() -> None:
    network = DeformationNetwork(tiny.DEFORMATION).eval()
    assert not answer(network, tiny.priors(2)).any()


def test_the_correction_vanishes_towards_the_clamp() -> None:
    """tanh(z/h) times what the head says: the lowest nodes move by at most that share."""
    network = tiny.deformation_network()
    for layer in (network.generator.head, network.generator.whole[-1]):
        torch.nn.init.zeros_(layer.weight)
        torch.nn.init.zeros_(layer.bias)
    torch.nn.init.ones_(network.generator.head.bias[9:])
    correction = answer(network, tiny.priors(1))[0]
    heights = (torch.arange(16) + 0.5) / 16
    expected = torch.tanh(heights / CLAMP_HEIGHT)
    torch.testing.assert_close(correction[0, 5, 5] / correction[0, 5, 5, -1], expected, atol=1e-5, rtol=1e-5)


def test_a_factor_for_the_whole_body_scales_the_prior() -> None:
    network = tiny.deformation_network()
    torch.nn.init.zeros_(network.generator.head.weight)
    torch.nn.init.zeros_(network.generator.head.bias)
    last = network.generator.whole[-1]
    torch.nn.init.zeros_(last.weight)
    torch.nn.init.zeros_(last.bias)
    last.bias.data[0] = 0.25
    last.bias.data[1 + 3 * 2 + 0] = 0.5  # what moves along x also rises
    prior = tiny.priors(1)
    held = torch.tanh(cell_centres(16, prior)[2] / CLAMP_HEIGHT)
    correction = answer(network, prior)[0]
    torch.testing.assert_close(correction[0], 0.25 * prior[0, 0] * held)
    torch.testing.assert_close(correction[2], 0.5 * prior[0, 0] * held)


def test_the_correction_is_of_the_size_of_the_prior() -> None:
    """Its field is normalised before the network sees it; only the size itself is told, as a logarithm."""
    network = tiny.deformation_network()
    network.generator.embed[0].weight.data[:, 9] = 0.0
    small, large = answer(network, tiny.priors(1)), answer(network, 8 * tiny.priors(1))
    assert small.abs().max() > 0
    torch.testing.assert_close(large, 8 * small, rtol=1e-4, atol=1e-7)


def test_without_a_prior_the_scale_is_that_of_the_load_up_to_one_edge() -> None:
    torch.manual_seed(0)
    network = DeformationNetwork(dataclasses.replace(tiny.DEFORMATION, prior=False, log_gain=0.0)).eval()
    torch.nn.init.normal_(network.generator.head.weight)
    network.generator.embed[0].weight.data[:, [6, 9]] = 0.0
    prior = tiny.priors(1)
    whole = answer(network, prior, log_load=0.0)
    torch.testing.assert_close(answer(network, prior, log_load=-1.0), 0.1 * whole, rtol=1e-4, atol=1e-9)
    torch.testing.assert_close(answer(network, prior, log_load=5.0), whole)
    torch.testing.assert_close(answer(network, 3 * prior, log_load=0.0), whole)


@pytest.mark.parametrize("ablation", ["skips", "conditioned"])
def test_an_ablated_network_does_not_see_what_it_must_not(ablation: str) -> None:
    torch.manual_seed(0)
    network = DeformationNetwork(dataclasses.replace(tiny.DEFORMATION, **{ablation: False})).eval()
    torch.nn.init.normal_(network.generator.head.weight)
    prior = tiny.priors(1)
    if ablation == "conditioned":
        torch.testing.assert_close(answer(network, prior, log_load=-1.0), answer(network, prior, log_load=-3.0))
        return
    with torch.no_grad():
        _, coarse, mean, _ = network.encoder(body())
        middle = network.encoder(body())[0]
        told = [
            network.generator(m, c, mean, tiny.conditions(1), prior)
            for m, c in ((middle, coarse), (middle + 1.0, coarse - 1.0))
        ]
    torch.testing.assert_close(told[0], told[1])


def test_loads_of_a_batch_do_not_know_of_each_other() -> None:
    network = tiny.deformation_network()
    condition, noise = tiny.conditions(3), torch.randn(3, 3, generator=torch.Generator().manual_seed(0))
    prior = tiny.priors(3)
    with torch.no_grad():
        together = network(body(), condition, noise, prior)[0]
        each = [slice(i, i + 1) for i in range(3)]
        alone = torch.cat([network(body(), condition[i], noise[i], prior[i])[0] for i in each])
    torch.testing.assert_close(together, alone, atol=1e-6, rtol=1e-4)


def test_loads_are_divided_evenly_among_the_bodies() -> None:
    network = tiny.deformation_network()
    bodies = torch.stack([torch.from_numpy(tiny.box(i)).float()[None] for i in (0, 5)])
    condition, noise, prior = tiny.conditions(4), torch.zeros(4, 3), tiny.priors(4)
    with torch.no_grad():
        together = network(bodies, condition, noise, prior)[0]
        each = [
            network(bodies[b : b + 1], condition[2 * b : 2 * b + 2], noise[:2], prior[2 * b : 2 * b + 2])[0]
            for b in (0, 1)
        ]
    torch.testing.assert_close(together, torch.cat(each), atol=1e-6, rtol=1e-4)


def test_a_shrunk_network_says_its_share_of_every_correction() -> None:
    network, prior = tiny.deformation_network(), tiny.priors(2)
    whole = answer(network, prior)
    torch.testing.assert_close(answer(shrunk(network, 0.25), prior), 0.25 * whole, rtol=1e-4, atol=1e-7)
    torch.testing.assert_close(answer(network, prior), whole)
    assert not answer(shrunk(network, 0.0), prior).any()


def test_noise_moves_the_latent() -> None:
    network = tiny.deformation_network()
    with torch.no_grad():
        calm, shaken = (
            network(body(), tiny.conditions(1), torch.full((1, 3), size), tiny.priors(1))[0] for size in (0.0, 3.0)
        )
    assert (calm - shaken).abs().max() > 1e-6


def test_every_weight_is_used() -> None:
    network = tiny.deformation_network().train()
    field, mean, log_variance = network(
        torch.cat([body(), body()]), tiny.conditions(2), torch.ones(2, 3), tiny.priors(2)
    )
    torch.autograd.backward((field**2).mean() + (mean**2 + log_variance**2).mean())
    unused = [name for name, weight in network.named_parameters() if weight.grad is None]
    assert not unused
