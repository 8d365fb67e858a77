"""The simulator against a real silicone beam filmed by motion capture under its own weight."""

import json
import os
from pathlib import Path

import numpy as np
import pytest

from tests.training.simulation.bodies import column
from training.simulation.body import Body
from training.simulation.loads import self_weight
from training.simulation.newton import follow_forces
from training.simulation.solver import LinearSolver

SHARED = Path(os.environ.get("PHYSNET_SHARED", Path(__file__).resolve().parents[4] / "shared"))
MEASUREMENT = SHARED / "data/real/deformation/eth_silicone_beam/measurement.json"

LENGTH_M, THICKNESS_M = 0.1, 0.03
YOUNG_MODULUS_PA, DENSITY_KG_M3, GRAVITY_M_S2 = 263_824.0, 1070.0, 9.81


@pytest.mark.skipif(not MEASUREMENT.exists(), reason=f"no measurement at {MEASUREMENT}; set PHYSNET_SHARED")
def test_silicone_beam_sags_as_measured():
    """A 30 × 30 × 100 mm cantilever under its own weight; ν = 0.499 measured, 0.49 simulated.

    Two runs, three tip markers: −6.4 to −6.6 mm, with starting positions known to the rms of the marker fit, 0.8 mm.
    Beam theory with the published modulus gives w L⁴/8EI + w L²/2κGA = 7.3 mm less 4 % for the clamped section.

    Source: Dubied et al., Sim-to-real for soft robots using differentiable FEM, RA-L 7 (2022), and its published code.
    """
    runs = json.loads(MEASUREMENT.read_text())["runs"]
    edge_m = LENGTH_M / 0.75
    body = Body.from_distance(column(THICKNESS_M / edge_m, 0.75), 20)
    weight_number = DENSITY_KG_M3 * GRAVITY_M_S2 * edge_m / YOUNG_MODULUS_PA
    forces = self_weight(body, np.array([weight_number, 0.0, 0.0]))
    (solution,) = follow_forces(LinearSolver(body, 0.49), forces, fractions=(1.0,))
    assert solution.converged
    tip = body.node_grid[:, 2] == 15
    sag_mm = 1e3 * edge_m * solution.displacement[tip].mean(axis=0)
    measured_mm = -np.array([run["tip_displacement_beam_frame_mm"] for run in runs])[:, :, 2]
    fit_mm = max(run["marker_fit_rms_mm"] for run in runs)
    assert measured_mm.min() - fit_mm < sag_mm[0] < measured_mm.max() + fit_mm
    # the section turns: the upper marker runs ahead of the lower one, z apart by 30 mm, by this much along the beam
    upper, lower = tip & (body.node_positions[:, 0] < 0.42), tip & (body.node_positions[:, 0] > 0.58)
    moved = body.node_positions + solution.displacement
    rise = moved[upper].mean(axis=0) - moved[lower].mean(axis=0)
    along_mm = rise[2] / -rise[0] * 30.0
    markers = np.array([run["tip_displacement_beam_frame_mm"] for run in runs])
    assert along_mm == pytest.approx((markers[:, 0, 0] - markers[:, 2, 0]).mean(), abs=2 * fit_mm)
