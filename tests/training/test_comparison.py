import numpy as np
import pytest

from tests.training import tiny
from training.comparison import compare, contenders, markdown, report
from training.data.batches import DeformationSet


@pytest.fixture(scope="module")
def sets(tmp_path_factory: pytest.TempPathFactory) -> tuple[DeformationSet, DeformationSet]:
    root = tiny.write_deformations(tmp_path_factory.mktemp("deformations"))
    return DeformationSet.load(root, "train", prior=False), DeformationSet.load(root, "test")


def test_every_rival_is_scored_on_the_same_samples(sets: tuple[DeformationSet, DeformationSet]) -> None:
    training, test = sets
    rows = np.arange(len(test))
    table = compare(contenders(tiny.deformation_network(), 0.5, training, [8], [6]), test, rows)
    assert [scores.name for scores in table] == [
        "nothing moves", "mean training shape", "4 nearest conditions", "linear FEM, 8³",
        "neo-Hookean FEM, 6³", "coarse solve alone", "network",
    ]  # fmt: skip
    np.testing.assert_allclose(table[0].iou, test.identity_iou, atol=1e-6)
    # A solve costs its time although the set has kept its answer.
    assert table[5].ms > table[0].ms
    assert not table[0].changed.any()
    # The blocks are sheared, which no solve of theirs would do; but they are pushed that way.
    assert table[5].iou.mean() > table[1].iou.mean()
    found = report(table, test, rows)
    assert found["bands"]["all"]["nothing moves"]["skill"] == pytest.approx(0.0, abs=1e-6)
    assert found["bands"]["family: box"]["samples"] == len(test) == found["samples"]
    assert len(found["worst"]) == min(10, len(test))
    for parts in found["curves"].values():
        assert sum(part["samples"] for part in parts) == len(test)
        middles = [part["middle"] for part in parts]
        assert middles == sorted(middles)
        everywhere = np.average([part["iou"]["network"] for part in parts], weights=[p["samples"] for p in parts])
        assert everywhere == pytest.approx(table[-1].iou.mean())
    voxels, said, true = np.array(found["calibration"]["nothing moves"])
    assert not voxels[1:-1].any()  # it is always sure: what counts is where it is wrong
    assert said.sum() == voxels[-1]
    assert not true[-1]
    still, solve = (found["bands"]["all"][name] for name in ("nothing moves", "coarse solve alone"))
    # A body sheared by s·z and clamped at 0 moves by half of its peak on average, and by 95 % at the 95th percentile.
    assert still["displacement_error"] == pytest.approx(0.5, abs=0.05)
    assert still["displacement_error_p95"] == pytest.approx(0.95, abs=0.06)
    assert still["displacement_error_voxels"] == pytest.approx(64 * float(test.peak.mean()) / 2, rel=0.1)
    assert solve["displacement_error_voxels_p95"] < still["displacement_error_voxels_p95"]
    assert "displacement_error" not in found["bands"]["all"]["linear FEM, 8³"]
    assert still["iou_at_0.8"] == pytest.approx(still["iou"])
    assert 0.0 < found["calibration_error"]["coarse solve alone"] < found["calibration_error"]["nothing moves"] == 1.0
    text = markdown(found)
    assert text.count("\n| network | ") == 1
    assert "| load number: highest third |" in text


def test_a_network_that_does_not_deform_is_no_contender(sets: tuple[DeformationSet, DeformationSet]) -> None:
    with pytest.raises(TypeError, match="ReconstructionNetwork deforms nothing"):
        contenders(tiny.reconstruction_network(), 0.5, sets[0], [])
