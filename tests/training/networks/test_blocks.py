import pytest
import torch

from training.networks.blocks import ModulatedPlaneBlock, PlaneBlock, ResidualPlaneBlock, Stem, cell_centres


def random(*shape: int) -> torch.Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(0))


def test_cell_centres_lie_half_a_cell_off_the_walls() -> None:
    centres = cell_centres(4, torch.zeros(1))
    assert centres.shape == (3, 4, 4, 4)
    assert centres[:, 0, 1, 3].tolist() == [0.125, 0.375, 0.875]


def test_residual_block_passes_its_input_through() -> None:
    block = ResidualPlaneBlock(3).eval()
    torch.nn.init.zeros_(block.block.conv.weight)
    x = random(1, 3, 4, 4)
    assert torch.equal(block(x), x)


def test_a_strided_block_halves() -> None:
    x = random(1, 3, 8, 8)
    assert PlaneBlock(3, 5, 2, 2).eval()(x).shape == (1, 5, 4, 4)
    assert PlaneBlock(3, 5, 3).eval()(x).shape == (1, 5, 8, 8)


def test_condition_says_nothing_before_training_and_scales_and_shifts_afterwards() -> None:
    block = ModulatedPlaneBlock(2, 3).eval()
    x, one, other = random(1, 2, 4, 4), torch.ones(1, 3), -torch.ones(1, 3)
    assert torch.equal(block(x, one), block(x, other))
    torch.nn.init.zeros_(block.conv.weight)
    block.modulation.bias.data = torch.tensor([0.0, 0.0, 2.0, -1.0])  # scale 1 and 1, shift 2 and -1
    expected = torch.tensor([2.0, -1.0 * 0.2])[None, :, None, None]
    torch.testing.assert_close(block(x, one) - x, expected.expand_as(x))


@pytest.mark.parametrize("factor", [2, 4])
def test_a_stem_is_a_convolution_whose_kernels_touch(factor: int) -> None:
    torch.manual_seed(0)
    block = Stem(3, 5, factor).eval()
    block.norm.running_mean.uniform_(-1, 1)
    x = torch.randn(2, 3, 8, 12)
    expected = torch.nn.functional.leaky_relu(block.norm(block.conv(x)), 0.2)
    assert expected.shape == (2, 5, 8 // factor, 12 // factor)
    torch.testing.assert_close(block(x.permute(0, 2, 3, 1)), expected)
