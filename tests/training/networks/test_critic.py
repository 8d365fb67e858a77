import pytest
import torch

from tests.training import tiny
from training.configs import DEFORMATION_PRESETS
from training.networks.build import build_critic
from training.networks.conditions import ConditionConfig
from training.networks.critic import Critic, CriticConfig


def critic(condition: ConditionConfig | None = None, given_channels: int = 1) -> Critic:
    torch.manual_seed(0)
    return Critic(CriticConfig(given_channels=given_channels, channels=(2, 2, 3, 4), condition=condition))


def pair(count: int = 1) -> tuple[torch.Tensor, torch.Tensor]:
    given = torch.stack([torch.from_numpy(tiny.box(i)).float()[None] for i in range(count)])
    return given, torch.roll(given[:, 0], 3, dims=1)


def test_the_papers_critic_answers_with_32768_similarities() -> None:
    adversary = DEFORMATION_PRESETS["paper"].adversary
    assert adversary is not None
    with torch.device("meta"):
        net = build_critic(adversary.critic)
        similarity = net(torch.zeros(1, 1, 64, 64, 64), torch.zeros(1, 9), torch.zeros(1, 64, 64, 64))
    assert similarity.shape == (1, 32768)
    # Pairs come in; the condition is one more channel after the first layer.
    assert [layer.in_channels for layer in net.layers] == [2, 64 + 1, 128, 256]


def test_it_looks_at_both_of_a_pair() -> None:
    net, (given, outcome) = critic(), pair()
    with torch.no_grad():
        value = net(given, None, outcome)
        assert not torch.equal(value, net(given, None, given[:, 0]))
        assert not torch.equal(value, net(given.flip(2).roll(5, 2), None, outcome))


@pytest.mark.parametrize("encoding", ["spatial", "real", "one_hot"])
def test_it_looks_at_the_condition(encoding: str) -> None:
    net, (given, outcome) = critic(ConditionConfig(encoding)), pair()
    condition = tiny.conditions(2)
    with torch.no_grad():
        assert not torch.equal(net(given, condition[:1], outcome), net(given, condition[1:], outcome))


def test_it_misses_a_condition_that_it_was_made_for() -> None:
    with pytest.raises(ValueError, match="none was given"):
        critic(ConditionConfig("real"))(*pair()[:1], None, pair()[1])


def test_its_last_layer_is_linear() -> None:
    """Twice the last weights give twice the answer: no sigmoid bounds the distance."""
    net, (given, outcome) = critic(), pair()
    torch.nn.init.zeros_(net.layers[-1].bias)
    with torch.no_grad():
        once = net(given, None, outcome)
        net.layers[-1].weight *= 2.0
        torch.testing.assert_close(net(given, None, outcome), 2.0 * once)
    assert bool((once < 0).any())


def test_samples_of_a_batch_do_not_know_of_each_other() -> None:
    """The gradient penalty is taken a sample, from one gradient of all."""
    net, (given, outcome) = critic(), pair(2)
    with torch.no_grad():
        together = net(given, None, outcome)
        alone = torch.cat([net(given[i : i + 1], None, outcome[i : i + 1]) for i in (0, 1)])
    torch.testing.assert_close(together, alone)
