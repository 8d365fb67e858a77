from dataclasses import replace
from pathlib import Path

import pytest
import torch

from tests.training import tiny
from training.experiments.mean_of_runs import main, mean_of_runs
from training.fit_reconstruction import fit_reconstruction
from training.networks.checkpoint import load_network
from training.networks.reconstruction import ReconstructionConfig
from training.runs import Run


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two runs of a single step each, and one of another network."""
    root = tmp_path_factory.mktemp("runs")
    views = tiny.write_views(root / "views")
    one = replace(tiny.FIT_RECONSTRUCTION, steps=1, validate_every=1)
    other = replace(one, network=ReconstructionConfig(channels=(4, 4, 4, 8), blocks=(0, 0, 0, 0)))
    for name, config in {"one": one, "two": replace(one, seed=1), "other": other}.items():
        fit_reconstruction(views, Run(root / name), config)
    return root


def test_weights_are_halfway_and_the_checkpoint_says_of_what(runs: Path, tmp_path: Path) -> None:
    out = tmp_path / "mean"
    assert main([str(runs / "one"), str(runs / "two"), "--out", str(out)]) == 0
    network, state = load_network(out / "checkpoint.pt")
    one, two = (torch.load(runs / name / "checkpoint.pt", weights_only=True) for name in ("one", "two"))
    for name, tensor in network.state_dict().items():
        if tensor.is_floating_point():
            torch.testing.assert_close(tensor, (one["network"][name] + two["network"][name]) / 2)
        else:
            assert torch.equal(tensor, two["network"][name])
    assert "the mean of one at step 1 and two at step 1" in state["config"]["begun_from"]
    assert state["dataset"] == two["dataset"]


def test_only_networks_that_are_alike_have_a_mean(runs: Path) -> None:
    with pytest.raises(ValueError, match="differ in their configuration"):
        mean_of_runs([runs / name / "checkpoint.pt" for name in ("one", "other")])


def test_a_run_that_is_there_is_not_written_over(runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = (runs / "two" / "checkpoint.pt").read_bytes()
    assert main([str(runs / "one"), "--out", str(runs / "two")]) == 1
    assert "choose another --out" in capsys.readouterr().err
    assert (runs / "two" / "checkpoint.pt").read_bytes() == before
