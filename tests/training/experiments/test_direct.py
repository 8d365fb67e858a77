"""The direct network from drawn views to its trained weights, and beside the cascade as served."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch

from benchmarks.service.cascade import CASCADE, CEILING, DIRECT, ROWS, STILL, Rivals, judge, markdown, summary
from service.inference.registry import load_models
from service.pipeline import Pipeline
from service.settings import Settings
from tests.training import pushed, tiny
from training.data.pushed_views import PushedViewsConfig, PushedViewSet
from training.experiments.direct import FitDirectConfig, fit_direct, trained, validate
from training.networks.direct import DirectConfig, DirectNetwork
from training.runs import Run, RunError

CONFIG = FitDirectConfig(
    network=DirectConfig(shape=tiny.RECONSTRUCTION, hidden=8), optimizer=tiny.OPTIMIZER, batch=1, steps=4,
    validate_every=2, validation_samples=2,
)  # fmt: skip


@pytest.fixture(scope="module")
def bodies(tmp_path_factory: pytest.TempPathFactory) -> PushedViewsConfig:
    return pushed.write_bodies(tmp_path_factory.mktemp("bodies"))


@pytest.fixture(scope="module")
def views(bodies: PushedViewsConfig, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return pushed.write_views(tmp_path_factory.mktemp("views"), bodies)


def test_a_run_goes_on_and_tells_whose_weights_it_began_with(views: Path, tmp_path: Path) -> None:
    begin_from = tiny.save_checkpoint(tiny.reconstruction_network(), tiny.FIT_RECONSTRUCTION, tmp_path / "shape")
    fit_direct(views, Run(tmp_path / "run"), CONFIG, begin_from)
    found, threshold = trained(tmp_path / "run", CONFIG)
    fresh = DirectNetwork(CONFIG.network).state_dict()
    assert not torch.equal(found.state_dict()["shape.seen.weight"], fresh["shape.seen.weight"])
    state = torch.load(tmp_path / "run" / "checkpoint.pt", weights_only=True)
    assert state["step"] == 4
    assert state["config"]["begun_from"].startswith("shape at step 7")
    with pytest.raises(RunError, match="another steps"):
        fit_direct(views, Run(tmp_path / "run"), dataclasses.replace(CONFIG, steps=5), begin_from)
    figures = validate(found, PushedViewSet.load(views, "validation"), 2)
    assert 0.0 <= figures["iou"] <= 1.0
    assert figures["threshold"] == threshold
    assert 0.5 < figures["nothing_moves"] < 0.95


def test_both_are_judged_on_the_same_questions(bodies: PushedViewsConfig) -> None:
    models = load_models(Settings().models, threads=1)
    cascade = Pipeline(models.reconstruction, models.deformation)
    torch.manual_seed(0)
    rivals = Rivals(cascade, models.deformation.manifest.threshold, DirectNetwork(CONFIG.network).eval(), 0.5)
    found = judge(bodies, rivals)
    assert len(found["rows"]) == 2  # both loads in the one view of the one test body
    for row in found["rows"]:
        assert row[STILL][0] == pytest.approx(row["identity"])
        assert row[CEILING][0] > 0.85
        assert row[CEILING][1] == 1.0
        # A block seen alone: half of it is there whatever is made of the push. Random weights know nothing.
        assert row[CASCADE][0] > 0.4 > row[DIRECT][0] + 0.1
    first, second = found["rows"]
    figures = summary(found | {"rows": [first, second, first | {"group": 99, "identity": 0.99}]})
    ahead = [row[CASCADE][0] - row[DIRECT][0] for row in (first, second)]
    assert figures["iou"][CASCADE][0] == pytest.approx((2 * first[CASCADE][0] + second[CASCADE][0]) / 3)
    assert figures["iou_moved"][CASCADE][0] == pytest.approx((first[CASCADE][0] + second[CASCADE][0]) / 2)
    assert figures["cascade_ahead"]["mean"] == pytest.approx((np.mean(ahead) + ahead[0]) / 2)
    assert figures["cascade_ahead"]["error"] == pytest.approx(abs(np.mean(ahead) - ahead[0]) / 2)
    text = markdown(figures)
    for name in ROWS:
        assert f"| {name} | " in text
