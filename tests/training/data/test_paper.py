"""The paper's sets: every entry of the grid once, the linear law, and numbers that fit together."""

import dataclasses

import numpy as np
import pytest

from service.core.grids import unpack_bits
from training.data.catalogue import PUSH_N, SETS
from training.data.paper import BRIDGE_M, MEMBER_M, PaperConfig, bridge, draw_group
from training.simulation.shapes import min_thickness, tight_bounds

SMALL = PaperConfig(young_modulus_pa=(1e9, 4e9, 3), poisson_ratio=(0.1, 0.4, 2), force_n=(PUSH_N, 1), cells=24)


def config(name: str) -> PaperConfig:
    found = SETS[name].config
    assert isinstance(found, PaperConfig)
    return found


@pytest.mark.parametrize(
    ("name", "count", "young", "poisson", "forces", "places", "stretches"),
    [
        ("bridge-1x400", 400, 400, 1, 1, 1, 1),
        ("bridge-20x20", 400, 20, 20, 1, 1, 1),
        ("bridge-force", 310, 1, 1, 31, 10, 1),
        ("stretch", 512, 1, 1, 1, 1, 512),
    ],
)
def test_every_combination_of_the_papers_grid_is_there_once(
    name: str, count: int, young: int, poisson: int, forces: int, places: int, stretches: int
) -> None:
    """Wang et al. (IJCAI 2018), sections 4.1 and 4.3."""
    entries = [config(name).entry(index) for index in range(count)]
    assert SETS[name].groups == config(name).count == count == len(set(entries))
    distinct = [len({entry[i] for entry in entries}) for i in range(5)]
    assert distinct == [young, poisson, forces, places, stretches]
    assert min(entry.force_n for entry in entries) > 0
    assert max(entry.young_modulus_pa for entry in entries) <= 23e9 * (1 + 1e-9)


def test_moduli_are_log_uniform_and_ratios_uniform() -> None:
    entries = [config("bridge-20x20").entry(index) for index in range(400)]
    young = np.unique([entry.young_modulus_pa for entry in entries])
    np.testing.assert_allclose(young[1:] / young[:-1], 20 ** (1 / 19))
    assert young[-1] == pytest.approx(23e9)
    poisson = np.unique([entry.poisson_ratio for entry in entries])
    np.testing.assert_allclose(np.diff(poisson), 0.49 / 19)


@pytest.mark.parametrize("name", ["bridge-1x400", "bridge-20x20", "bridge-force"])
def test_a_tenth_of_a_set_is_spread_over_it(name: str) -> None:
    entries = np.array([config(name).entry(index)[:4] for index in range(config(name).count)])
    tenth = entries[: len(entries) // 10]
    for part, whole in zip(tenth.T, entries.T, strict=True):
        if np.ptp(whole) > 0:
            ranks = np.searchsorted(np.sort(whole), part) / len(whole)
            assert ranks.min() < 0.15
            assert ranks.max() > 0.8
            assert ranks.mean() == pytest.approx(0.475, abs=0.12)


def test_the_bridge_is_a_deck_on_two_piers_thick_enough_to_simulate() -> None:
    shape = bridge()
    np.testing.assert_allclose(np.ptp(tight_bounds(shape), axis=1), BRIDGE_M, atol=2e-3)
    # The deck reaches a sixth of the length beyond the piers, as in the authors' data.
    inside = np.array([[0, 0, 0.36], [0.3, 0, 0.05], [-0.3, 0, 0.05], [0.49, 0, 0.36]], np.float32)
    outside = np.array([[0, 0, 0.1], [0.45, 0, 0.1], [-0.45, 0, 0.2]], np.float32)
    assert (shape.distance(inside) < 0).all()
    assert (shape.distance(outside) > 0).all()
    assert min_thickness(shape) * SMALL.cells == pytest.approx(MEMBER_M * 0.7 * SMALL.cells, abs=0.3)
    assert config("bridge-1x400").cells * MEMBER_M * 0.7 > 3.0


def test_a_sample_is_that_of_its_entry() -> None:
    groups = [draw_group(SMALL, index) for index in range(SMALL.count)]
    for index, group in enumerate(groups):
        entry = SMALL.entry(index)
        assert len(group["sample"]) == 1
        assert group["young_modulus_pa"][0] == pytest.approx(entry.young_modulus_pa)
        assert group["force_n"][0] == pytest.approx(entry.force_n)
        assert group["condition"][0, 7] == pytest.approx(entry.poisson_ratio)
        load_number = entry.force_n / (entry.young_modulus_pa * float(group["edge_m"]) ** 2)
        assert group["condition"][0, 6] == pytest.approx(np.log10(load_number), abs=1e-5)
        assert list(group["law"]) == ["linear"]
    # Linear: peak times modulus is the same for one Poisson's ratio.
    for ratio in (0.1, 0.4):
        product = [
            float(group["peak"][0] * group["young_modulus_pa"][0])
            for group in groups
            if group["condition"][0, 7] == pytest.approx(ratio)
        ]
        assert len(product) == 3
        np.testing.assert_allclose(product, product[0], rtol=1e-4)


def test_places_run_along_the_top_and_are_recorded() -> None:
    pressed = dataclasses.replace(SMALL, young_modulus_pa=(1e9, 1e9, 1), poisson_ratio=(0.3, 0.3, 1), locations=5)
    groups = sorted((draw_group(pressed, index) for index in range(5)), key=lambda group: group["location"][0, 0])
    contact = np.array([group["condition"][0, :3] for group in groups])
    np.testing.assert_allclose([group["location"][0] for group in groups], [[i, i / 4] for i in range(5)])
    np.testing.assert_allclose(np.diff(contact[:, 0]), 0.7 * 0.92 / 5, atol=0.01)
    top = np.argwhere(unpack_bits(groups[0]["rest"]))[:, 2].max() + 1
    np.testing.assert_allclose(contact[:, 2], top / 64, atol=1 / 64)
    for group in groups:
        np.testing.assert_allclose(group["condition"][0, 3:6], [0, 0, -1], atol=1e-6)


def test_a_draw_is_the_same_whatever_was_drawn_before() -> None:
    first = draw_group(SMALL, 4)
    draw_group(SMALL, 1)
    again = draw_group(SMALL, 4)
    for key in first:
        assert first[key].tobytes() == again[key].tobytes(), key
