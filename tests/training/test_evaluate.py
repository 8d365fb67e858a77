import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch

from service.core.lookup import EVEN
from tests.training import tiny
from training.data.batches import DeformationSet, ViewSet
from training.evaluate import (
    THRESHOLDS,
    as_served,
    evaluate,
    evaluate_deformation,
    evaluate_reconstruction,
    tune_share,
    tune_temperature,
    tune_threshold,
)
from training.networks.deformation import DeformationNetwork
from training.networks.physnet import PhysNet
from training.networks.reconstruction import ReconstructionNetwork


@pytest.fixture(scope="module")
def deformations(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tiny.write_deformations(tmp_path_factory.mktemp("deformations"))


@pytest.fixture(scope="module")
def views(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tiny.write_views(tmp_path_factory.mktemp("views"))


class Knowing(DeformationNetwork):
    """Answers with a share of the true shear."""

    def __init__(self, share: float) -> None:
        super().__init__(dataclasses.replace(tiny.DEFORMATION, prior=False))
        self.share = share

    def forward(self, rest, condition, noise, prior):
        heights = (torch.arange(16) + 0.5) / 16
        field = torch.zeros(len(condition), 3, 16, 16, 16)
        field[:, 0] = (self.share * tiny.SHEAR * 10.0 ** condition[:, 6])[:, None, None, None] * heights
        latent = torch.zeros(len(condition), 3)
        return field, latent, latent


class Seeing(ReconstructionNetwork):
    """Gives a fixed probability to the true voxels, another one to the rest, by the height of what it observes."""

    def __init__(self, samples: ViewSet, inside: float, outside: float) -> None:
        super().__init__(tiny.RECONSTRUCTION)
        batch = samples.batch(np.arange(len(samples)))
        self.views = batch.view
        probability = torch.where(batch.truth > 0.5, inside, outside)
        self.logits = torch.log(probability / (1 - probability))

    def forward(self, view):
        rows = [int((self.views - one).abs().sum(dim=(1, 2, 3, 4)).argmin()) for one in view]
        return self.logits[rows]


def test_the_truth_scores_full_marks_and_standing_still_none(deformations: Path) -> None:
    samples = DeformationSet.load(deformations, "test")
    perfect = evaluate_deformation(Knowing(1.0), samples, 0.5)
    still = evaluate_deformation(Knowing(0.0), samples, 0.5)
    assert perfect["samples"] == perfect["samples_moved"] == 4
    assert perfect["skill"] > 0.95
    assert perfect["displacement_error"] < 0.02  # of the peak; the clamp's own layer is interpolated
    assert perfect["peak_ratio_median"] == pytest.approx(1.0, abs=0.06)  # the topmost node lies below the top
    assert still["skill"] == pytest.approx(0.0, abs=1e-6)
    assert still["iou"] == still["iou_identity"] == pytest.approx(float(samples.identity_iou.mean()), abs=1e-6)
    assert still["iou_changed_voxels"] == 0.0
    assert still["peak_ratio_median"] == 0.0
    # A body sheared by s·z and clamped at 0 moves by half of its peak on average.
    assert still["displacement_error"] == pytest.approx(0.5, abs=0.05)


def test_where_nothing_moved_there_is_no_figure_of_what_moved(deformations: Path) -> None:
    samples = DeformationSet.load(deformations, "test")
    still = dataclasses.replace(samples, deformed=samples.rest[samples.body])
    figures = evaluate_deformation(Knowing(0.0), still, 0.5)
    assert figures["samples_moved"] == 0
    assert figures["iou"] == 1.0
    assert not {"skill", "iou_moved", "iou_changed_voxels"} & figures.keys()
    assert all(np.isfinite(value) for value in figures.values())


def test_displacement_errors_are_in_voxels_and_shares(deformations: Path) -> None:
    """Standing still misses all of it: u = s·z from 0 to the peak, half of it on average, 95 % at the 95th."""
    samples = DeformationSet.load(deformations, "test")
    still = evaluate_deformation(Knowing(0.0), samples, 0.5)
    assert still["displacement_error_voxels"] == pytest.approx(64 * float(samples.peak.mean()) / 2, rel=0.1)
    assert still["displacement_error_p95"] == pytest.approx(0.95, abs=0.06)


def test_a_voxel_decoder_is_judged_like_a_field(deformations: Path) -> None:
    samples = DeformationSet.load(deformations, "test")
    torch.manual_seed(0)
    figures = evaluate_deformation(PhysNet(tiny.PHYSNET).eval(), samples, 0.5)
    assert 0.0 <= figures["iou"] <= 1.0
    assert "displacement_error" not in figures


def test_what_was_seen_free_overrules_the_network(views: Path) -> None:
    samples = ViewSet.load(views, "test")
    everything = evaluate_reconstruction(Seeing(samples, 0.9, 0.9), samples, 0.5)
    free = np.mean([np.unpackbits(row).mean() for row in samples.free])
    truth = np.mean([np.unpackbits(row).mean() for row in samples.truth])
    assert everything["iou"] == pytest.approx(truth / (1 - free), rel=0.05)
    assert evaluate_reconstruction(Seeing(samples, 0.9, 0.1), samples, 0.5)["iou"] == 1.0


def test_the_papers_threshold_is_printed_beside_ours(views: Path) -> None:
    samples = ViewSet.load(views, "test")
    figures = evaluate_reconstruction(Seeing(samples, 0.7, 0.1), samples, 0.5)
    assert figures["iou"] == 1.0
    assert figures["iou_at_0.8"] == 0.0
    assert 0.0 < figures["iou_observed_only"] < 0.2


def test_the_threshold_that_tells_body_from_rest_is_found(views: Path) -> None:
    samples = ViewSet.load(views, "train")
    assert tune_threshold(Seeing(samples, 0.62, 0.57), samples) == 0.6
    assert 0.8 in THRESHOLDS


class Doubtful(Seeing):
    """Says 2.2 units of logit for what is so three times in four."""

    def __init__(self, samples: ViewSet) -> None:
        super().__init__(samples, 0.5, 0.5)
        truth = samples.batch(np.arange(len(samples))).truth > 0.5
        wrong = torch.rand(truth.shape, generator=torch.Generator().manual_seed(0)) < 0.25
        self.logits = torch.where(truth ^ wrong, 2.2, -2.2)


def test_a_corrected_solve_is_served_at_the_level_that_keeps_a_body_that_does_not_move(deformations: Path) -> None:
    samples = DeformationSet.load(deformations, "validation", prior=True)
    network, threshold, tuned = as_served(tiny.deformation_network(), samples)
    assert threshold == EVEN
    assert "correction_share" in tuned
    assert as_served(network, samples, 0.6)[1] == 0.6


def test_the_temperature_takes_back_what_is_too_sure(views: Path) -> None:
    """Right three times in four is ln 3 of logit."""
    samples = ViewSet.load(views, "validation")
    assert tune_temperature(Doubtful(samples), samples) == pytest.approx(2.2 / np.log(3), rel=0.02)


def test_a_network_is_not_judged_on_the_other_networks_data(views: Path) -> None:
    with pytest.raises(TypeError, match="DeformationNetwork cannot be judged on a ViewSet"):
        tune_threshold(tiny.deformation_network(), ViewSet.load(views, "train"))


@pytest.mark.parametrize("kind", ["deformation", "reconstruction"])
def test_a_checkpoint_is_scored_on_the_split_asked_for(
    kind: str, deformations: Path, views: Path, tmp_path: Path
) -> None:
    if kind == "deformation":
        checkpoint = tiny.save_checkpoint(tiny.deformation_network(), tiny.FIT_DEFORMATION, tmp_path)
        data = deformations
    else:
        checkpoint = tiny.save_checkpoint(tiny.reconstruction_network(), tiny.FIT_RECONSTRUCTION, tmp_path)
        data = views
    threshold, figures = evaluate(checkpoint, data, "test")
    assert threshold in THRESHOLDS
    assert figures["split"] == "test"
    assert figures["samples"] == 4
    assert 0.0 <= figures["iou"] <= 1.0
    given, again = evaluate(checkpoint, data, "test", threshold)
    assert (given, again) == (threshold, figures)


class Overshooting(DeformationNetwork):
    """Adds twice what is missing after half of the true shear."""

    def __init__(self) -> None:
        super().__init__(tiny.DEFORMATION)

    def forward(self, rest, condition, noise, prior):
        heights = (torch.arange(16) + 0.5) / 16
        field = torch.zeros(len(condition), 3, 16, 16, 16)
        field[:, 0] = (tiny.SHEAR * 10.0 ** condition[:, 6])[:, None, None, None] * heights
        field = field * self.generator.own.bias[0]
        latent = torch.zeros(len(condition), 3)
        return field, latent, latent


@pytest.mark.parametrize(("said", "share"), [(1.0, 0.5), (2.0, 0.25), (-1.0, 0.0), (0.5, 1.0)])
def test_the_share_of_the_correction_is_tuned(deformations: Path, said: float, share: float) -> None:
    """The prior has half of the shear here, so that half of the shear is missing."""
    samples = DeformationSet.load(deformations, "train", prior=False)

    class Half(type(samples)):
        def batch(self, rows):
            batch = super().batch(rows)
            return dataclasses.replace(batch, prior_backward=0.5 * batch.displacement)

    halved = Half(**{field.name: getattr(samples, field.name) for field in dataclasses.fields(samples)})
    network = Overshooting()
    torch.nn.init.constant_(network.generator.own.bias, said)
    assert tune_share(network, halved) == share
