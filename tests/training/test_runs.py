import csv
import dataclasses
import time
from dataclasses import dataclass
from pathlib import Path

import pytest
import torch

from training.runs import Run, RunError, Stateful


@dataclass(frozen=True)
class Config:
    steps: int = 10
    channels: tuple[int, int] = (2, 3)


DATASET = {"digest": "sha256:0", "samples": 3}


class Parts:
    """A network of one weight with its optimizer and schedule, after a few steps."""

    def __init__(self, steps: int = 0) -> None:
        torch.manual_seed(0)
        self.network = torch.nn.Linear(2, 1)
        self.optimizer = torch.optim.AdamW(self.network.parameters(), lr=0.1)
        self.schedule = torch.optim.lr_scheduler.OneCycleLR(self.optimizer, 0.1, total_steps=10)
        for _ in range(steps):
            self.optimizer.zero_grad()
            torch.autograd.backward(self.network(torch.ones(2)).sum())
            self.optimizer.step()
            self.schedule.step()

    def resume(self, run: Run, config: object = Config(), dataset: dict[str, object] = DATASET) -> int:
        return run.resume(self.parts(), config, dataset)

    def parts(self) -> dict[str, Stateful]:
        return {"network": self.network, "optimizer": self.optimizer, "schedule": self.schedule}


def checkpointed(root: Path) -> Parts:
    run, parts = Run(root), Parts()
    assert parts.resume(run) == 0
    parts = Parts(steps=4)
    run.checkpoint(4, parts.parts(), Config())
    return parts


def test_everything_comes_back(tmp_path: Path) -> None:
    before = checkpointed(tmp_path / "run")
    after = Parts()
    assert after.resume(Run(tmp_path / "run")) == 4
    assert torch.equal(after.network.weight, before.network.weight)
    assert after.schedule.get_last_lr() == before.schedule.get_last_lr()
    moments = [parts.optimizer.state[parts.network.weight]["exp_avg_sq"] for parts in (before, after)]
    assert torch.equal(*moments)


def test_another_configuration_is_refused_by_name(tmp_path: Path) -> None:
    checkpointed(tmp_path)
    with pytest.raises(RunError, match="another channels; choose another --run"):
        Parts().resume(Run(tmp_path), dataclasses.replace(Config(), channels=(2, 4)))


def test_another_data_set_is_refused_as_such_even_where_the_configuration_follows_it(tmp_path: Path) -> None:
    checkpointed(tmp_path)
    other = {"digest": "sha256:1", "samples": 3}
    with pytest.raises(RunError, match="another data set"):
        Parts().resume(Run(tmp_path), dataclasses.replace(Config(), channels=(2, 4)), other)


def test_a_checkpoint_cut_short_while_written_disturbs_nobody(tmp_path: Path) -> None:
    before = checkpointed(tmp_path)
    (tmp_path / "checkpoint.partial").write_bytes(b"half a checkp")
    after = Parts()
    assert after.resume(Run(tmp_path)) == 4
    assert torch.equal(after.network.weight, before.network.weight)


@pytest.mark.parametrize("loss", [float("nan"), float("inf")])
def test_a_loss_that_is_no_number_stops_the_run_and_names_the_step(tmp_path: Path, loss: float) -> None:
    run = Run(tmp_path)
    run.check_finite(torch.tensor(1.0), 41)
    with pytest.raises(RunError, match=f"the loss is {loss} at step 42"):
        run.check_finite(torch.tensor(loss), 42)


def test_the_log_is_a_table_with_one_header(tmp_path: Path) -> None:
    run = Run(tmp_path)
    run.log(500, {"iou": 0.5, "skill": 0.25})
    run.log(1000, {"iou": 0.75, "skill": 0.5})
    run.close()
    with (tmp_path / "log.csv").open(newline="") as file:
        rows = list(csv.reader(file))
    assert rows == [["step", "iou", "skill"], ["500", "0.500000", "0.250000"], ["1000", "0.750000", "0.500000"]]


def test_progress_tells_rate_and_time_left_but_not_every_step(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = Run(tmp_path / "blocks", print_every=3600.0)
    run._printed = -1e9  # monotonic clocks start anywhere, even at less than the interval
    started = time.monotonic() - 50.0
    run.progress(200, 1000, 100, started, {"bce": 0.125})
    run.progress(201, 1000, 100, started, {"bce": 0.125})
    run.close()
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("[blocks] 200/1000  2.00 steps/s  7 min left  bce 0.1250")


def test_what_was_logged_after_the_checkpoint_is_forgotten(tmp_path: Path) -> None:
    checkpointed(tmp_path)  # at step 4
    run = Run(tmp_path)
    for step in (2, 4, 6):
        run.log(step, {"iou": 0.5})
    run.close()
    Parts().resume(Run(tmp_path))
    assert [line.split(",")[0] for line in (tmp_path / "log.csv").read_text().splitlines()] == ["step", "2", "4"]


def test_another_version_of_the_code_is_pointed_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    checkpointed(tmp_path)
    monkeypatch.setattr("training.runs.code_version", lambda: "abcdef0")
    Parts().resume(Run(tmp_path))
    assert "the code has changed since the checkpoint" in capsys.readouterr().err


def test_a_damaged_checkpoint_is_named(tmp_path: Path) -> None:
    (tmp_path / "checkpoint.pt").write_bytes(b"half a checkp")
    with pytest.raises(RunError, match=r"checkpoint\.pt cannot be read"):
        Parts().resume(Run(tmp_path))


def test_a_checkpoint_that_cannot_be_written_leaves_the_last_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    parts = checkpointed(tmp_path)
    before = (tmp_path / "checkpoint.pt").read_bytes()

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(torch, "save", full)
    with pytest.raises(RunError, match=r"step 8 cannot be written .*No space left.* the last checkpoint is kept"):
        Run(tmp_path).checkpoint(8, parts.parts(), Config())
    assert (tmp_path / "checkpoint.pt").read_bytes() == before
