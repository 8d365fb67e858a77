import torch

from tests.training import tiny
from training.fit_critic import Adversary


def pair() -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    given = torch.stack([torch.from_numpy(tiny.box(i)).float()[None] for i in range(2)])
    true = torch.roll(given[:, 0], 4, dims=1)
    return given, 0.3 * given[:, 0], true


def test_a_critic_learns_to_tell_true_from_fake() -> None:
    torch.manual_seed(0)
    adversary = Adversary(tiny.adversary(None), steps=100)
    given, fake, true = pair()
    distances = [adversary.learn(given, None, fake, true)["wasserstein"] for _ in range(15)]
    assert distances[-1] > distances[0] + 1e-3


def test_only_its_own_steps_change_the_critic() -> None:
    adversary = Adversary(tiny.adversary(None), steps=100)
    given, fake, _ = pair()
    before = [weight.clone() for weight in adversary.learner.network.parameters()]
    fake.requires_grad_(True)
    torch.autograd.backward(adversary.loss(given, None, fake), inputs=[fake])
    assert fake.grad is not None
    assert all(weight.grad is None for weight in adversary.learner.network.parameters())
    assert all(torch.equal(a, b) for a, b in zip(before, adversary.learner.network.parameters(), strict=True))


def test_it_trains_before_it_counts() -> None:
    adversary = Adversary(tiny.adversary(None), steps=100)  # starts at 2, over 2 steps, with a head start of 1
    assert [adversary.learns_at(step) for step in range(3)] == [False, True, True]
    assert [round(adversary.beta(step), 3) for step in (2, 3, 4, 9)] == [1.0, 0.975, 0.95, 0.95]
