
import numpy as np
import pytest
import torch

from service.core.prior import ElasticPrior
from tests.training import tiny
from training.data.batches import DeformationSet
from training.data.lattice import LINEAR_PEAK, LatticeBatch, LatticeSet


@pytest.fixture(scope="module")
def samples(tmp_path_factory: pytest.TempPathFactory) -> DeformationSet:
    return DeformationSet.load(tiny.write_deformations(tmp_path_factory.mktemp("deformations")), "train")


@pytest.fixture(scope="module")
def whole(samples: DeformationSet) -> LatticeSet:
    """As it would be by a law that holds at every size."""
    return LatticeSet.of(with_law(samples, "neo_hookean"))


def with_law(samples: DeformationSet, law: str) -> DeformationSet:
    object.__setattr__(samples := samples.only(np.ones(len(samples), bool)), "law", (law,) * len(samples))
    return samples


def test_a_cell_holds_the_mean_over_the_body_in_it(samples: DeformationSet, whole: LatticeSet) -> None:
    assert len(whole) == len(samples)
    batch = samples.batch(np.array([3]))
    body = samples.body[3]
    weight, field = batch.rest_coverage[0, 0].numpy(), batch.forward[0].numpy()
    block = (slice(14, 16), slice(16, 18), slice(6, 8))  # cell 7, 8, 3
    assert whole.covered[body][7, 8, 3] == pytest.approx(weight[block].mean())
    expected = (field[(slice(None), *block)] * weight[block]).sum(axis=(1, 2, 3)) / weight[block].sum()
    np.testing.assert_allclose(whole.forward[3][:, 7, 8, 3], expected, rtol=1e-5)
    assert not whole.forward[3][:, whole.covered[body] == 0].any()


def test_a_batch_is_that_of_the_whole_set(samples: DeformationSet, whole: LatticeSet) -> None:
    batch = whole.batch_by_body(2, 2, np.random.default_rng(1))
    other = samples.batch_by_body(2, 2, np.random.default_rng(1))
    for name in ("rest", "condition", "peak", "prior_forward"):
        assert torch.equal(getattr(batch, name), getattr(other, name)), name


def test_a_linear_sample_that_went_far_is_scaled_down(samples: DeformationSet, whole: LatticeSet) -> None:
    linear = LatticeSet.of(with_law(samples, "linear"))
    part = np.minimum(1.0, LINEAR_PEAK / samples.peak)
    assert part.min() < 0.5
    np.testing.assert_allclose(linear.peak, part * samples.peak, rtol=1e-5)
    np.testing.assert_allclose(linear.forward, part[:, None, None, None, None] * whole.forward, rtol=1e-5, atol=1e-9)
    np.testing.assert_allclose(10.0 ** linear.condition[:, 6], part * 10.0 ** samples.condition[:, 6], rtol=1e-4)
    row = int(part.argmin())
    body = samples.batch(np.array([row])).rest[0, 0].numpy() > 0.5
    solved = ElasticPrior(body, float(samples.condition[row, 7])).displacements([linear.condition[row]]).forward[0]
    np.testing.assert_allclose(linear.prior(np.array([row]))[0][0], solved, atol=2e-3 * np.abs(solved).max())


@pytest.mark.parametrize("image", ["mirror x", "mirror y", "transpose"])
def test_images_are_those_of_the_whole_batch(samples: DeformationSet, whole: LatticeSet, image: str) -> None:
    def of(batch):  # type: ignore[no-untyped-def]
        return batch.transposed() if image == "transpose" else batch.mirrored("xy".index(image[-1]))

    batch = whole.batch_by_body(2, 2, np.random.default_rng(1))
    turned: LatticeBatch = of(batch)
    other = of(samples.batch_by_body(2, 2, np.random.default_rng(1)))
    for name in ("rest", "condition", "peak", "prior_forward"):
        assert torch.equal(getattr(turned, name), getattr(other, name)), name
    means = torch.nn.functional.avg_pool3d(other.rest_coverage, 2)
    assert torch.allclose(turned.rest_coverage, means)
    weights = other.rest_coverage.repeat_interleave(2, dim=0)
    pooled = torch.nn.functional.avg_pool3d(other.forward * weights, 2) / means.repeat_interleave(2, 0).clamp(min=1e-6)
    assert torch.allclose(turned.forward, pooled, atol=1e-6)
