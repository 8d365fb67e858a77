"""Convergence of the linear solution under refinement of the cells: a cantilever, a bridge and a bowl."""

from __future__ import annotations

import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

from training.data.body_cube import place_in_body_grid
from training.simulation.body import Body
from training.simulation.elements import shape_functions
from training.simulation.enhanced import EnhancedHexahedron
from training.simulation.families import sample_shape
from training.simulation.loads import Load
from training.simulation.mean_dilatation import MeanDilatationHexahedron
from training.simulation.solver import LinearSolver
from training.simulation.surface import Distance

CELLS = (12, 16, 20, 24, 32, 40)
POISSON_RATIO = 0.3
ELEMENTS = {"plain": MeanDilatationHexahedron, "enhanced": EnhancedHexahedron}


class Pushed(NamedTuple):
    """A shape and a push on it."""

    distance: Distance
    load: Load


def cantilever() -> Pushed:
    """An upright beam 0.17 thick and 0.75 high, faces off the grid, pushed sideways near its top."""
    centre, half = np.float32([0.5, 0.5, 0.375]), np.float32([0.085, 0.085, 0.375])

    def distance(points: np.ndarray) -> np.ndarray:
        outside = np.abs(points - centre) - half
        return np.linalg.norm(np.maximum(outside, 0.0), axis=1) + np.minimum(outside.max(axis=1), 0.0)

    return Pushed(distance, Load(np.array([0.415, 0.5, 0.65]), np.array([1.0, 0.0, 0.0]), 1.0, 0.1))


def drawn(family: str, seed: int, direction: tuple[float, float, float]) -> Pushed:
    """A body of a family, pushed at its highest point."""
    shape = place_in_body_grid(sample_shape(family, np.random.default_rng(seed))).shape
    body = Body.from_distance(shape.distance, 24)
    points, _ = body.surface_points(2000, np.random.default_rng(0))
    top = points[points[:, 2].argmax()]
    return Pushed(shape.distance, Load(top, np.array(direction), 1.0, 0.12))


def displacement_at_contact(pushed: Pushed, element: str, cells: int) -> tuple[float, float]:
    """Displacement along a unit push a little below its contact, and the CPU time it took."""
    start = time.process_time()
    body = Body.from_distance(pushed.distance, cells)
    displacement = LinearSolver(body, POISSON_RATIO, ELEMENTS[element]).solve([pushed.load])[0]
    seconds = time.process_time() - start
    # three quarters of a coarse cell below the surface, away from nodes that hang in nearly empty cells
    inside = pushed.load.contact + 0.03 * pushed.load.direction
    cell, local = body.locate(inside[None])
    return float((shape_functions(local) @ displacement[body.cell_nodes[cell[0]]])[0] @ pushed.load.direction), seconds


def plot_refinement(path: Path) -> None:
    """Draw the displacement over its value on the finest cells against cells an edge, and its error against time."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    cases = {
        "cantilever": cantilever(),
        "bridge": drawn("bridge", 1, (0.0, 0.0, -1.0)),
        "bowl": drawn("bowl", 1, (0.0, 0.0, -1.0)),
    }
    figure, axes = plt.subplots(1, 2, figsize=(9.5, 3.8), constrained_layout=True)
    displacement_at_contact(cases["cantilever"], "plain", 8)  # loops are compiled when they are first met
    for colour, (name, pushed) in enumerate(cases.items()):
        found = {element: [displacement_at_contact(pushed, element, n) for n in CELLS] for element in ELEMENTS}
        finest = found["enhanced"][-1][0]
        for element, style in (("plain", "o--"), ("enhanced", "s-")):
            ratio = np.array([moved for moved, _ in found[element]]) / finest
            seconds = [spent for _, spent in found[element]]
            print(name, element, " ".join(f"{n}:{value:.3f}" for n, value in zip(CELLS, ratio, strict=True)))
            label = f"{name}, {element}"
            axes[0].plot(CELLS, ratio, style, color=f"C{colour}", markersize=4, label=label)
            axes[1].loglog(seconds[:-1], np.abs(ratio[:-1] - 1.0), style, color=f"C{colour}", markersize=4)
    axes[0].axhline(1.0, color="0.6", linewidth=0.8)
    axes[0].set(xlabel="cells along an edge of the cube", ylabel="displacement, of enhanced at 40³")
    axes[1].set(xlabel="CPU time, s", ylabel="difference from enhanced at 40³")
    axes[0].legend(fontsize=8)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    plt.close(figure)
