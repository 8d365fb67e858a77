"""One load case in SI, of a mesh of any size anywhere: what it is made of, what holds it and what pushes it."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from typing import Literal, TypeAlias

from service.core.arrays import Vector3
from training.simulation.distance_grid import Triangles
from training.simulation.material_law import MAX_POISSON_RATIO
from training.simulation.placement import Box
from training.simulation.shapes.shape import FILL_HEIGHT
from training.simulation.solution import Solution

Law: TypeAlias = Literal["neo_hookean", "linear"]
ElementName: TypeAlias = Literal["enhanced", "mean_dilatation"]

MAX_CELLS = 96
"""The factor of a full cube of 64³ cells takes several gigabytes."""


class CaseError(ValueError):
    """A load case that cannot be solved as it is written.

    CaseError
    ├── BadMaterial        a modulus, ratio, density or number outside its range
    ├── NothingActs        neither a force nor a weight
    ├── ContactOffSurface  a contact farther from the surface than the tolerance; carries `distance_m`
    ├── ProbeOffBody       a probe farther from the body than a marker's stalk; carries `distance_m`
    ├── NotHeld            the clamp does not touch the body, or part of the body does not hang on it
    └── NotConverged       no equilibrium was found; carries the `solution` that failed
    """


class BadMaterial(CaseError):
    pass


class NothingActs(CaseError):
    pass


class ContactOffSurface(CaseError):
    def __init__(self, message: str, *, distance_m: float) -> None:
        super().__init__(message)
        self.distance_m = distance_m


class NotHeld(CaseError):
    pass


class NotConverged(CaseError):
    def __init__(self, message: str, *, solution: Solution) -> None:
        super().__init__(message)
        self.solution = solution


class CaseWarning(UserWarning):
    """A case that is solved, though not quite as asked or not as well as it should be."""


@dataclass(frozen=True)
class Material:
    """Homogeneous isotropic elastic material.

    Attributes:
        young_modulus_pa: E.
        poisson_ratio: ν in [0, 0.5]; above 0.49 the case is solved at 0.49, with a warning.
        density_kg_m3: ρ, where the body's own weight counts.
    """

    young_modulus_pa: float
    poisson_ratio: float
    density_kg_m3: float | None = None


@dataclass(frozen=True, eq=False)
class PatchForce:
    """A dead force on a smooth round patch of the surface.

    Attributes:
        contact_m: Its centre, on the surface.
        force_n: All of it.
        patch_radius_m: None for a tenth of the simulated cube's edge, or two of its cells.
    """

    contact_m: Vector3
    force_n: Vector3
    patch_radius_m: float | None = None


@dataclass(frozen=True, eq=False)
class Case:
    """What to solve; all lengths in metres, in the axes of the mesh.

    Attributes:
        triangles_m: Corners of a closed, outward-facing surface.
        material: What the body is made of.
        forces: What pushes it.
        gravity_m_s2: Acceleration of its own weight; counts with a density.
        clamps: Boxes within which the surface is held; none for what lies lowest, on the ground.
        law: neo_hookean for finite strains, linear for small ones.
        element: Of the cells.
        cells: Along the edge of the simulated cube.
        fill: Part of that edge which the body's longest edge takes; the rest is room to move into.
        load_steps: Equal steps in which a neo-Hookean body is loaded.
    """

    triangles_m: Triangles
    material: Material
    forces: tuple[PatchForce, ...] = ()
    gravity_m_s2: Vector3 | None = None
    clamps: tuple[Box, ...] = ()
    law: Law = "neo_hookean"
    element: ElementName = "enhanced"
    cells: int = 24
    fill: float = FILL_HEIGHT
    load_steps: int = 3


def simulated_poisson_ratio(case: Case) -> float:
    """Refuse numbers that make no case; returns Poisson's ratio as it is simulated, with a warning if it is another.

    Raises:
        BadMaterial: a modulus, ratio or density is outside its range.
        NothingActs: neither a force nor a weight.
        CaseError: there are too few or too many cells or load steps, or no room.
    """
    material = case.material
    if not (math.isfinite(material.young_modulus_pa) and material.young_modulus_pa > 0):
        raise BadMaterial(f"Young's modulus is {material.young_modulus_pa:g} Pa; it must be positive")
    if not 0.0 <= material.poisson_ratio <= 0.5:
        raise BadMaterial(f"Poisson's ratio is {material.poisson_ratio:g}; an elastic solid has 0 to 0.5 here")
    density_kg_m3 = material.density_kg_m3
    if density_kg_m3 is not None and not (density_kg_m3 > 0 and math.isfinite(density_kg_m3)):
        raise BadMaterial(f"the density is {density_kg_m3:g} kg/m³; it must be positive")
    if not 4 <= case.cells <= MAX_CELLS:
        raise CaseError(f"{case.cells} cells along the cube's edge; 4 to {MAX_CELLS} can be solved")
    if not 0.2 <= case.fill <= 0.96:
        raise CaseError(f"the body is to fill {case.fill:g} of the cube's edge; 0.2 to 0.96 leaves room for both")
    if case.load_steps < 1:
        raise CaseError(f"{case.load_steps} load steps; at least one is needed")
    weighs = density_kg_m3 is not None and case.gravity_m_s2 is not None and case.gravity_m_s2.any()
    if not weighs and not any(force.force_n.any() for force in case.forces):
        raise NothingActs("nothing acts on the body: give a load, or a density and gravity for its own weight")
    if material.poisson_ratio > MAX_POISSON_RATIO:
        warnings.warn(
            f"Poisson's ratio {material.poisson_ratio:g} is solved as {MAX_POISSON_RATIO}: above it elements lock",
            CaseWarning,
            stacklevel=3,
        )
    return min(material.poisson_ratio, MAX_POISSON_RATIO)
