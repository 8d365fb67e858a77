import numpy as np
import pytest
import torch

from service.core import lookup, smoothing
from service.core.displacement import corrected
from tests.training import tiny
from training.networks.blocks import cell_centres
from training.networks.warping import displacement_at, sample_field, smoothed, soft_warp

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
    rest = points - backward.flatten(2).transpose(1, 2)
    moved = sample_field(correction, rest).norm(dim=1).reshape(32, 32, 32)
    height = rest[..., 2].reshape(32, 32, 32)
    free = (moved < height).numpy()  # no other is corrected by all that the network says
    assert 0.8 < free.mean() < 1
    np.testing.assert_allclose(served[:, free], found[:, free], atol=1e-6)


def test_smoothing_is_that_of_the_service() -> None:
    rest = torch.rand(2, 1, 64, 64, 64, generator=torch.Generator().manual_seed(0)).round()
    for one, found in zip(rest, smoothed(rest), strict=True):
        np.testing.assert_allclose(found[0].numpy(), smoothing.smoothed(one[0].numpy() > 0.5), atol=1e-6)


def test_the_warp_with_a_gradient_is_the_one_that_serves() -> None:
    """But for the floor, and for the lattice of 32³ between the two."""
    raised = torch.roll(torch.from_numpy(tiny.box(3)).float()[None, None], 14, dims=4)
    backward, correction = smooth_field(32, 2, 0.04), smooth_field(16, 3, 0.02)
    correction.requires_grad_(True)
    soft = soft_warp(raised, correction, backward)
    rest = raised[0, 0].numpy() > 0.5
    values = lookup.Inside(smoothing.smoothed(rest), probable=True)  # before they are told as probabilities
    served = lookup.Warp(rest, values)(corrected(backward[0].numpy(), correction[0].detach().numpy()))
    assert np.abs(soft[0].detach().numpy() - served).max() < 0.1
    torch.autograd.backward(soft.sum())
    assert correction.grad is not None
    assert correction.grad.abs().max() > 0
