"""`physnet-train solve`, in-process: what it prints, writes and returns."""

from __future__ import annotations

import json
import os
from pathlib import Path

import meshio
import numpy as np
import pytest
import trimesh

from training.__main__ import main

SHARED = Path(os.environ.get("PHYSNET_SHARED", Path(__file__).resolve().parents[4] / "shared"))
BEAM = SHARED / "data/real/deformation/eth_silicone_beam"
NUMBERS = ["--unit", "mm", "--young", "1e6", "--poisson", "0.3", "--cells", "16", "--fill", "0.75", "--law", "linear"]
PUSH = ["--load", "10,10,80:2,0,0"]


@pytest.fixture
def bar(tmp_path: Path) -> Path:
    """20 × 20 × 80 mm, standing with one corner at the origin."""
    mesh = trimesh.creation.box((20.0, 20.0, 80.0))
    mesh.apply_translation((10.0, 10.0, 40.0))
    mesh.export(tmp_path / "bar.stl")
    return tmp_path / "bar.stl"


def solve(*arguments: object) -> int:
    return main(["solve", *(str(argument) for argument in arguments)])


def test_a_table_a_file_and_a_picture(bar: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    outputs = ["-o", tmp_path / "case.vtu", "--picture", tmp_path / "case.png"]
    assert solve(bar, *NUMBERS, *PUSH, "--probe", "10,10,80", *outputs) == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    lines = captured.out.splitlines()
    assert lines[0].startswith("bar.stl: 12 triangles, 108 cells of 0.00667 m, volume 3.")
    assert any(line.startswith("probe 0.01, 0.01, 0.08 m moved 0.0") for line in lines)
    assert any(line.startswith("loads     2,") for line in lines)
    assert any(line.startswith("reaction  -2,") for line in lines)
    assert any(line.startswith("converged at 100%: 1 iterations, residual ") for line in lines)
    assert "displacement" in meshio.read(tmp_path / "case.vtu").point_data
    assert (tmp_path / "case.png").stat().st_size > 10_000


def test_json_holds_the_figures_in_si(bar: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A cantilever with a force at its end: F ℓ³/3EI + F ℓ/κGA, less than 5 % off.

    Source: Timoshenko; κ = 5/6, G = E/2.6, I = a⁴/12.
    """
    assert solve(bar, *NUMBERS, *PUSH, "--probe", "10,10,80", "--probe", "10,10,0", "--json") == 0
    report = json.loads(capsys.readouterr().out)
    side_m, length_m, force_n, young_pa = 0.02, 0.08, 2.0, 1e6
    bending_m = force_n * length_m**3 / (3 * young_pa * side_m**4 / 12)
    shear_m = force_n * length_m / (5 / 6 * young_pa / 2.6 * side_m**2)
    tip, foot = report["probes"]
    assert tip["displacement_m"][0] == pytest.approx(bending_m + shear_m, rel=0.05)
    assert np.linalg.norm(foot["displacement_m"]) < 0.01 * bending_m
    assert report["reaction_n"][0] == pytest.approx(-2.0, abs=1e-6)
    # about the origin: the force acts 80 mm up and 10 mm aside; by the linear law on the body at rest, nearly
    assert report["reaction_moment_nm"][1] == pytest.approx(-force_n * length_m, rel=0.05)
    assert report["volume_m3"] == pytest.approx(3.2e-5, rel=5e-3)
    assert report["thinnest_member_m"] == pytest.approx(0.02, abs=0.0015)
    assert report["steps"] == [{"fraction": 1.0, "iterations": 1, "residuals": [1.0, pytest.approx(0.0, abs=1e-9)]}]


def test_vectors_may_begin_with_a_minus(bar: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """argparse would take them for options."""
    vectors = ["--gravity", "-9.81,0,0", "--density", "1000", "--probe", "-.1,10,80", "--clamp", "below:z=0"]
    assert solve(bar, *NUMBERS, *vectors, "--json") == 0
    report = json.loads(capsys.readouterr().out)
    assert report["load_n"] == pytest.approx([-9.81 * 1000 * report["volume_m3"], 0, 0], abs=1e-9)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "nothing acts on the body"),
        (["--gravity", "0,0,-1"], "--gravity without --density"),
        (["--load", "10,10,90:1,0,0"], "load 1 lies 0.01 m off the surface"),
        ([*PUSH, "--probe", "10,10,120"], "0.04 m off the body"),
        ([*PUSH, "--clamp", "above:x=50"], "the clamp's region"),
        ([*PUSH, "--clamp", "ground", "--clamp", "below:x=0"], "--clamp ground stands alone"),
        ([*PUSH, "-o", "nowhere/case.vtu"], "no folder nowhere"),
        ([*PUSH, "-o", "case.stl"], "cases are written as .vtu"),
        ([*PUSH, "--young", "-1"], "Young's modulus is -1"),
        ([*PUSH, "--law", "neo_hookean", "--young", "100", "--steps", "1"], "of the load"),
    ],
)
def test_what_cannot_be_solved_is_said_in_one_line(
    bar: Path, arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert solve(bar, *NUMBERS, *arguments) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("physnet-train solve: ")
    assert words in captured.err
    assert len(captured.err.splitlines()) == 1


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "empty.stl"),
        (b"solid x\nendsolid x\n", "no triangles"),
        (None, "no mesh file at"),
    ],
)
def test_files_that_hold_no_mesh(
    tmp_path: Path, content: bytes | None, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "empty.stl"
    if content is not None:
        path.write_bytes(content)
    assert solve(path, *NUMBERS, *PUSH) == 2
    assert words in capsys.readouterr().err


def test_a_mesh_with_a_hole(bar: Path, capsys: pytest.CaptureFixture[str]) -> None:
    mesh = trimesh.load(bar)
    trimesh.Trimesh(mesh.vertices, mesh.faces[1:]).export(bar)
    assert solve(bar, *NUMBERS, *PUSH) == 2
    assert "not watertight: 3 of 18 edges are open" in capsys.readouterr().err


def test_warnings_are_lines_of_their_own(bar: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Inside out, in metres instead of millimetres, ν of a half, members of two cells: solved, with four warnings."""
    mesh = trimesh.load(bar)
    mesh.invert()
    mesh.export(bar)
    numbers = ["--unit", "m", "--young", "1e6", "--poisson", "0.5", "--cells", "10", "--law", "linear"]
    assert solve(bar, *numbers, "--load", "10,10,80:1000,0,0:24") == 0
    lines = capsys.readouterr().err.splitlines()
    assert all(line.startswith("physnet-train solve: warning: ") for line in lines)
    for words in ("bar.stl is inside out", "is 80 m long", "0.5 is solved as 0.49", "three are needed"):
        assert sum(words in line for line in lines) == 1, words
    assert len(lines) == 4


def test_an_option_that_is_not_understood_ends_with_code_2(bar: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        solve(bar, *NUMBERS, "--load", "10,10,80")
    assert caught.value.code == 2
    assert "write x,y,z:fx,fy,fz or x,y,z:fx,fy,fz:radius" in capsys.readouterr().err


@pytest.mark.skipif(not BEAM.is_dir(), reason=f"no measurement at {BEAM}; set PHYSNET_SHARED")
def test_the_silicone_beam_sags_as_filmed(capsys: pytest.CaptureFixture[str]) -> None:
    """One command: a 30 × 30 × 100 mm cantilever under its own weight, three markers on stalks of 6 mm at its tip.

    The start of each run is known to the rms of a rigid fit of the markers, 0.8 mm.

    Source: Dubied et al., Sim-to-real for soft robots using differentiable FEM, RA-L 7 (2022), and its published code.
    """
    material = ["--unit", "mm", "--young", "263824", "--poisson", "0.499", "--density", "1070", "--cells", "27"]
    holding = ["--gravity", "-9.81,0,0", "--clamp", "above:z=100"]
    probes = ["--probe", "36,15,0", "--probe", "24,-6,0", "--probe", "6,36,0"]
    assert solve(BEAM / "beam_rest_mm.stl", *material, *holding, *probes, "--json") == 0
    captured = capsys.readouterr()
    assert "0.499 is solved as 0.49" in captured.err
    moved_mm = 1e3 * np.array([probe["displacement_m"] for probe in json.loads(captured.out)["probes"]])
    # beam_x = −stl_z, beam_y = stl_y, beam_z = stl_x
    simulated = np.stack([-moved_mm[:, 2], moved_mm[:, 1], moved_mm[:, 0]], axis=1)
    for run in json.loads((BEAM / "measurement.json").read_text())["runs"]:
        measured = np.array(run["tip_displacement_beam_frame_mm"])
        assert np.abs(simulated - measured).max() < run["marker_fit_rms_mm"]
