"""The simulator against a filmed silicone beam: one `physnet-train solve`, plotted over the measured markers.

    python examples/silicone_beam.py ../shared/data/real/deformation/eth_silicone_beam docs/images/silicone_beam.png

A block of 30 x 30 x 100 mm is held at one end and let go; motion capture filmed six markers until it hung still.
Data: Dubied et al., "Sim-to-real for soft robots using differentiable FEM" (RA-L 7, 2022), in the repository
srl-ethz/diffPD_sim2real, MIT.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

INK, FAINT, SIMULATED, MEASURED = "#22262b", "#9aa3ad", "#1f5f99", "#d3122f"
MARKERS_MM = np.array([[36.0, 15.0, 0.0], [24.0, -6.0, 0.0], [6.0, 36.0, 0.0]])
"""Rest positions of the tip's markers in the axes of the mesh; they stand 6 mm off the surface."""
ALONG_MM = np.linspace(0.0, 100.0, 21)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path, help="folder with beam_rest_mm.stl and measurement.json")
    parser.add_argument("picture", type=Path)
    parser.add_argument("--cells", default="27")
    options = parser.parse_args()

    upper, lower = ([[x, 15.0, z] for z in ALONG_MM] for x in (30.0, 0.0))
    moved_mm = simulate(options.data / "beam_rest_mm.stl", [*MARKERS_MM.tolist(), *upper, *lower], options.cells)
    runs = json.loads((options.data / "measurement.json").read_text())["runs"]
    measured_mm = np.array([run["tip_displacement_beam_frame_mm"] for run in runs])
    error_mm = max(run["marker_fit_rms_mm"] for run in runs)

    figure = Figure(figsize=(11, 4.4), dpi=110, layout="constrained")
    side, numbers = figure.subplots(1, 2, width_ratios=[1.7, 1])
    edges = np.split(to_beam(np.array([*upper, *lower])), 2), np.split(moved_mm[3:], 2)
    draw_side(side, *edges, moved_mm[:3], measured_mm)
    draw_numbers(numbers, moved_mm[:3], measured_mm, error_mm)
    figure.savefig(options.picture)
    for name, simulated, filmed in zip((1, 2, 3), moved_mm[:3], measured_mm.transpose(1, 0, 2), strict=True):
        print(f"marker {name}: simulated {simulated.round(2).tolist()}, filmed {filmed.tolist()} mm")
    return 0


def simulate(mesh: Path, probes_mm: list[list[float]], cells: str) -> np.ndarray:
    """Displacements at the probes in the beam's frame, in mm."""
    command = [
        *(sys.executable, "-m", "training", "solve", str(mesh), "--unit", "mm"),
        *("--young", "263824", "--poisson", "0.499", "--density", "1070", "--gravity", "-9.81,0,0"),
        *("--clamp", "above:z=100", "--cells", cells, "--json"),
    ]
    for point in probes_mm:
        command += ["--probe", ",".join(f"{number:g}" for number in point)]
    report = json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout)
    return to_beam(1e3 * np.array([probe["displacement_m"] for probe in report["probes"]]))


def to_beam(vectors: np.ndarray) -> np.ndarray:
    """From the axes of the mesh to the beam's: x from the held end to the tip, z up."""
    return np.stack([-vectors[:, 2], vectors[:, 1], vectors[:, 0]], axis=1)


def draw_side(
    axes: Axes, rest: list[np.ndarray], moved: list[np.ndarray], markers: np.ndarray, measured: np.ndarray
) -> None:
    for upper_or_lower, displacement in zip(rest, moved, strict=True):
        axes.plot(*upper_or_lower[:, [0, 2]].T, color=FAINT, linewidth=1, linestyle="--")
        axes.plot(*(upper_or_lower + displacement)[:, [0, 2]].T, color=SIMULATED, linewidth=1.6)
    ends = np.array([edge + displacement for edge, displacement in zip(rest, moved, strict=True)])
    axes.plot(*ends[:, 0, [0, 2]].T, color=SIMULATED, linewidth=1.6)
    at_rest = to_beam(MARKERS_MM)
    axes.plot(*at_rest[:, [0, 2]].T, "o", color=FAINT, markersize=5, label="markers at rest")
    hung = at_rest + markers
    axes.plot(*hung[:, [0, 2]].T, "s", color=SIMULATED, markersize=7, fillstyle="none", label="simulated")
    for number, run in enumerate(measured):
        label = "filmed, two runs" if number == 0 else None
        axes.plot(*(at_rest + run)[:, [0, 2]].T, "x", color=MEASURED, markersize=7, label=label)
    axes.axvspan(-106, -100, color=INK, alpha=0.5, linewidth=0)
    axes.set(xlim=(-106, 8), xlabel="along the beam, mm", ylabel="height, mm", aspect="equal")
    axes.set_title("A silicone beam under its own weight, side view to scale", fontsize=10, color=INK)
    axes.legend(fontsize=8, loc="center", bbox_to_anchor=(0.5, 0.5), frameon=False)


def draw_numbers(axes: Axes, markers: np.ndarray, measured: np.ndarray, error_mm: float) -> None:
    rows = [(marker, axis) for axis in (2, 0, 1) for marker in range(3)]
    names = {0: "along", 1: "across", 2: "up"}
    for row, (marker, axis) in enumerate(rows):
        filmed = measured[:, marker, axis]
        axes.errorbar(filmed.mean(), row, xerr=error_mm, color=MEASURED, linewidth=1, capsize=3)
        axes.plot(filmed, [row] * len(filmed), "x", color=MEASURED)
        axes.plot(markers[marker, axis], row, "s", color=SIMULATED, fillstyle="none", markersize=7)
    axes.set_yticks(range(len(rows)), [f"tip {marker + 1} {names[axis]}" for marker, axis in rows], fontsize=8)
    axes.invert_yaxis()
    axes.axvline(0, color=FAINT, linewidth=0.8)
    axes.set_xlabel("displacement, mm; bars: rms of the marker fit")


if __name__ == "__main__":
    sys.exit(main())
