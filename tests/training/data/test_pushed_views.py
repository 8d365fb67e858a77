"""Loads and bodies of an `everyday` set in the view grids of noisy frames of them."""

from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage

from service.core.grids import Grid, pack_bits, unpack_bits
from tests.training import pushed
from training.data.generate import Dropped
from training.data.pushed_views import PushedViewsConfig, PushedViewSet, body_again, draw_group, frames, moved_condition
from training.data.store import Store


@pytest.fixture(scope="module")
def config(tmp_path_factory: pytest.TempPathFactory) -> PushedViewsConfig:
    return pushed.write_bodies(tmp_path_factory.mktemp("bodies"))


@pytest.fixture(scope="module")
def samples(config: PushedViewsConfig, tmp_path_factory: pytest.TempPathFactory) -> PushedViewSet:
    return PushedViewSet.load(pushed.write_views(tmp_path_factory.mktemp("views"), config), "all")


def test_a_load_is_told_in_units_of_the_other_grid() -> None:
    quarter = np.array([[0.0, -1.0, 0.0, 0.3], [1.0, 0.0, 0.0, -0.1], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    told = moved_condition(
        np.array([0.5, 0.25, 0.4, 1, 0, 0, -2.0, 0.3, 0.1], np.float32), 0.2, Grid(0.4 / 64, quarter)
    )
    # The contact at (0.1, 0.05, 0.08) m is at (0.15, 0.2, 0.08) m of the grid; twice the edge, a quarter of the number.
    expected = [0.375, 0.5, 0.2, 0.0, -1.0, 0.0, -2.0 - np.log10(4), 0.3, 0.05]
    np.testing.assert_allclose(told, expected, atol=1e-6)


def test_what_was_observed_lies_on_the_body_of_the_set(samples: PushedViewSet) -> None:
    for view, (push, _) in enumerate(samples.pushes):
        body = samples.seen(push, push.rest)
        near = ndimage.binary_dilation(body, iterations=3) & ~ndimage.binary_erosion(body, iterations=3)
        observed, free = unpack_bits(samples.observed[view]), unpack_bits(samples.free[view])
        assert observed.sum() > 100
        assert near[observed].mean() > 0.9
        assert free[ndimage.binary_erosion(body, iterations=2)].mean() < 0.01
        x, y, z = (push.condition[:3] * 64).astype(int)
        assert near[x, y, min(z, 63)]


def test_a_batch_holds_the_deformed_body_in_the_view_grid(samples: PushedViewSet) -> None:
    weak, strong = samples.pushes[0]
    batch = samples.batch([weak, strong])
    assert batch.view.shape == (2, 2, 64, 64, 64)
    rest, bodies = samples.seen(weak, weak.rest), batch.truth.numpy() > 0.5
    # A shear keeps the volume, but for what the view grid cuts off of the stronger one.
    assert bodies[0].sum() == pytest.approx(rest.sum(), rel=0.03)
    # The farther it is sheared, the farther its matter lies along the force.
    along = np.stack(np.indices((64,) * 3), axis=-1) @ weak.condition[3:6]
    assert along[rest].mean() + 0.5 < along[bodies[0]].mean() < along[bodies[1]].mean() - 0.5


def test_a_mirror_image_is_another_batch_and_twice_the_same(samples: PushedViewSet) -> None:
    batch = samples.batch([samples.pushes[0][0]])
    mirrored = batch.mirrored()
    assert mirrored.condition[0, 1] == 1 - batch.condition[0, 1]
    assert mirrored.condition[0, 4] == -batch.condition[0, 4]
    assert (mirrored.truth[0, :, 0] == batch.truth[0, :, 63]).all()
    again = mirrored.mirrored()
    for name in ("view", "condition", "truth"):
        np.testing.assert_allclose(getattr(again, name), getattr(batch, name), atol=1e-6)


def test_a_frame_is_the_same_whenever_it_is_asked_for(config: PushedViewsConfig, samples: PushedViewSet) -> None:
    ((number, frame),) = frames(config, pushed.GROUPS[0])
    assert number == 0
    assert (pack_bits(frame.view.observed) == samples.observed[0]).all()
    assert frame.hints.mask is not None


def test_a_family_that_is_drawn_otherwise_by_now_is_left_out(tmp_path: Path) -> None:
    config = pushed.write_bodies(tmp_path)
    store = Store(tmp_path)
    index = pushed.GROUPS[0]
    group = store.group(index)
    assert body_again(store, index).bounds[2, 1] > 0
    store.write_group(index, group | {"rest": pack_bits(np.rot90(unpack_bits(group["rest"]), axes=(0, 2)))})
    with pytest.raises(Dropped, match="drawn_otherwise"):
        draw_group(config, index)
