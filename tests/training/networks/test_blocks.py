"""What networks are built from, against plain torch."""

from __future__ import annotations

import pytest
import torch

from training.networks.blocks import Stem


@pytest.mark.parametrize("factor", [2, 4])
def test_a_stem_is_a_convolution_whose_kernels_touch(factor: int) -> None:
    torch.manual_seed(0)
    block = Stem(3, 5, factor).eval()
    block.norm.running_mean.uniform_(-1, 1)
    x = torch.randn(2, 3, 8, 12)
    expected = torch.nn.functional.leaky_relu(block.norm(block.conv(x)), 0.2)
    assert expected.shape == (2, 5, 8 // factor, 12 // factor)
    torch.testing.assert_close(block(x.permute(0, 2, 3, 1)), expected)
