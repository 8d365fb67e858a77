from dataclasses import replace

import pytest
import torch
from torch import nn

from tests.training import tiny
from training.configs import DEFORMATION_PRESETS, RECONSTRUCTION_PRESETS
from training.networks.build import build_deformation, build_reconstruction
from training.networks.conditions import ConditionConfig
from training.networks.physnet import PhysNet, PhysNetConfig, reparametrised
from training.networks.recgan import RecGan


def bodies(count: int) -> torch.Tensor:
    return torch.stack([torch.from_numpy(tiny.box(i)).float()[None] for i in range(count)])


def network(**changes: object) -> PhysNet:
    torch.manual_seed(0)
    return PhysNet(replace(tiny.PHYSNET, **changes)).eval()


def on_paper(preset: str) -> nn.Module:
    with torch.device("meta"):  # shapes without memory
        return build_deformation(DEFORMATION_PRESETS[preset].network)


def parameters(module: nn.Module) -> int:
    return sum(weight.numel() for weight in module.parameters())


def test_the_papers_layers_have_the_papers_sizes() -> None:
    """Table 1 and the released code, layer by layer; K = 4³ = 64 weights a filter and channel."""
    paper = on_paper("paper")
    encoder = 64 * (1 * 64 + 64 * 128 + 128 * 256 + 256 * 512) + 960 + 32768 * 5000 + 5000
    latent = 2 * (5000 * 800 + 800)
    decoder = 64 * (1024 * 256 + 512 * 128 + 256 * 64 + 128 * 1) + 449 + (800 + 9) * 32768 + 32768
    assert parameters(paper) == encoder + latent + decoder


def test_the_baseline_differs_in_its_latent_alone() -> None:
    paper, baseline = (dict(on_paper(name).named_parameters()) for name in ("paper", "icgan"))
    assert {name for name in paper if name not in baseline} == {
        "mean.weight", "mean.bias", "log_variance.weight", "log_variance.bias",
    }  # fmt: skip
    different = [name for name in baseline if baseline[name].shape != paper[name].shape]
    assert different == ["generator.dense.weight"]
    assert baseline["generator.dense.weight"].shape == (32768, 5000 + 9)


def test_3d_recgan_has_no_condition_and_no_distribution() -> None:
    with torch.device("meta"):
        recgan = build_reconstruction(RECONSTRUCTION_PRESETS["paper"].network)
    assert recgan.generator.dense.weight.shape == (32768, 5000)
    assert not [name for name, _ in recgan.named_parameters() if "mean" in name]


def test_z_is_the_mean_plus_sigma_times_noise() -> None:
    """σ = exp(½ ln 4) = 2."""
    z = reparametrised(torch.tensor([[1.0]]), torch.log(torch.tensor([[4.0]])), torch.tensor([[0.5]]))
    assert float(z) == pytest.approx(2.0)


@pytest.mark.parametrize("encoding", ["spatial", "real", "one_hot"])
def test_every_encoding_reaches_the_answer(encoding: str) -> None:
    net = network(condition=ConditionConfig(encoding))
    condition = tiny.conditions(2)
    condition[1] = condition[0]
    condition[1, 0] += 0.25  # another place
    with torch.no_grad():
        logits, mean, log_variance = net(bodies(1), condition, torch.zeros(2, 3))
    assert logits.shape == (2, 64, 64, 64)
    assert mean.shape == log_variance.shape == (2, 3)
    assert (logits[0] - logits[1]).abs().max() > 1e-5


def test_without_a_condition_all_loads_are_one() -> None:
    with torch.no_grad():
        logits, _, _ = network(conditioned=False)(bodies(1), tiny.conditions(2), torch.zeros(2, 3))
    assert torch.equal(logits[0], logits[1])


def test_noise_samples_the_posterior_and_leaves_a_plain_code_alone() -> None:
    for variational in (True, False):
        net = network(variational=variational)
        with torch.no_grad():
            calm, shaken = (net(bodies(1), tiny.conditions(1), torch.full((1, 3), n))[0] for n in (0.0, 3.0))
        assert torch.equal(calm, shaken) != variational


def test_skips_carry_what_the_code_does_not() -> None:
    """With a code that is cut off, two bodies differ in the answer only through the skips."""
    for skips in (True, False):
        net = network(skips=skips)
        nn.init.zeros_(net.mean.weight)
        with torch.no_grad():
            logits, _, _ = net(bodies(6)[[0, 5]], tiny.conditions(1).expand(2, -1), torch.zeros(2, 3))
        assert torch.equal(logits[0], logits[1]) != skips


def test_loads_are_divided_evenly_among_the_bodies() -> None:
    net, condition = network(), tiny.conditions(4)
    with torch.no_grad():
        together = net(bodies(2), condition, torch.zeros(4, 3))[0]
        each = [net(bodies(2)[b : b + 1], condition[2 * b : 2 * b + 2], torch.zeros(2, 3))[0] for b in (0, 1)]
    torch.testing.assert_close(together, torch.cat(each), atol=1e-5, rtol=1e-4)


def test_every_weight_is_used() -> None:
    for net in (PhysNet(tiny.PHYSNET), PhysNet(replace(tiny.PHYSNET, variational=False))):
        logits, mean, log_variance = net(bodies(2), tiny.conditions(2), torch.ones(2, 3))
        torch.autograd.backward((logits**2).mean() + (mean**2 + log_variance**2).mean())
        assert not [name for name, weight in net.named_parameters() if weight.grad is None]


def test_recgan_sees_free_space_only_where_it_is_told_to() -> None:
    view = torch.zeros(1, 2, 64, 64, 64)
    view[0, 0, 20:40, 20:40, :30] = 1.0
    freed = view.clone()
    freed[0, 1, :20] = 1.0
    for channels in (1, 2):
        torch.manual_seed(0)
        net = RecGan(replace(tiny.RECGAN, view_channels=channels))
        with torch.no_grad():
            assert torch.equal(net(view), net(freed)) == (channels == 1)


def test_the_default_is_the_paper() -> None:
    assert DEFORMATION_PRESETS["paper"].network == PhysNetConfig()
