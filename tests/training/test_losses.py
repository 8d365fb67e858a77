import numpy as np
import pytest
import torch

from training.losses import kl_divergence, modified_bce, modified_bce_with_logits, relative_displacement


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
