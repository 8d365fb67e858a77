import dataclasses

import pytest
import torch

from tests.training import tiny
from training.networks.blocks import cell_centres
from training.networks.deformation import CLAMP_HEIGHT, TERMS, DeformationNetwork, shrunk


def body() -> torch.Tensor:
    return torch.from_numpy(tiny.box(3)).float()[None, None]


def silence(network: DeformationNetwork) -> None:
    for layer in network.generator.last_layers:
        torch.nn.init.zeros_(layer.weight)
        torch.nn.init.zeros_(layer.bias)


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
    silence(network)
    torch.nn.init.ones_(network.generator.own.bias)
    correction = answer(network, tiny.priors(1))[0]
    heights = (torch.arange(16) + 0.5) / 16
    expected = torch.tanh(heights / CLAMP_HEIGHT)
    torch.testing.assert_close(correction[0, 5, 5] / correction[0, 5, 5, -1], expected, atol=1e-5, rtol=1e-5)


def test_a_factor_for_the_whole_body_scales_the_prior() -> None:
    network = tiny.deformation_network()
    silence(network)
    last = network.generator.whole[-1]
    last.bias.data[0] = 0.25
    last.bias.data[1 + TERMS * 2 + 0] = 0.5  # what moves along x also rises
    last.bias.data[1 + TERMS * 2 + 3] = 0.1  # the more the farther along x
    last.bias.data[1 + TERMS * 1 + 12 + 3] = 0.3  # all of it goes along y, the higher the more
    prior = tiny.priors(1)
    centres = cell_centres(16, prior)
    held = torch.tanh(centres[2] / CLAMP_HEIGHT)
    correction = answer(network, prior)[0]
    torch.testing.assert_close(correction[0], 0.25 * prior[0, 0] * held)
    torch.testing.assert_close(correction[2], (0.5 + 0.1 * (centres[0] - 0.5)) * prior[0, 0] * held)
    torch.testing.assert_close(correction[1], 0.3 * (centres[2] - 0.5) * prior[0, 0].max() * held)


def test_a_factor_of_a_place_scales_the_prior_there() -> None:
    network = tiny.deformation_network()
    silence(network)
    network.generator.local.bias.data[:] = torch.arange(16) / 16
    prior = tiny.priors(1)
    held = torch.tanh(cell_centres(16, prior)[2] / CLAMP_HEIGHT)
    correction = answer(network, prior)[0]
    torch.testing.assert_close(correction[0], torch.arange(16) / 16 * prior[0, 0] * held)
    assert not correction[1:].any()


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
    torch.nn.init.normal_(network.generator.own.weight)
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
    torch.nn.init.normal_(network.generator.own.weight)
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
