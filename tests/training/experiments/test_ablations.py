import dataclasses
import json
from pathlib import Path

import pytest

from tests.training import tiny
from training.configs import HeldOut
from training.experiments.ablations import HELD_OUT, WHOLE, markdown, run_all, variants
from training.networks.deformation import DeformationConfig
from training.networks.physnet import PhysNetConfig


def test_every_variant_differs_from_the_whole_network_in_what_its_name_says() -> None:
    found = variants(tiny.FIT_DEFORMATION, 30)
    whole = found.pop(WHOLE)
    assert all(config.steps == whole.steps == 30 for config in found.values())
    assert not found["without skips"].network.skips
    assert not found["without prior and condition"].network.prior
    assert isinstance(found["occupancy in place of displacement, without prior"].network, PhysNetConfig)
    assert found["with a critic"].adversary.start == 10
    assert found["with a critic of a tenth of the weight"].adversary.beta == pytest.approx(0.995)
    both = ("without prior, with a critic", "without prior, with a critic of a tenth of the weight")
    for name, config in found.items():
        assert config != whole, name
        changed = [f.name for f in dataclasses.fields(config) if getattr(config, f.name) != getattr(whole, f.name)]
        assert len(changed) == (2 if name.endswith(both) else 1), name
    assert sum(config.held_out is not None for config in found.values()) == len(HELD_OUT)


def test_runs_that_are_done_are_kept_and_what_was_held_out_is_judged_apart(tmp_path: Path) -> None:
    data = tiny.write_deformations(tmp_path / "data")
    base = dataclasses.replace(tiny.FIT_DEFORMATION, steps=1)
    assert isinstance(base.network, DeformationConfig)
    held = HeldOut(field="log10_load_number", low=-2.3)
    configs = {WHOLE: base, "trained without strong pushes": dataclasses.replace(base, held_out=held)}
    found = run_all(configs, data, tmp_path / "out", 4)
    assert found[WHOLE]["steps"] == 1
    row = found["trained without strong pushes"]
    assert row["held_out"]["samples"] == 2  # one of the two pushes on each of the two test bodies
    assert row["held_out"]["identity"] == row["held_out_trained_on"]["identity"] < row["identity"]
    assert row["held_out"]["iou"] == pytest.approx(row["held_out_trained_on"]["iou"], abs=0.05)
    kept = json.loads((tmp_path / "out" / "ablations.json").read_text())
    kept[WHOLE]["iou"] = 0.123
    (tmp_path / "out" / "ablations.json").write_text(json.dumps(kept))
    again = run_all(configs, data, tmp_path / "out", 4)
    assert again[WHOLE]["iou"] == 0.123
    text = markdown(again)
    assert f"| {WHOLE} | 0.123 |" in text
    assert "| trained without strong pushes | 2 |" in text
