import numpy as np
import pytest
import torch

from training.losses import (
    beta_at,
    generator_adversarial_loss,
    gradient_penalty,
    kl_divergence,
    modified_bce,
    modified_bce_with_logits,
    occupancy_losses,
    relative_displacement,
    soft_iou_loss,
    vae_gan_loss,
    wasserstein_loss,
)


def test_modified_bce_by_hand() -> None:
    """-(0.85 ln 0.8 + 0.15 ln 0.7 + 0.85 ln 0.01 + 0.15 ln 0.01)/4: the last two outputs count as 0.01 and 0.99."""
    output, target = torch.tensor([0.8, 0.3, 0.0, 1.0]), torch.tensor([1.0, 0.0, 1.0, 0.0])
    assert float(modified_bce(output, target, 0.85)) == pytest.approx(1.2120859, rel=1e-5)


def test_missed_voxels_cost_more_than_false_ones() -> None:
    missed = modified_bce(torch.tensor([0.1]), torch.tensor([1.0]), 0.85)
    false = modified_bce(torch.tensor([0.9]), torch.tensor([0.0]), 0.85)
    assert float(missed / false) == pytest.approx(0.85 / 0.15, rel=1e-5)


def test_alpha_of_one_half_is_half_the_plain_cross_entropy() -> None:
    generator = torch.Generator().manual_seed(0)
    output = torch.rand(100, generator=generator) * 0.9 + 0.05
    target = (torch.rand(100, generator=generator) < 0.5).float()
    plain = torch.nn.functional.binary_cross_entropy(output, target)
    assert float(modified_bce(output, target, 0.5)) == pytest.approx(float(plain) / 2, rel=1e-5)


def test_on_logits_it_is_the_same_and_does_not_saturate() -> None:
    logits, target = torch.tensor([-3.0, 0.5, 2.0, -0.1]), torch.tensor([1.0, 0.0, 1.0, 0.0])
    with_logits = modified_bce_with_logits(logits, target, 0.7)
    assert float(with_logits) == pytest.approx(float(modified_bce(logits.sigmoid(), target, 0.7)), rel=1e-5)
    far = modified_bce_with_logits(torch.tensor([-200.0]), torch.tensor([1.0]), 0.5)
    assert float(far) == pytest.approx(100.0)


def test_soft_iou_by_hand() -> None:
    """Probabilities 0.8 and 0.3 against 1 and 0: 0.8/(1.1 + 1 - 0.8); all right and all wrong: 1 and 0."""
    o, t = torch.tensor([[0.8, 0.3]]), torch.tensor([[1.0, 0.0]])
    assert float(soft_iou_loss(o.logit(), t)) == pytest.approx(1 - 0.8 / 1.3, rel=1e-5)
    sure = torch.tensor([[[30.0, -30.0]], [[30.0, -30.0]]])
    assert float(soft_iou_loss(sure, torch.tensor([[[1.0, 0.0]], [[0.0, 1.0]]]))) == pytest.approx(0.5)
    assert float(soft_iou_loss(sure, torch.zeros(2, 1, 2))) == pytest.approx(1.0)


@pytest.mark.parametrize("alpha", [0.5, 0.85])
def test_both_losses_of_occupancy_slope_as_torch_says(alpha: float) -> None:
    """In one pass, of any share of one and the other, and nowhere where it is free."""
    generator = torch.Generator().manual_seed(0)
    logits = 3 * torch.randn(3, 4, 5, 6, generator=generator)
    target = (torch.rand(3, 4, 5, 6, generator=generator) < 0.3).float()
    free = torch.rand(3, 4, 5, 6, generator=generator) < 0.4
    slopes, values = [], []
    for plain in (True, False):
        given = logits.clone().requires_grad_()
        if plain:
            said, wanted = given.masked_fill(free, -40.0), target.masked_fill(free, 0.0)
            losses = modified_bce_with_logits(said, wanted, alpha), soft_iou_loss(said, wanted)
        else:
            losses = occupancy_losses(given, target, free, alpha)
        (0.7 * losses[0] + 0.2 * losses[1]).backward()
        slopes.append(given.grad)
        values.append(torch.stack(list(losses)).detach())
    torch.testing.assert_close(values[1], values[0])
    torch.testing.assert_close(slopes[1], slopes[0])
    assert slopes[1] is not None and not slopes[1][free].any()


def test_kl_by_hand() -> None:
    """½(1² + 1 - 1 - 0) + ½(0 + 4 - 1 - ln 4) nats for the first sample, 0 for the second, averaged."""
    mean = torch.tensor([[1.0, 0.0], [0.0, 0.0]])
    log_variance = torch.tensor([[0.0, np.log(4.0)], [0.0, 0.0]])
    assert float(kl_divergence(mean, log_variance)) == pytest.approx((0.5 + 0.8068528) / 2, rel=1e-6)


def test_relative_displacement_is_the_mean_error_in_the_body_over_the_peak() -> None:
    target = torch.zeros(2, 3, 4, 4, 4)
    target[:, 0], target[:, 1] = 0.03, 0.04  # an error of 0.05 everywhere
    weight = torch.zeros(2, 1, 4, 4, 4)
    weight[..., :2] = 1.0
    target[..., 2:] = 7.0  # outside the body anything goes
    error = relative_displacement(torch.zeros_like(target), target, weight, torch.tensor([0.1, 0.2]), 1e-3)
    assert float(error) == pytest.approx((0.5 + 0.25) / 2, rel=1e-4)


def test_peaks_below_the_floor_count_as_the_floor() -> None:
    target = torch.full((1, 3, 4, 4, 4), 1e-4)
    error = relative_displacement(
        torch.zeros_like(target), target, torch.ones(1, 1, 4, 4, 4), torch.tensor([np.sqrt(3) * 1e-4]).float(), 1e-2
    )
    assert float(error) == pytest.approx(np.sqrt(3) * 1e-2, rel=1e-3)


def test_a_perfect_field_has_a_gradient_that_is_finite() -> None:
    """The square root's slope is infinite at zero; a small constant keeps training alive there."""
    predicted = torch.zeros(1, 3, 4, 4, 4, requires_grad=True)
    loss = relative_displacement(
        predicted, torch.zeros(1, 3, 4, 4, 4), torch.ones(1, 1, 4, 4, 4), torch.ones(1), 1e-3
    )
    torch.autograd.backward(loss)
    assert predicted.grad is not None
    assert torch.isfinite(predicted.grad).all()


# --- adversarial ---


def test_the_total_loss_weighs_95_to_5() -> None:
    assert float(vae_gan_loss(torch.tensor(2.0), torch.tensor(-4.0), 0.95)) == pytest.approx(1.7)


def test_beta_falls_in_a_straight_line_once_the_critic_counts() -> None:
    values = [beta_at(step, start=100, ramp=50, beta=0.95) for step in (0, 100, 125, 150, 10_000)]
    assert values == pytest.approx([1.0, 1.0, 0.975, 0.95, 0.95])
    assert beta_at(100, 100, 0, 0.95) == 1.0
    assert beta_at(101, 100, 0, 0.95) == pytest.approx(0.95)


def test_wasserstein_terms_by_hand() -> None:
    fake, true = torch.tensor([[1.0, 2.0], [3.0, 4.0]]), torch.tensor([[0.0, 1.0], [5.0, 6.0]])
    assert float(wasserstein_loss(fake, true)) == pytest.approx(2.5 - 3.0)
    assert float(generator_adversarial_loss(fake)) == pytest.approx(-2.5)


@pytest.mark.parametrize("length", [0.0, 0.5, 1.0, 3.0])
def test_the_gradient_of_a_linear_critic_is_its_weights(length: float) -> None:
    """D(o) = w·o has the gradient w everywhere: the penalty is (‖w‖ - 1)², wherever η puts ô."""
    generator = torch.Generator().manual_seed(0)
    weight = torch.randn(4, 4, 4, generator=generator)
    weight *= length / weight.norm()
    fake, true = torch.rand(2, 3, 4, 4, 4, generator=generator)

    def critic(outcome: torch.Tensor) -> torch.Tensor:
        return (weight * outcome).sum(dim=(1, 2, 3))[:, None]

    penalty = gradient_penalty(critic, fake, true, torch.rand(3, generator=generator))
    assert penalty.item() == pytest.approx((length - 1.0) ** 2, abs=1e-5)


def test_the_similarity_vector_counts_by_its_mean() -> None:
    """Two similarities w·o and 3 w·o have the mean 2 w·o, of slope 2 where ‖w‖ = 1."""
    weight = torch.full((2, 2, 2), 8.0**-0.5)

    def critic(outcome: torch.Tensor) -> torch.Tensor:
        value = (weight * outcome).sum(dim=(1, 2, 3))
        return torch.stack([value, 3 * value], dim=1)

    grids = torch.rand(2, 1, 2, 2, 2, generator=torch.Generator().manual_seed(0))
    assert gradient_penalty(critic, *grids, torch.tensor([0.3])).item() == pytest.approx(1.0, abs=1e-5)


@pytest.mark.parametrize(("share", "place"), [(0.0, 3.0), (1.0, 5.0), (0.25, 3.5)])
def test_the_penalty_is_taken_between_fake_and_true(share: float, place: float) -> None:
    """D(o) = ½ o² of one voxel has the slope o: at ô = η t + (1-η) o with o = 3 and t = 5 it tells where ô lies."""
    fake, true = torch.full((1, 1, 1, 1), 3.0), torch.full((1, 1, 1, 1), 5.0)
    penalty = gradient_penalty(lambda o: 0.5 * (o**2).flatten(1), fake, true, torch.tensor([share]))
    assert penalty.item() == pytest.approx((place - 1.0) ** 2, rel=1e-5)


def test_the_penalty_teaches_the_critic_and_not_the_generator() -> None:
    """d/dw (|w| - 1)² = 2(w - 1) for D(o) = w·o of one voxel."""
    weight = torch.tensor(3.0, requires_grad=True)
    fake = torch.full((1, 1, 1, 1), 0.2, requires_grad=True)
    penalty = gradient_penalty(lambda o: weight * o.flatten(1), fake, torch.ones(1, 1, 1, 1), torch.tensor([0.5]))
    torch.autograd.backward(penalty)
    assert weight.grad is not None
    assert float(weight.grad) == pytest.approx(4.0, rel=1e-5)
    assert fake.grad is None
