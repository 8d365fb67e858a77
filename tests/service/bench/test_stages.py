"""The benchmark of the stages, as its command runs it."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
STAGES = {
    "parse", "decode", "segment", "voxelize", "reconstruct: network", "reconstruct: around it", "align",
    "deform: prior", "deform: network", "deform: around it", "encode gRPC", "encode JSON",
}  # fmt: skip


def test_every_stage_of_every_sample_has_its_time() -> None:
    command = [sys.executable, "-m", "benchmarks.service.stages", "--here", "--name", "any", "--repeats", "1"]
    found = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True, timeout=120)
    frames = json.loads(found.stdout)["frames"]
    assert set(frames) == {"sugar_box", "mug", "bowl"}
    for stages in frames.values():
        assert STAGES <= set(stages)
        assert all(stages[stage] > 0.0 for stage in STAGES)
