"""Networks side by side: what the table says of one that knows the truth and of one that knows nothing."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.ndimage

from tests.training import tiny
from training.experiments.conditions import CIRCUMSTANCES, views_under
from training.experiments.reconstructions import Served, View, compare, table, views_of_meshes, views_of_set
from training.export import export_model

BOX = "v -0.1 -0.05 0\nv 0.1 -0.05 0\nv 0.1 0.05 0\nv -0.1 0.05 0\nv -0.1 -0.05 0.15\nv 0.1 -0.05 0.15\n" + (
    "v 0.1 0.05 0.15\nv -0.1 0.05 0.15\nf 1 4 3 2\nf 5 6 7 8\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8\n"
)


class Answering(Served):
    """Gives every voxel of the body the same probability."""

    def __init__(self, share: float) -> None:
        self.share = share
        self.manifest = SimpleNamespace(threshold=0.5, name="test", version=str(share), run="none")  # type: ignore
        self.times_ms = [1.0]

    def __call__(self, view: View) -> np.ndarray:
        return (self.share * view.truth).astype(np.float32)


def test_the_truth_scores_full_marks_and_nothing_what_was_measured(tmp_path: Path) -> None:
    models = [Answering(1.0), Answering(0.1)]
    figures = compare(models, views_of_set(tiny.write_views(tmp_path), "test"))
    assert set(figures) == {"all", "solid", "box"}
    assert figures["all"][0] == pytest.approx([4, 1, 1, 1, 1])
    count, overlap, _, visible, hidden = figures["all"][1]
    assert (count, hidden) == (4, 0.0)
    assert 0 < overlap < visible < 1  # the measured front alone
    lines = table(models, figures).splitlines()
    assert lines[2].startswith("| all | 4 | 1.000, 1.000, 1.000, 1.000 | 0.0")
    assert "test 0.1 (none)" in lines[0]


def test_a_part_of_a_split_is_evenly_spread(tmp_path: Path) -> None:
    root = tiny.write_views(tmp_path)
    everything, some = list(views_of_set(root, "train")), list(views_of_set(root, "train", most=2))
    assert (len(everything), len(some)) == (6, 2)
    assert [view.truth.tobytes() for view in some] == [everything[i].truth.tobytes() for i in (0, -1)]


def test_an_exported_network_answers_as_it_is_served(tmp_path: Path) -> None:
    checkpoint = tiny.save_checkpoint(tiny.reconstruction_network(), tiny.FIT_RECONSTRUCTION, tmp_path / "run")
    export_model(checkpoint, tmp_path, "tiny", "0.1.0", 0.4, {}, {})
    model = Served(tmp_path / "tiny" / "0.1.0")
    view = next(views_of_set(tiny.write_views(tmp_path / "views"), "test"))
    probability = model(view)
    assert probability.shape == (64, 64, 64)
    assert (probability[view.free] == 0).all() and (probability[~view.free] > 0).all()
    assert len(model.times_ms) == 1


def test_meshes_are_seen_at_their_size_and_open_ones_left_out(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    (tmp_path / "a.obj").write_text(BOX)
    (tmp_path / "b.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    views = list(views_of_meshes(tmp_path, views=1))
    assert [view.kinds for view in views] == [("all", "a")]
    assert views[0].truth.sum() > 3000
    assert "b.obj" in capsys.readouterr().err


def test_every_circumstance_shows_the_same_body_otherwise() -> None:
    found = list(views_under((*CIRCUMSTANCES[:3], CIRCUMSTANCES[-1]), bodies=1))
    assert [circumstance.name for circumstance, _, _ in found] == [
        each.name for each in (*CIRCUMSTANCES[:3], CIRCUMSTANCES[-1])
    ]
    views = {circumstance.name: view for circumstance, view, _ in found}
    assert len({view.observed.tobytes() for view in views.values()}) == 4
    for _, view, truth in found:
        near = scipy.ndimage.binary_dilation(truth, iterations=3)
        assert near[view.observed].mean() > 0.95  # truth and view stand in one grid
        assert not (truth & view.free).sum() > 0.05 * truth.sum()
    # Farther away fewer voxels are hit, nearer more.
    seen = views[CIRCUMSTANCES[1].name].observed.sum()
    assert views[CIRCUMSTANCES[-1].name].observed.sum() > 0.8 * seen
