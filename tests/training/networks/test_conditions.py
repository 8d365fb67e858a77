import numpy as np
import pytest
import torch

from tests.training import tiny
from training.networks.conditions import (
    ConditionConfig,
    condition_planes,
    condition_slabs,
    one_hot_contact,
    slab_channels,
)

# --- the load as planes ---

PUSH = torch.tensor([[0.5625, 0.3125, 0.8125, 0.6, 0.0, -0.8, -2.0, 0.3, 0.1]])
"""Its contact is the centre of cell (4, 2, 6) of an 8³ lattice."""


def test_planes_at_the_contact() -> None:
    """r = 0: weight 1, decay 1, no offset, and the kelvinlet is 3/2 of the force."""
    at = condition_planes(PUSH, 8)[0, :, 4, 2, 6]
    torch.testing.assert_close(at, torch.tensor([1.0, 1.0, 0.6, 0.0, -0.8, 0.0, 0.0, 0.0, 0.9, 0.0, -1.2]))


def test_planes_one_cell_beside_the_contact() -> None:
    """r = (0.125, 0, 0), R = 0.1: hand-computed from the formulas of the docstring."""
    r, R = 0.125, 0.1
    decay = R / np.hypot(r, R)
    at = condition_planes(PUSH, 8)[0, :, 5, 2, 6].numpy()
    assert at[0] == pytest.approx(np.exp(-(r**2) / (2 * R**2)), rel=1e-5)
    assert at[1] == pytest.approx(decay, rel=1e-5)
    np.testing.assert_allclose(at[5:8], [0.125, 0.0, 0.0], atol=1e-6)
    # R [f (1/ε + R²/2ε³) + r (r·f)/ε³] with ε = √(r² + R²)
    epsilon = np.hypot(r, R)
    force, offset = np.array([0.6, 0.0, -0.8]), np.array([r, 0.0, 0.0])
    expected = R * (force * (1 / epsilon + R**2 / (2 * epsilon**3)) + offset * (offset @ force) / epsilon**3)
    np.testing.assert_allclose(at[8:11], expected, rtol=1e-5, atol=1e-6)


def test_planes_know_nothing_of_the_strength() -> None:
    stronger = PUSH.clone()
    stronger[:, 6] = -1.0
    assert torch.equal(condition_planes(PUSH, 4), condition_planes(stronger, 4))


# --- the paper's encodings ---


def test_real_numbers_are_centred_and_scaled() -> None:
    encoding = ConditionConfig("real", centre=(0.5, 0.5), scale=(2.0, 4.0))
    numbers = encoding.encoded(torch.tensor([[1.0, 0.25]]))
    assert numbers.tolist() == [[1.0, -1.0]]
    assert encoding.fields(torch.tensor([[1.0, 0.25]]), 8).shape == (1, 0, 8, 8, 8)
    assert (encoding.width, encoding.planes) == (2, 0)


def test_one_hot_marks_the_tenth_that_each_coordinate_falls_into() -> None:
    marked = one_hot_contact(torch.tensor([[0.05, 0.5, 0.99], [0.1, -0.2, 1.3]])).reshape(2, 3, 10)
    assert marked.argmax(dim=2).tolist() == [[0, 5, 9], [1, 0, 9]]
    assert bool((marked.sum(dim=2) == 1).all())


def test_one_hot_replaces_the_contact_alone() -> None:
    condition = tiny.conditions(2)
    one_hot, real = ConditionConfig("one_hot"), ConditionConfig("real")
    assert one_hot.encoded(condition).shape == (2, one_hot.width) == (2, 36)
    assert torch.equal(one_hot.encoded(condition)[:, 30:], real.encoded(condition)[:, 3:])


def test_spatial_gives_the_numbers_and_the_planes() -> None:
    encoding, condition = ConditionConfig(), tiny.conditions(2)
    assert encoding.encoded(condition).shape == (2, encoding.width)
    assert torch.equal(encoding.fields(condition, 4), condition_planes(condition, 4))
    assert encoding.planes == 11


@pytest.mark.parametrize("encoding", ["spatial", "one_hot"])
def test_a_condition_without_a_contact_cannot_be_placed(encoding: str) -> None:
    with pytest.raises(ValueError, match="needs the 9 fields of the served condition, not 2; choose real"):
        ConditionConfig(encoding, centre=(0.0, 0.0), scale=(1.0, 1.0))


def test_centres_and_scales_belong_together() -> None:
    with pytest.raises(ValueError, match="1 centres for 2 scales"):
        ConditionConfig("real", centre=(0.0,), scale=(1.0, 1.0))


def test_slabs_hold_the_numbers_in_turn() -> None:
    slabs = condition_slabs(torch.tensor([[3.0, 7.0]]), 4)
    assert slabs.shape == (1, 1, 4, 4, 4)
    assert slabs[0, 0, :, 1, 2].tolist() == [3.0, 3.0, 7.0, 7.0]
    assert bool((slabs[0, 0] == slabs[0, 0, :, :1, :1]).all())


def test_more_numbers_than_planes_take_more_channels() -> None:
    slabs = condition_slabs(torch.arange(5.0)[None], 4)
    assert slabs.shape == (1, slab_channels(5, 4), 4, 4, 4) == (1, 2, 4, 4, 4)
    assert slabs[0, :, :, 0, 0].tolist() == [[0.0, 0.0, 1.0, 1.0], [2.0, 3.0, 3.0, 4.0]]
