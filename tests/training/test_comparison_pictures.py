from pathlib import Path

import cv2
import numpy as np

from tests.training import tiny
from training.comparison import Contender
from training.comparison_pictures import worst
from training.data.batches import DeformationSet
from training.data.contact_sheet import TILE


def test_each_of_the_worst_has_its_answer_below_it_five_to_a_row(tmp_path: Path) -> None:
    samples = DeformationSet.load(tiny.write_deformations(tmp_path), "test", prior=False)
    true = Contender("the truth", lambda batch: (batch.deformed.numpy(), None))
    found = {"worst": [{"row": number % 4, "family": "box", "iou": 1.0} for number in range(7)]}
    sheet = cv2.imdecode(np.frombuffer(worst(found, true, samples), np.uint8), cv2.IMREAD_COLOR)
    assert sheet.shape == (4 * TILE, 5 * TILE, 3)
    tiles = sheet.reshape(4, TILE, 5, TILE, 3).swapaxes(1, 2)[:, :, TILE // 5 :]  # without what is written on them
    np.testing.assert_array_equal(tiles[1], tiles[0])  # the truth below the truth
    np.testing.assert_array_equal(tiles[3, :2], tiles[2, :2])
    assert (tiles[2:, 2:] == 255).all()  # there are but seven
    drawn = (tiles[:3, :2] < 250).any(axis=-1)
    assert drawn.mean(axis=(2, 3)).min() > 0.05
    assert not drawn[..., [0, -1]].any()  # nothing is cut off at the sides
    assert not drawn[:, :, -1].any()
