"""Real objects whose scanned mesh was fitted to the frame: the service reconstructs the whole of them."""

from __future__ import annotations

from functools import cache

import numpy as np

from benchmarks.service.real_objects import RealObject, real_objects
from service.inference.registry import load_models
from service.pipeline import Pipeline
from service.settings import Settings
from tests.real_frames import needs_frames

pytestmark = needs_frames


@cache
def objects() -> tuple[RealObject, ...]:
    models = load_models(Settings().models, threads=1)
    return tuple(real_objects(Pipeline(models.reconstruction, models.deformation)))


def test_reconstructions_are_the_scanned_objects() -> None:
    found = {each.name: each.iou for each in objects()}
    assert len(found) >= 5
    assert np.mean(list(found.values())) >= 0.70, found


def test_solid_objects_come_out_well_one_by_one() -> None:
    # The mug's walls are thinner than a voxel.
    assert all(each.iou >= 0.70 for each in objects() if "mug" not in each.name)


def test_a_picture_shows_the_answer_beside_the_scan() -> None:
    picture = objects()[0].picture()
    assert picture.shape[1] == 2 * picture.shape[0]
    left, right = np.split(picture, 2, axis=1)
    assert np.abs(left - right).max() > 0.1
