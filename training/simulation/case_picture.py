"""A picture of a solved case: the deformed surface by displacement and by von Mises stress, over its shape at rest."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import trimesh
from jaxtyping import Float64

from service.core.arrays import Vector3
from training.simulation.case_fields import cell_fields
from training.simulation.probe import Interpolation
from training.simulation.solved_case import SolvedCase

try:
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Colormap, LinearSegmentedColormap, Normalize
    from matplotlib.figure import Figure
    from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection
    from mpl_toolkits.mplot3d.axes3d import Axes3D
except ModuleNotFoundError as missing:
    raise ModuleNotFoundError("Pictures need matplotlib: pip install 'physnet[pictures]'") from missing

_INK = "#22262b"
_FAINT = "#9aa3ad"
_FORCE = "#d3122f"
_MOST_TRIANGLES = 60_000
_VISIBLE = 0.03
"""Displacements smaller than this part of the body's size are drawn larger than they are."""
_CREASE_RAD = math.radians(25)
_LIGHT = np.array([-0.35, -0.55, 0.76])
# Lightness falls all the way, so that it also reads in grey.
_SCALE = LinearSegmentedColormap.from_list(
    "from rest", [(0.66, 0.75, 0.86), (0.98, 0.88, 0.50), (0.97, 0.58, 0.20), (0.84, 0.18, 0.25), (0.45, 0.05, 0.35)]
)


def draw_case(solved: SolvedCase, probes_m: Sequence[Vector3], path: Path) -> None:
    """Write the picture; its format follows the suffix."""
    surface = _surface(solved)
    placement = solved.placement
    field = Interpolation(solved.body, solved.state.displacement)
    rest_m = surface.vertices
    moved_m = field.at(placement.to_cube(rest_m)) * placement.edge_m
    size_m = np.linalg.norm(moved_m, axis=1)
    times = _exaggeration(float(size_m.max()), placement.longest_m)
    shape_m = rest_m + times * moved_m
    stress_pa = _stress_at(solved, rest_m)

    figure = Figure(figsize=(11, 5.6), dpi=110, layout="constrained")
    unit, factor = _length_unit(float(size_m.max()))
    panels = [
        (f"displacement, {unit}", size_m[surface.faces].mean(axis=1) * factor),
        ("von Mises stress, kPa", stress_pa[surface.faces].mean(axis=1) * 1e-3),
    ]
    for place, (title, values) in enumerate(panels):
        axes = figure.add_subplot(1, 2, place + 1, projection="3d")
        assert isinstance(axes, Axes3D)
        # a corner where stress has no bound must not take the whole scale
        norm = Normalize(0.0, float(np.percentile(values, 99.5)) or 1.0)
        _draw_surface(axes, shape_m[surface.faces], values, norm)
        _draw_creases(axes, surface)
        _draw_forces(axes, solved)
        if probes_m:
            axes.scatter(*np.array(probes_m).T, color=_INK, marker="x", s=24, depthshade=False)
        _frame(axes, np.concatenate([rest_m, shape_m]))
        figure.colorbar(ScalarMappable(norm, _SCALE), ax=axes, shrink=0.6, pad=0.08, label=title)
    drawn = "drawn true to scale" if times == 1 else f"drawn {times:g} times larger"
    material = solved.case.material
    figure.suptitle(
        f"E = {material.young_modulus_pa:g} Pa, ν = {solved.poisson_ratio:g}, {solved.case.law.replace('_', '-')}; "
        f"deformation {drawn}",
        color=_INK,
        fontsize=11,
    )
    figure.savefig(path)


def _surface(solved: SolvedCase) -> trimesh.Trimesh:
    """The mesh at rest, its faces cut until they can bend with the cells."""
    triangles = solved.case.triangles_m
    mesh = trimesh.Trimesh(triangles.reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3), process=True)
    edge_m = solved.placement.cell_m
    while mesh.area / edge_m**2 > _MOST_TRIANGLES / 6:
        edge_m *= 1.5
    subdivide = trimesh.remesh.subdivide_to_size
    vertices, faces = subdivide(mesh.vertices, mesh.faces, max_edge=edge_m, max_iter=20)  # type: ignore[no-untyped-call]
    return trimesh.Trimesh(vertices, faces, process=True)


def _stress_at(solved: SolvedCase, points_m: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, " n"]:
    """Von Mises stress at points of the surface: means of the cells about each node, weighted by what they hold."""
    stress_pa, _ = cell_fields(solved)
    body = solved.body
    nodes = body.cell_nodes.ravel()
    share = np.bincount(nodes, weights=np.repeat(body.fill, 8), minlength=body.nodes)
    total = np.bincount(nodes, weights=np.repeat(body.fill * stress_pa, 8), minlength=body.nodes)
    nodal = np.repeat((total / np.maximum(share, 1e-12))[:, None], 3, axis=1)
    return np.asarray(np.maximum(Interpolation(body, nodal).at(solved.placement.to_cube(points_m))[:, 0], 0.0))


def _exaggeration(peak_m: float, longest_m: float) -> float:
    """1 where the deformation can be seen as it is, else the round number that makes it so."""
    if peak_m == 0.0 or peak_m >= _VISIBLE * longest_m:
        return 1.0
    wanted = 2 * _VISIBLE * longest_m / peak_m
    power = 10.0 ** math.floor(math.log10(wanted))
    return max(step * power for step in (1.0, 2.0, 5.0) if step * power <= wanted)


def _length_unit(peak_m: float) -> tuple[str, float]:
    return ("mm", 1e3) if peak_m >= 1e-4 else ("µm", 1e6)


def _draw_surface(
    axes: Axes3D, triangles: Float64[np.ndarray, "m 3 3"], values: Float64[np.ndarray, " m"], norm: Normalize
) -> None:
    scale: Colormap = _SCALE
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    shade = 0.72 + 0.28 * np.clip(normals @ _LIGHT, -1.0, 1.0)
    colours = scale(norm(values))
    colours[:, :3] *= shade[:, None]
    axes.add_collection3d(Poly3DCollection(triangles, facecolors=colours, edgecolors=colours, linewidths=0.3))


def _draw_creases(axes: Axes3D, mesh: trimesh.Trimesh) -> None:
    """Sharp edges of the body at rest."""
    edges = mesh.face_adjacency_edges[mesh.face_adjacency_angles > _CREASE_RAD]
    axes.add_collection3d(Line3DCollection(mesh.vertices[edges], colors=_FAINT, linewidths=0.8))


def _draw_forces(axes: Axes3D, solved: SolvedCase) -> None:
    forces = solved.case.forces
    largest_n = max((float(np.linalg.norm(force.force_n)) for force in forces), default=0.0)
    for force in forces:
        if largest_n > 0.0:
            arrow = 0.3 * solved.placement.longest_m * force.force_n / largest_n
            axes.quiver(*(force.contact_m - arrow), *arrow, color=_FORCE, linewidth=2.0, arrow_length_ratio=0.25)


def _frame(axes: Axes3D, points_m: Float64[np.ndarray, "n 3"]) -> None:
    low, high = points_m.min(axis=0), points_m.max(axis=0)
    margin = 0.02 * float((high - low).max())
    for axis, name in enumerate("xyz"):
        getattr(axes, f"set_{name}lim")(low[axis] - margin, high[axis] + margin)
        getattr(axes, f"set_{name}label")(f"{name}, m", fontsize=8, color=_FAINT)
    axes.set_box_aspect(high - low + 2 * margin)
    axes.tick_params(labelsize=6, colors=_FAINT)
    axes.locator_params(nbins=4)
    axes.view_init(elev=22, azim=-58)
