"""The solution of a load case: placed in the unit cube, checked against its cells, solved, brought back to SI."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from training.simulation import clamp as clamps
from training.simulation.body import Body, BodyError
from training.simulation.case import (
    MAX_CELLS,
    Case,
    CaseError,
    CaseWarning,
    ContactOffSurface,
    NotConverged,
    NotHeld,
    simulated_poisson_ratio,
)
from training.simulation.distance_grid import distance_grid
from training.simulation.enhanced import EnhancedHexahedron
from training.simulation.loads import PATCH_RADIUS, Load, LoadError, nodal_forces, self_weight
from training.simulation.mean_dilatation import MeanDilatationHexahedron
from training.simulation.nearest import nearest_on_surface
from training.simulation.newton import follow_forces
from training.simulation.placement import Placement
from training.simulation.shapes import Shape, min_thickness
from training.simulation.shapes.shape import FILL_HEIGHT, FILL_HORIZONTAL
from training.simulation.solution import Solution
from training.simulation.solver import LinearSolver

ELEMENTS: Mapping[str, type[EnhancedHexahedron] | type[MeanDilatationHexahedron]] = {
    "enhanced": EnhancedHexahedron,
    "mean_dilatation": MeanDilatationHexahedron,
}
HOLD_STIFFNESS = 1e4
"""Of the bed that holds a region, in E/L: as good as rigid. The ground gives as it does in the data sets."""
MEMBER_CELLS = 3.0
"""Members thinner than this many cells bend too stiffly or too softly to be trusted."""
COARSEST_GRID = 64
"""Least cells of the distance grid along the longest edge."""
SHELL_CELLS = 0.5
"""Integrals over the surface take in points this many cells off it."""
COARSE_VOXELS, FINE_VOXELS = 56, 112
"""Along the longest edge, to find the thinnest member with; it is found to a voxel."""
CONTACT_TOLERANCE = 0.02
"""Farthest that a contact may lie off the surface, as a part of the body's longest edge."""
PATCH_CELLS = 2.0
"""Patches of a smaller radius than this many cells are blurred by the cells."""


@dataclass(frozen=True, eq=False)
class SolvedCase:
    """The equilibrium of a case.

    Attributes:
        case: What was asked.
        placement: Between metres and the cube.
        body: In the cube.
        solver: Its linear solver, whose element holds the law.
        poisson_ratio: The one it was solved at.
        loads_n: Nodal forces that act.
        steps: Every load step, in units of the cube; the last carries the whole load.
        thickness_m: Of the thinnest member, measured.
    """

    case: Case
    placement: Placement
    body: Body
    solver: LinearSolver
    poisson_ratio: float
    loads_n: Float64[np.ndarray, "nodes 3"]
    steps: tuple[Solution, ...]
    thickness_m: float

    @property
    def state(self) -> Solution:
        """The equilibrium under the whole load, in units of the cube."""
        return self.steps[-1]

    @property
    def displacement_m(self) -> Float64[np.ndarray, "nodes 3"]:
        """Of every node; those of nearly empty cells mean little."""
        return self.state.displacement * self.placement.edge_m

    @property
    def reactions_n(self) -> Float64[np.ndarray, "nodes 3"]:
        """Forces of the clamp on the nodes."""
        unbalanced = np.zeros_like(self.state.displacement)
        nodal = self.body.clamp_forces(self.state.displacement, unbalanced)
        return np.asarray(nodal * self.placement.force_unit_n(self.case.material.young_modulus_pa))


def solve_case(case: Case) -> SolvedCase:
    """Place, check and solve a case.

    Warns (`CaseWarning`) of a Poisson's ratio above 0.49, of members thinner than three cells and of patches smaller
    than two.

    Raises:
        CaseError: Any of its leaves.
    """
    poisson_ratio = simulated_poisson_ratio(case)
    placement = Placement.of(case.triangles_m, case.cells, case.fill, case.clamps)
    shape = _shape(case, placement)
    thickness_m = _thickness(shape, case.cells) * placement.edge_m
    _warn_of_thin_members(case, placement, thickness_m)
    body = _body(case, shape, placement)
    forces = _forces(case, placement, body)
    solver = LinearSolver(body, poisson_ratio, ELEMENTS[case.element])
    if case.law == "linear":
        steps = [_linear(solver, forces)]
    else:
        steps = follow_forces(solver, forces, [(step + 1) / case.load_steps for step in range(case.load_steps)])
    if not steps[-1].converged:
        raise NotConverged(_why(steps[-1], case), solution=steps[-1])
    loads_n = forces * placement.force_unit_n(case.material.young_modulus_pa)
    return SolvedCase(case, placement, body, solver, poisson_ratio, loads_n, tuple(steps), thickness_m)


def _shape(case: Case, placement: Placement) -> Shape:
    """The mesh in the cube; its distance is exact as far from the surface as the simulator integrates over it."""
    resolution = max(COARSEST_GRID, 4 * case.cells)
    grid_cells = resolution * placement.cell_m / placement.longest_m
    grid = distance_grid(placement.to_cube(case.triangles_m), resolution, math.ceil(SHELL_CELLS * grid_cells) + 1)
    return Shape("mesh", grid)


def _thickness(shape: Shape, cells: int) -> float:
    """Thinnest member in cube edges, measured on finer voxels where it is few of them."""
    extent = shape.bounds[:, 1] - shape.bounds[:, 0]
    # `min_thickness` counts in edges of the cube that data sets would put the body in
    unit = float(max(extent[0] / FILL_HORIZONTAL, extent[1] / FILL_HORIZONTAL, extent[2] / FILL_HEIGHT))
    thickness = unit * min_thickness(shape, COARSE_VOXELS)
    if thickness < 1.5 * MEMBER_CELLS / cells:
        thickness = unit * min_thickness(shape, FINE_VOXELS, finest=0.005)
    return thickness


def _warn_of_thin_members(case: Case, placement: Placement, thickness_m: float) -> None:
    members = thickness_m / placement.cell_m
    if members < MEMBER_CELLS - placement.longest_m / FINE_VOXELS / placement.cell_m:
        needed = math.ceil(MEMBER_CELLS / members * case.cells)
        advice = f"{needed} cells an edge are" if needed <= MAX_CELLS else f"more than the {MAX_CELLS} possible are"
        warnings.warn(
            f"the thinnest member measures {thickness_m:.3g} m, {members:.1f} cells of {placement.cell_m:.3g} m; "
            f"three are needed for bending: {advice} enough",
            CaseWarning,
            stacklevel=3,
        )


def _body(case: Case, shape: Shape, placement: Placement) -> Body:
    regions = placement.regions(case.clamps)
    clamp = clamps.Clamp() if regions is None else clamps.Clamp(region=regions, stiffness=HOLD_STIFFNESS)
    try:
        return Body.from_distance(shape.distance, case.cells, clamp)
    except BodyError as error:
        if error.reason == "clamp_off_body":
            low, high = (placement.to_metres(shape.bounds[:, side][None])[0] for side in range(2))
            raise NotHeld(
                f"{error}; the body spans {low.round(6).tolist()} to {high.round(6).tolist()} m in the file's axes"
            ) from error
        if error.reason in ("not_standing", "disconnected"):
            raise NotHeld(str(error)) from error
        raise CaseError(str(error)) from error


def _forces(case: Case, placement: Placement, body: Body) -> Float64[np.ndarray, "nodes 3"]:
    """All that acts, as nodal forces in units of E L²."""
    total = np.zeros((body.nodes, 3))
    unit_n = placement.force_unit_n(case.material.young_modulus_pa)
    tolerance_m = CONTACT_TOLERANCE * placement.longest_m
    for number, force in enumerate(case.forces, start=1):
        surface_m = nearest_on_surface(case.triangles_m, force.contact_m).point_m
        distance_m = float(np.linalg.norm(surface_m - force.contact_m))
        if distance_m > tolerance_m:
            raise ContactOffSurface(
                f"the contact of load {number} lies {distance_m:.3g} m off the surface, more than the "
                f"{tolerance_m:.3g} m that are put right; the nearest surface is at {surface_m.round(6).tolist()} m",
                distance_m=distance_m,
            )
        size_n = float(np.linalg.norm(force.force_n))
        if size_n == 0.0:
            continue
        radius_m = force.patch_radius_m
        if radius_m is None:
            radius_m = max(PATCH_RADIUS * placement.edge_m, PATCH_CELLS * placement.cell_m)
        if radius_m < (PATCH_CELLS - 1e-9) * placement.cell_m:
            warnings.warn(
                f"the patch of load {number} has a radius of {radius_m:.3g} m, less than two cells of "
                f"{placement.cell_m:.3g} m: the dent under it is not resolved",
                CaseWarning,
                stacklevel=3,
            )
        contact = placement.to_cube(surface_m[None])[0]
        load = Load(contact, force.force_n / size_n, size_n / unit_n, radius_m / placement.edge_m)
        try:
            total += nodal_forces(body, load)
        except LoadError as error:
            raise CaseError(f"load {number}: {error}") from error
    density_kg_m3 = case.material.density_kg_m3
    if density_kg_m3 is not None and case.gravity_m_s2 is not None:
        number_of_weight = density_kg_m3 * placement.edge_m / case.material.young_modulus_pa
        total += self_weight(body, number_of_weight * case.gravity_m_s2)
    return total


def _linear(solver: LinearSolver, forces: Float64[np.ndarray, "nodes 3"]) -> Solution:
    """The linear state in the words of the nonlinear one."""
    body = solver.body
    displacement = solver.solve_forces(forces[None])[0]
    moved = body.gather(displacement)
    parameters = np.ascontiguousarray(-(solver.tangent.recovery @ moved.T[:, :, None])[:, :, 0].T)
    internal = solver.internal_forces(displacement)
    residual = float(np.linalg.norm(internal + body.foundation @ displacement - forces) / np.linalg.norm(forces))
    inner = np.unique(body.cell_nodes[body.fill >= 0.5])
    return Solution(
        displacement=displacement,
        parameters=parameters,
        fraction=1.0,
        loads=(),
        reason=None,
        iterations=1,
        residual=residual,
        residuals=(1.0, residual),
        smallest_jacobian=solver.element.evaluate(moved, parameters).smallest_jacobian,
        strain_energy=0.5 * float((internal * displacement).sum()),
        peak_displacement=float(np.linalg.norm(displacement[inner], axis=1).max(initial=0.0)),
        reaction=solver.reaction(displacement, forces),
    )


def _why(solution: Solution, case: Case) -> str:
    """What failed, and what to try."""
    at = f"at {solution.fraction:.0%} of the load"
    if solution.reason == "left_cube":
        return f"the body leaves the simulated cube {at}: give it more room than a fill of {case.fill:g}"
    if solution.reason == "inverted":
        return (
            f"a cell is squeezed to {solution.smallest_jacobian:.2g} of its volume {at}: the load is too large for "
            f"this material, or its patch too small"
        )
    return (
        f"not converged {at}: the residual is {solution.residual:.1e} of the load after {solution.iterations} "
        f"iterations; try more than {case.load_steps} load steps, or a smaller load"
    )
