from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from service.core import lookup
from service.core.grids import unpack_bits
from tests.training import tiny
from training.data.batches import DeformationBatch, DeformationSet, ViewSet, split_of, unpack
from training.data.fields import unpack_fields, unpack_nodes
from training.data.view_augmentation import ViewAugmentation
from training.networks.conditions import condition_planes


@pytest.fixture(scope="module")
def deformations(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tiny.write_deformations(tmp_path_factory.mktemp("deformations"))


@pytest.fixture(scope="module")
def views(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tiny.write_views(tmp_path_factory.mktemp("views"))


def test_bodies_are_split_for_good_and_all_are_used() -> None:
    splits = [split_of(group) for group in range(100)]
    assert splits.count("validation") == 5
    assert splits.count("test") == 10
    assert splits.count("train") == 85
    assert (split_of(0), split_of(1), split_of(2), split_of(3), split_of(23)) == (
        "validation", "test", "test", "train", "train",
    )  # fmt: skip


def test_unpacked_voxels_are_those_that_were_packed() -> None:
    group = tiny.deformation_group(3)
    np.testing.assert_array_equal(unpack(group["rest"][None])[0, 0].numpy() > 0.5, tiny.box(3))


def test_no_body_is_in_two_splits(deformations: Path) -> None:
    splits = {name: DeformationSet.load(deformations, name) for name in ("train", "validation", "test")}
    assert {name: len(samples.rest) for name, samples in splits.items()} == {"train": 3, "validation": 1, "test": 2}
    assert {name: len(samples) for name, samples in splits.items()} == {"train": 6, "validation": 2, "test": 4}
    bodies = [row.tobytes() for samples in splits.values() for row in samples.rest]
    assert len(set(bodies)) == len(bodies)


def test_every_sample_is_batched_with_its_own_body(deformations: Path) -> None:
    samples = DeformationSet.load(deformations, "train")
    batch = samples.batch(np.array([5, 0]))
    for i, group in enumerate((5, 3)):
        np.testing.assert_array_equal(batch.rest[i, 0].numpy() > 0.5, tiny.box(group))
    raw = tiny.deformation_group(5)
    np.testing.assert_array_equal(batch.condition[0].numpy(), raw["condition"][1])
    nodes = unpack_nodes(raw["nodes"])
    for name, field in (("displacement", batch.displacement), ("forward", batch.forward)):
        np.testing.assert_array_equal(field[0].numpy(), unpack_fields(raw[name], nodes)[1].astype(np.float32))
    for name, covered in (("deformed", batch.coverage), ("rest", batch.rest_coverage)):
        bits = raw[name][1] if name == "deformed" else raw[name]
        counted = unpack_bits(bits).reshape(32, 2, 32, 2, 32, 2).mean(axis=(1, 3, 5))
        np.testing.assert_array_equal(covered[0, 0].numpy(), counted)
    assert float(batch.peak[0]) == pytest.approx(float(raw["peak"][1]))


def test_a_batch_by_body_holds_only_loads_of_its_bodies(deformations: Path) -> None:
    samples = DeformationSet.load(deformations, "train")
    batch = samples.batch_by_body(2, 3, np.random.default_rng(0))
    assert batch.rest.shape[0] == 2
    assert batch.condition.shape[0] == 6
    for i in range(6):
        # Each of these bodies has its own height, and its loads push on the top.
        height = float(batch.rest_of_loads[i, 0].amax(dim=(0, 1)).sum()) / 64
        assert height == pytest.approx(float(batch.condition[i, 2]), abs=1 / 64)


def test_some_of_the_samples_keep_their_bodies_and_what_is_known_of_them(deformations: Path) -> None:
    samples = DeformationSet.load(deformations, "train")
    whole = samples.batch(np.array([1, 4]))
    chosen = np.zeros(len(samples), bool)
    chosen[[1, 4]] = True
    some = samples.only(chosen)
    assert len(some) == len(some.law) == 2
    batch = some.batch(np.array([0, 1]))
    for name in ("rest", "condition", "deformed", "displacement", "forward", "prior_forward", "prior_backward"):
        assert torch.equal(getattr(batch, name), getattr(whole, name)), name
    drawn = some.batch_by_body(2, 3, np.random.default_rng(0))  # the third body has no sample left
    assert {float(peak) for peak in drawn.peak} == {float(peak) for peak in whole.peak}


def test_sets_are_joined_with_every_sample_on_its_own_body(deformations: Path) -> None:
    one, other = (DeformationSet.load(deformations, name) for name in ("train", "test"))
    both = one.joined([other])
    assert (len(both), len(both.rest), len(both.family), len(both.law)) == (10, 5, 5, 10)
    batch, expected = both.batch(np.array([4, 9])), (one.batch(np.array([4])), other.batch(np.array([3])))
    for name in ("rest", "condition", "deformed", "displacement", "forward", "peak", "prior_forward", "prior_backward"):
        assert torch.equal(getattr(batch, name), torch.cat([getattr(part, name) for part in expected])), name
    assert one.joined([]).batch(np.array([4])).prior_forward.equal(one.batch(np.array([4])).prior_forward)
    blind = DeformationSet.load(deformations, "train", prior=False)
    assert blind.joined([blind]).prior is None


def test_all_is_every_body(deformations: Path) -> None:
    assert len(DeformationSet.load(deformations, "all").rest) == len(tiny.GROUPS)


def test_batches_of_one_seed_are_the_same(deformations: Path) -> None:
    samples = DeformationSet.load(deformations, "train")
    one, same = (samples.batch_by_body(2, 2, np.random.default_rng((3, 5))) for _ in range(2))
    assert torch.equal(one.condition, same.condition)
    assert torch.equal(one.rest, same.rest)


def random_batch() -> DeformationBatch:
    """A lopsided body under a field that is anything but symmetric."""
    rng = np.random.default_rng(0)
    rest = torch.zeros(1, 1, 64, 64, 64)
    rest[0, 0, 12:30, 20:50, 0:25] = 1.0
    rest[0, 0, 26:52, 24:31, 10:40] = 1.0
    coarse = torch.from_numpy(rng.uniform(-0.08, 0.08, (2, 3, 4, 4, 4))).float()
    displacement = torch.nn.functional.interpolate(coarse, size=(32, 32, 32), mode="trilinear", align_corners=False)
    condition = torch.tensor([[0.4, 0.7, 0.3, 0.6, 0.0, -0.8, -2.0, 0.3, 0.1], [0.8, 0.4, 0.6, 0, -1, 0, -3, 0.1, 0.2]])
    return DeformationBatch(
        rest=rest, condition=condition, deformed=warped(rest, displacement), displacement=displacement,
        coverage=torch.rand(2, 1, 32, 32, 32, generator=torch.Generator().manual_seed(0)), peak=torch.ones(2),
        forward=displacement.flip(4), rest_coverage=torch.rand(1, 1, 32, 32, 32),
        prior_forward=torch.nn.functional.avg_pool3d(displacement, 2), prior_backward=displacement.flip(2),
    )  # fmt: skip


def warped(rest: torch.Tensor, field: torch.Tensor) -> torch.Tensor:
    """The body under each field, as served."""
    body = rest[0, 0].numpy() > 0.5
    return torch.from_numpy(np.stack([lookup.warp(body, one) for one in field.contiguous().numpy()]))


IMAGES = [
    pytest.param(lambda batch: batch.mirrored(0), id="mirror x"),
    pytest.param(lambda batch: batch.mirrored(1), id="mirror y"),
    pytest.param(lambda batch: batch.transposed(), id="transpose"),
]


@pytest.mark.parametrize("image", IMAGES)
def test_an_image_of_the_image_is_the_original(image) -> None:
    batch = random_batch()
    twice = image(image(batch))
    for name in ("rest", "condition", "deformed", "displacement", "coverage", "peak", "forward", "rest_coverage",
                 "prior_forward", "prior_backward"):
        torch.testing.assert_close(getattr(twice, name), getattr(batch, name), msg=name)
    assert not torch.equal(image(batch).rest, batch.rest)


@pytest.mark.parametrize("image", IMAGES)
def test_the_image_of_the_deformation_is_the_deformation_of_the_image(image) -> None:
    batch = image(random_batch())
    torch.testing.assert_close(warped(batch.rest, batch.displacement), batch.deformed, atol=1e-4, rtol=0)


@pytest.mark.parametrize(
    ("image", "axes"),
    [(IMAGES[0].values[0], "flip x"), (IMAGES[1].values[0], "flip y"), (IMAGES[2].values[0], "swap")],
)
def test_the_load_follows_the_image(image, axes: str) -> None:
    """Planes of the imaged condition are the imaged planes, vectors included."""
    batch = random_batch()
    planes, expected = condition_planes(image(batch).condition, 8), condition_planes(batch.condition, 8)
    if axes == "swap":
        order = [0, 1, 3, 2, 4, 6, 5, 7, 9, 8, 10]
        expected = expected[:, order].transpose(2, 3)
    else:
        axis = 0 if axes == "flip x" else 1
        expected = expected.flip(2 + axis).clone()
        expected[:, [2 + axis, 5 + axis, 8 + axis]] *= -1.0
    torch.testing.assert_close(planes, expected, atol=1e-6, rtol=1e-5)
    torch.testing.assert_close(image(batch).condition[:, 6:], batch.condition[:, 6:])


def test_coverage_follows_the_image() -> None:
    batch = random_batch()
    assert torch.equal(batch.mirrored(1).coverage, batch.coverage.flip(3))
    assert torch.equal(batch.transposed().coverage, batch.coverage.transpose(2, 3))


def test_views_are_batched_in_the_order_observed_free(views: Path) -> None:
    samples = ViewSet.load(views, "test")
    assert len(samples) == 4
    assert samples.family == ("box",) * 4
    batch = samples.batch(np.array([2]))
    raw = tiny.view_group(2)
    for channel, key in enumerate(("observed", "free")):
        assert torch.equal(batch.view[0, channel], unpack(raw[key][:1])[0, 0])
    np.testing.assert_array_equal(batch.truth[0].numpy() > 0.5, tiny.box(2))


def test_changed_views_are_batched_like_others_and_only_as_far_as_asked(views: Path) -> None:
    samples, rows = ViewSet.load(views, "train"), np.array([2, 0])
    nothing = ViewAugmentation(mapped=0.0, holed=0.0, shadowed=0.0, strayed=0.0, thinned=0.0)
    plain = samples.batch(rows)
    same = samples.augmented_batch(rows, nothing, np.random.default_rng(0))
    assert torch.equal(same.view, plain.view)
    assert torch.equal(same.truth, plain.truth)
    changed = samples.augmented_batch(rows, replace(nothing, mapped=1.0), np.random.default_rng(0))
    assert changed.view.dtype == plain.view.dtype
    for i in range(2):
        assert not torch.equal(changed.truth[i], plain.truth[i])


def test_joined_views_are_those_of_one_set_and_then_of_the_other(views: Path) -> None:
    first, second = (ViewSet.load(views, split) for split in ("train", "test"))
    both = first.joined([second])
    assert both.family == first.family + second.family
    last = both.batch(np.array([len(both) - 1]))
    assert torch.equal(last.view, second.batch(np.array([len(second) - 1])).view)
    assert torch.equal(both.batch(np.array([1])).truth, first.batch(np.array([1])).truth)


def test_a_view_is_mirrored_left_to_right_only(views: Path) -> None:
    batch = ViewSet.load(views, "train").batch(np.array([0, 3]))
    batch.view[0, 0, 10, 20, 30] = batch.truth[0, 10, 20, 30] = 1.0
    mirrored = batch.mirrored()
    assert mirrored.view[0, 0, 10, 63 - 20, 30] == 1.0
    assert mirrored.truth[0, 10, 63 - 20, 30] == 1.0
    assert torch.equal(mirrored.mirrored().view, batch.view)
    # What lies before the object stays before it.
    assert torch.equal(mirrored.view[:, 1, 0], batch.view[:, 1, 0])
