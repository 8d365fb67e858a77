"""The other player: the critic's own steps, and what it tells the generator."""

from __future__ import annotations

from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from training.configs import AdversaryConfig
from training.fit_loop import Learner
from training.losses import beta_at, generator_adversarial_loss, gradient_penalty, wasserstein_loss
from training.networks.build import build_critic


class Adversary:
    """A critic with its optimizer, trained by WGAN-GP.

    Args:
        config: How it is played against.
        steps: Of the whole run.
    """

    def __init__(self, config: AdversaryConfig, steps: int) -> None:
        self.config = config
        critic = build_critic(config.critic)
        critic = critic.to(memory_format=critic.memory_format)  # type: ignore[call-overload]
        self.learner = Learner(critic, config.optimizer, steps)

    def beta(self, step: int) -> float:
        """Weight of the VAE loss in the generator's."""
        return beta_at(step, self.config.start, self.config.ramp, self.config.beta)

    def learns_at(self, step: int) -> bool:
        """The critic starts before it counts, so that its first word is worth hearing."""
        return step >= self.config.start - self.config.head_start

    def learn(
        self,
        given: Float[Tensor, "batch c 64 64 64"],
        condition: Float[Tensor, "batch fields"] | None,
        fake: Float[Tensor, "batch 64 64 64"],
        true: Float[Tensor, "batch 64 64 64"],
    ) -> dict[str, float]:
        """The critic's steps on one batch: L_d = E[D(o|x)] - E[D(t|x)] + λ·penalty. Source: the paper, eq. 3."""
        fake = fake.detach()
        for _ in range(self.config.critic_steps):
            critic = self.learner.network
            distance = wasserstein_loss(critic(given, condition, fake), critic(given, condition, true))
            penalty = gradient_penalty(
                lambda outcome: self.learner.network(given, condition, outcome), fake, true, torch.rand(len(fake))
            )
            self.learner.learn(distance + self.config.penalty * penalty)
        return {"wasserstein": -distance.item(), "penalty": penalty.item()}

    def loss(
        self,
        given: Float[Tensor, "batch c 64 64 64"],
        condition: Float[Tensor, "batch fields"] | None,
        fake: Float[Tensor, "batch 64 64 64"],
    ) -> Tensor:
        """L_gan^g, what the generator would lower."""
        return generator_adversarial_loss(self.learner.network(given, condition, fake))

    def state_dict(self) -> dict[str, Any]:
        return self.learner.state_dict()

    def load_state_dict(self, state: dict[str, Any]) -> None:
        self.learner.load_state_dict(state)
