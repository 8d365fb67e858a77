import dataclasses
import json
import pickle

import numpy as np
import pytest

from training.data.catalogue import CYLINDER_LIKE, SETS
from training.data.everyday import EverydayConfig, draw_group
from training.simulation.families import FAMILIES


@pytest.mark.parametrize("name", SETS)
def test_a_set_can_be_sent_to_a_worker_and_written_down(name: str) -> None:
    data_set = SETS[name]
    assert pickle.loads(pickle.dumps(data_set.draw)).args == (data_set.config,)
    configuration = json.loads(json.dumps(data_set.configuration(name, 7)))
    assert configuration["set"] == name
    assert configuration["groups"] == 7


def test_seeds_change_random_sets_only() -> None:
    assert SETS["everyday"].with_seed(3).config.seed == 3
    assert SETS["views"].with_seed(3).config.seed == 3
    assert SETS["stretch"].with_seed(3) == SETS["stretch"]


def test_the_number_of_pushes_can_be_chosen_where_they_are_drawn() -> None:
    assert SETS["everyday"].with_loads(1).config == dataclasses.replace(SETS["everyday"].config, loads=1)
    for name in ("views", "stretch"):
        with pytest.raises(ValueError, match="drawn pushes"):
            SETS[name].with_loads(1)


def test_gentle_pushes_move_a_body_a_little_by_the_linear_law() -> None:
    config = SETS["gentle"].config
    assert isinstance(config, EverydayConfig)
    group = draw_group(dataclasses.replace(config, families=("cylinder",), cells=16, thickness=1.8), 0)
    assert list(group["law"]) == ["linear"] * 2
    assert ((group["peak"] > 0.0075) & (group["peak"] < 0.0305)).all()


def test_a_network_trained_on_cylinders_has_seen_nothing_of_the_other_categories() -> None:
    cylinders, others = (set(SETS[name].config.families) for name in ("cylinders", "cross-category"))
    assert cylinders == set(CYLINDER_LIKE) <= set(FAMILIES)
    assert not cylinders & others
    assert cylinders | others == set(FAMILIES)


def test_a_cylinder_is_pushed_at_ten_places_along_its_top_by_the_linear_law() -> None:
    config = SETS["cylinders"].config
    assert isinstance(config, EverydayConfig)
    group = draw_group(dataclasses.replace(config, families=("cylinder",), cells=16, thickness=1.8), 0)
    assert set(group["law"]) == {"linear"}
    places = group["location"][:, 0]
    assert 8 <= len(places) <= 10
    assert len(set(places)) == len(places)
    assert (np.diff(group["condition"][:, 0]) > 0).all()
    assert ((group["young_modulus_pa"] >= 0.05 * 23e9) & (group["young_modulus_pa"] <= 23e9)).all()
    # Pushed into the top, straight down or aslant.
    assert (group["condition"][:, 5] <= 1e-6).all()
    assert (group["identity_iou"] < 0.99).all()
