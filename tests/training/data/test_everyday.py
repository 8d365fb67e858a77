"""One small body at 16 cells an edge: cheap, and every column must agree with every other."""

import dataclasses
import functools

import numpy as np
import pytest
import torch

from service.core.alignment import HORIZONTAL_FILL, VERTICAL_FILL
from service.core.contact import surface_voxels
from service.core.grids import unpack_bits
from training.data.batches import unpack
from training.data.everyday import EverydayConfig, coarsen, draw_group
from training.data.generate import Dropped
from training.metrics import iou
from training.networks.deformation import sample_field

CONFIG = EverydayConfig(seed=12, cells=16, thickness=1.8, loads=1, fractions=(0.5, 1.0))


@functools.cache
def drawn(seed: int) -> dict[str, np.ndarray]:
    """The first body of a seed that can be simulated."""
    config = dataclasses.replace(CONFIG, seed=seed)
    for index in range(20):
        try:
            return draw_group(config, index)
        except Dropped:
            continue
    raise AssertionError("twenty draws without a body")


@pytest.fixture(params=[12, 11])
def group(request: pytest.FixtureRequest) -> dict[str, np.ndarray]:
    return drawn(request.param)


def deformed(group: dict[str, np.ndarray], row: int) -> np.ndarray:
    return unpack_bits(group["deformed"][row])


def test_a_group_is_drawn_from_its_seed_alone() -> None:
    first, second = drawn(12), drawn.__wrapped__(12)
    assert first.keys() == second.keys()
    for key in first:
        assert first[key].tobytes() == second[key].tobytes(), key
    assert drawn(11)["rest"].tobytes() != first["rest"].tobytes()


def test_the_body_lies_as_the_service_would_align_it(group: dict[str, np.ndarray]) -> None:
    """Standing on the floor, centred, and as large as its width or its height allows."""
    filled = np.argwhere(unpack_bits(group["rest"]))
    low, high = filled.min(axis=0), filled.max(axis=0) + 1
    assert low[2] == 0
    np.testing.assert_allclose((low + high)[:2] / 2, 32, atol=1.5)
    room = np.array([HORIZONTAL_FILL, HORIZONTAL_FILL, VERTICAL_FILL]) * 64 - (high - low)
    assert room.min() == pytest.approx(0.0, abs=2.0)


def test_conditions_are_loads_on_the_surface(group: dict[str, np.ndarray]) -> None:
    condition = group["condition"]
    surface = (np.argwhere(surface_voxels(unpack_bits(group["rest"]))) + 0.5) / 64
    for row in condition:
        assert np.linalg.norm(surface - row[:3], axis=1).min() < 1.5 / 64
    np.testing.assert_allclose(np.linalg.norm(condition[:, 3:6], axis=1), 1.0, atol=1e-6)
    assert ((condition[:, 7] >= 0.0) & (condition[:, 7] <= 0.49)).all()
    assert ((condition[:, 8] >= CONFIG.patch_radius[0]) & (condition[:, 8] <= CONFIG.patch_radius[1])).all()


def test_load_steps_grow_and_the_body_with_them(group: dict[str, np.ndarray]) -> None:
    fraction, log_load = group["sample"][:, 1], group["condition"][:, 6]
    order = np.argsort(fraction)
    np.testing.assert_allclose(np.diff(log_load[order]), np.diff(np.log10(fraction[order])), atol=6e-3)
    assert (np.diff(group["peak"][order]) > 0).all()
    assert (np.diff(group["identity_iou"][order]) < 0).all()
    laws = [str(law) for law in group["law"][order]]
    assert laws[0] == "linear"
    assert set(laws[1:]) == {"neo_hookean"}


def test_the_overlap_is_that_of_the_stored_bits(group: dict[str, np.ndarray]) -> None:
    rest = unpack_bits(group["rest"])
    for row, stored in enumerate(group["identity_iou"]):
        assert float(stored) == pytest.approx(iou(rest, deformed(group, row)), abs=1e-6)


def test_coverage_counts_the_deformed_voxels_of_each_cell(group: dict[str, np.ndarray]) -> None:
    for row, coverage in enumerate(group["coverage"]):
        counted = deformed(group, row).reshape(32, 2, 32, 2, 32, 2).sum(axis=(1, 3, 5))
        np.testing.assert_array_equal(coverage, counted)
        assert not group["displacement"][row][:, coverage == 0].any()


def test_the_field_vanishes_towards_the_clamp(group: dict[str, np.ndarray]) -> None:
    """Nodes lie 1/64 above the floor, a quarter of a cell: there the body follows at most a few per cent."""
    for row, coverage in enumerate(group["coverage"]):
        length = np.linalg.norm(group["displacement"][row].astype(float), axis=0)
        floor, high = (length[:, :, z][coverage[:, :, z] > 0].mean() for z in (0, 7))
        assert floor < 0.05 * group["peak"][row]
        assert floor < 0.25 * high


def test_the_peak_is_that_of_the_field(group: dict[str, np.ndarray]) -> None:
    length = np.linalg.norm(group["displacement"].astype(float), axis=1).max(axis=(1, 2, 3))
    np.testing.assert_allclose(length, group["peak"], rtol=0.1)


def test_the_field_leads_from_the_deformed_body_back_into_the_one_at_rest(group: dict[str, np.ndarray]) -> None:
    """y - u(y) lies in the undeformed body for the deformed body's voxels: the convention that warping relies on."""
    rest = unpack(group["rest"][None])
    for row in range(len(group["sample"])):
        places = torch.from_numpy((np.argwhere(deformed(group, row)) + 0.5) / 64).float()[None]
        field = torch.from_numpy(group["displacement"][row]).float()[None]
        back = places - sample_field(field, places).transpose(1, 2)
        hit = float((sample_field(rest, back) > 0.5).float().mean())
        # What is missing lies within half a voxel of the surface, where the coarse field is blurred.
        assert hit > 0.9


def test_thin_bodies_are_dropped_by_that_name() -> None:
    config = dataclasses.replace(CONFIG, thickness=16.0)
    with pytest.raises(Dropped) as caught:
        draw_group(config, 0)
    assert caught.value.reason == "thin"


def test_coarsening_averages_inside_only() -> None:
    backward = np.full((3, 64, 64, 64), np.nan, np.float32)
    backward[:, 10, 20, 30] = 0.1, 0.2, 0.3
    backward[:, 11, 20, 30] = 0.5
    displacement, coverage = coarsen(backward)
    assert coverage[5, 10, 15] == 2
    assert coverage.sum() == 2
    np.testing.assert_allclose(displacement[:, 5, 10, 15], [0.3, 0.35, 0.4], atol=1e-3)
    assert np.isfinite(displacement).all()


@pytest.mark.slow
def test_a_body_of_the_real_set_gives_every_load_step() -> None:
    """The configuration that data sets are drawn with, on the first body that can be simulated."""
    config = EverydayConfig(seed=12, loads=1)
    group = draw_group(config, 0)
    assert len(group["sample"]) == 4
    assert 0.25 < float(group["identity_iou"].min()) < 0.9
    np.testing.assert_allclose(np.sort(group["sample"][:, 1])[1:], [1 / 3, 2 / 3, 1.0], atol=1e-4)
