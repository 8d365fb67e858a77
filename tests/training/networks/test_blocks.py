import pytest
import torch

from training.networks.blocks import (
    ConvBlock,
    ModulatedResidualBlock,
    ResidualBlock,
    Upsample,
    cell_centres,
    depth_to_space,
    space_to_depth,
)


def random(*shape: int) -> torch.Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(0))


@pytest.mark.parametrize(("channels", "block"), [(1, 4), (2, 4), (3, 2)])
def test_depth_to_space_undoes_space_to_depth(channels: int, block: int) -> None:
    x = random(2, channels, 8, 8, 8)
    folded = space_to_depth(x, block)
    assert folded.shape == (2, channels * block**3, 8 // block, 8 // block, 8 // block)
    assert torch.equal(depth_to_space(folded, block), x)


def test_each_cell_holds_its_own_voxels_in_the_order_of_the_grid() -> None:
    x = random(1, 2, 8, 8, 8)
    folded = space_to_depth(x, 4)
    # Channel 1, offset (1, 2, 3) in the cell (0, 1, 1).
    assert folded[0, 64 + 16 * 1 + 4 * 2 + 3, 0, 1, 1] == x[0, 1, 1, 4 + 2, 4 + 3]


def test_cell_centres_lie_half_a_cell_off_the_walls() -> None:
    centres = cell_centres(4, torch.zeros(1))
    assert centres.shape == (3, 4, 4, 4)
    assert centres[:, 0, 1, 3].tolist() == [0.125, 0.375, 0.875]


def test_residual_block_passes_its_input_through() -> None:
    block = ResidualBlock(3).eval()
    torch.nn.init.zeros_(block.block.conv.weight)
    x = random(1, 3, 4, 4, 4)
    assert torch.equal(block(x), x)


def test_strided_block_halves_and_upsample_doubles() -> None:
    x = random(1, 3, 8, 8, 8)
    assert ConvBlock(3, 5, 2, 2).eval()(x).shape == (1, 5, 4, 4, 4)
    assert ConvBlock(3, 5, 3).eval()(x).shape == (1, 5, 8, 8, 8)
    assert Upsample(3, 2)(x).shape == (1, 2, 16, 16, 16)


def test_condition_says_nothing_before_training_and_scales_and_shifts_afterwards() -> None:
    block = ModulatedResidualBlock(2, 3).eval()
    x, one, other = random(1, 2, 4, 4, 4), torch.ones(1, 3), -torch.ones(1, 3)
    assert torch.equal(block(x, one), block(x, other))
    torch.nn.init.zeros_(block.conv.weight)
    block.modulation.bias.data = torch.tensor([0.0, 0.0, 2.0, -1.0])  # scale 1 and 1, shift 2 and -1
    expected = torch.tensor([2.0, -1.0 * 0.2])[None, :, None, None, None]
    torch.testing.assert_close(block(x, one) - x, expected.expand_as(x))
