"""`physnet-train solve`: one load case of any watertight mesh."""

from __future__ import annotations

import argparse
import json
import re
import sys
import time
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from training.commands import grammar

if TYPE_CHECKING:
    from training.simulation.probe import Reading
    from training.simulation.solved_case import SolvedCase

GRAVITY_M_S2 = (0.0, 0.0, -9.81)
EPILOG = """\
Points, patch radii and clamps are in the unit and the axes of the mesh file; forces in N, results in SI.

  --load  x,y,z:fx,fy,fz[:radius]    a force on a round patch about a point of the surface
  --clamp ground                     what stands on the lowest plane of z (the default)
  --clamp below:z=0, above:x=1.5     the surface beyond a plane
  --clamp box:x0,y0,z0,x1,y1,z1      the surface within a box
  --probe x,y,z                      a point of the body, or of a marker that stands off it by less than a tenth of it

Exit codes: 0 solved; 2 the mesh, the numbers or the load make no case that can be solved.
"""


def add_solve(commands: Any) -> None:
    """Register the command with argparse's sub-parsers."""
    parser: argparse.ArgumentParser = commands.add_parser(
        "solve",
        help="solve one load case of a mesh",
        description=__doc__,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    # vectors may begin with a minus: without this argparse takes -9.81,0,0 for an option
    parser._negative_number_matcher = re.compile(r"^-[\d.]")
    parser.add_argument("mesh", type=Path, help="OBJ, STL, PLY, glTF or what else trimesh reads")
    parser.add_argument("--unit", choices=grammar.UNITS_M, required=True, help="unit of length of the file")
    parser.add_argument("--young", type=float, required=True, metavar="PA", help="Young's modulus")
    parser.add_argument("--poisson", type=float, required=True, help="Poisson's ratio, 0 to 0.5; solved up to 0.49")
    parser.add_argument("--density", type=float, metavar="KG_M3", help="makes the body's own weight count")
    parser.add_argument("--gravity", type=grammar.vector, metavar="X,Y,Z", help="m/s²; else 0,0,-9.81")
    parser.add_argument("--clamp", type=grammar.clamp, action="append", default=[], help="what is held; several add up")
    parser.add_argument("--load", type=grammar.load, action="append", default=[], help="a force; several add up")
    parser.add_argument("--law", choices=["neo_hookean", "linear"], default="neo_hookean")
    parser.add_argument("--element", choices=["enhanced", "mean_dilatation"], default="enhanced")
    parser.add_argument("--cells", type=int, default=24, help="along the edge of the simulated cube")
    parser.add_argument("--fill", type=float, default=0.74, help="part of it that the longest edge takes")
    parser.add_argument("--steps", type=int, default=3, help="load steps of the neo-Hookean law")
    parser.add_argument("--probe", type=grammar.vector, action="append", default=[], metavar="X,Y,Z")
    parser.add_argument("-o", "--output", type=Path, metavar="CASE.vtu", help="cells and fields for ParaView")
    parser.add_argument("--picture", type=Path, metavar="CASE.png", help="the deformed body")
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of a table")
    parser.set_defaults(run=solve)


def solve(options: argparse.Namespace) -> int:
    """Solve, print and write; returns the exit code."""
    from training.simulation.case import CaseError
    from training.simulation.mesh import MeshError

    try:
        with _warnings_in_one_line():
            report = _run(options)
    except (CaseError, MeshError, OSError, ModuleNotFoundError) as error:
        print(f"physnet-train solve: {error}", file=sys.stderr)
        return 2
    print(json.dumps(report, indent=1) if options.json else "\n".join(_lines(report)))
    return 0


def _run(options: argparse.Namespace) -> dict[str, Any]:
    from training.simulation.case import Case, CaseError, Material, PatchForce
    from training.simulation.mesh import load_triangles
    from training.simulation.placement import Box
    from training.simulation.probe import read_probe
    from training.simulation.solved_case import solve_case
    from training.simulation.vtu import write_vtu

    if options.gravity is not None and options.density is None:
        raise CaseError("--gravity without --density: the body's own weight needs both")
    for path in (options.output, options.picture):
        if path is not None and not path.parent.is_dir():
            raise CaseError(f"there is no folder {path.parent} to write {path.name} into")
    if options.output is not None and options.output.suffix != ".vtu":
        raise CaseError(f"{options.output.name}: cases are written as .vtu")
    if options.picture is not None:
        from training.simulation.case_picture import draw_case

    unit_m = grammar.UNITS_M[options.unit]
    triangles_m = load_triangles(options.mesh, unit_m)
    gravity = options.gravity if options.gravity is not None else np.array(GRAVITY_M_S2)
    boxes = tuple(Box(clamp.low * unit_m, clamp.high * unit_m) for clamp in options.clamp if clamp is not None)
    if boxes and len(boxes) < len(options.clamp):
        raise CaseError("--clamp ground stands alone: write below:z=… to hold the bottom and something else")
    case = Case(
        triangles_m=triangles_m,
        material=Material(options.young, options.poisson, options.density),
        forces=tuple(
            PatchForce(load.contact * unit_m, load.force_n, None if load.radius is None else load.radius * unit_m)
            for load in options.load
        ),
        gravity_m_s2=gravity if options.density is not None else None,
        clamps=boxes,
        law=options.law,
        element=options.element,
        cells=options.cells,
        fill=options.fill,
        load_steps=options.steps,
    )
    begin_s = time.perf_counter()
    solved = solve_case(case)
    elapsed_s = time.perf_counter() - begin_s
    probes = [read_probe(solved, point * unit_m) for point in options.probe]
    if options.output is not None:
        write_vtu(solved, options.output)
    if options.picture is not None:
        draw_case(solved, [point * unit_m for point in options.probe], options.picture)
    return {"mesh": options.mesh.name, **_report(solved, probes), "solved_in_s": round(elapsed_s, 3)}


def _report(solved: SolvedCase, probes: Sequence[Reading]) -> dict[str, Any]:
    """All figures of a case, in SI."""
    from training.simulation.case_fields import cell_fields

    case, placement, body, state = solved.case, solved.placement, solved.body, solved.state
    force_unit_n = placement.force_unit_n(case.material.young_modulus_pa)
    positions_m = placement.to_metres(body.node_positions) + solved.displacement_m
    stress_pa, _ = cell_fields(solved)
    return {
        "triangles": len(case.triangles_m),
        "active_cells": len(body.active),
        "cell_m": placement.cell_m,
        "volume_m3": body.volume * placement.edge_m**3,
        "thinnest_member_m": solved.thickness_m,
        "law": case.law,
        "element": case.element,
        "young_modulus_pa": case.material.young_modulus_pa,
        "poisson_ratio": solved.poisson_ratio,
        "probes": [
            {
                "point_m": probe.point_m.tolist(),
                "displacement_m": probe.displacement_m.tolist(),
                "stalk_m": probe.stalk_m,
            }
            for probe in probes
        ],
        "peak_displacement_m": state.peak_displacement * placement.edge_m,
        "peak_von_mises_pa": float(stress_pa[body.fill >= 0.5].max(initial=0.0)),
        "load_n": solved.loads_n.sum(axis=0).tolist(),
        "reaction_n": solved.reactions_n.sum(axis=0).tolist(),
        "reaction_moment_nm": np.cross(positions_m, solved.reactions_n).sum(axis=0).tolist(),
        "strain_energy_j": state.strain_energy * force_unit_n * placement.edge_m,
        "smallest_jacobian": state.smallest_jacobian,
        "steps": [
            {"fraction": step.fraction, "iterations": step.iterations, "residuals": list(step.residuals)}
            for step in solved.steps
        ],
    }


def _lines(report: dict[str, Any]) -> Iterator[str]:
    """The report as a person reads it."""
    yield (
        f"{report['mesh']}: {report['triangles']} triangles, {report['active_cells']} cells of "
        f"{report['cell_m']:.3g} m, volume {report['volume_m3']:.4g} m³, "
        f"thinnest member {report['thinnest_member_m']:.3g} m"
    )
    yield (
        f"{report['law']}, {report['element']} element, E = {report['young_modulus_pa']:g} Pa, "
        f"ν = {report['poisson_ratio']:g}, solved in {report['solved_in_s']:.1f} s"
    )
    for probe in report["probes"]:
        stalk = f" (on a stalk of {probe['stalk_m']:.3g} m)" if probe["stalk_m"] else ""
        yield f"probe {_vector(probe['point_m'])} m moved {_vector(probe['displacement_m'])} m{stalk}"
    yield f"peak displacement {report['peak_displacement_m']:.4g} m"
    yield f"peak von Mises stress {report['peak_von_mises_pa']:.4g} Pa"
    yield f"loads     {_vector(report['load_n'])} N"
    yield f"reaction  {_vector(report['reaction_n'])} N"
    yield f"its moment about the origin {_vector(report['reaction_moment_nm'])} N m"
    yield f"strain energy {report['strain_energy_j']:.4g} J, smallest Jacobian {report['smallest_jacobian']:.4f}"
    for step in report["steps"]:
        residual = f"residual {step['residuals'][-1]:.1e}"
        yield f"converged at {step['fraction']:4.0%}: {step['iterations']} iterations, {residual}"


def _vector(numbers: Sequence[float]) -> str:
    return ", ".join(f"{number:.4g}" for number in numbers)


@contextmanager
def _warnings_in_one_line() -> Iterator[None]:
    """Show warnings as this command's own words, once each, without file names and source lines."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            yield
        finally:
            for text in dict.fromkeys(str(warning.message) for warning in caught):
                print(f"physnet-train solve: warning: {text}", file=sys.stderr)
