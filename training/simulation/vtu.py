"""A solved case as a file that ParaView opens: the cells with material, in SI and the axes of the mesh."""

from __future__ import annotations

from pathlib import Path

import meshio
import numpy as np

from training.simulation.case_fields import cell_fields
from training.simulation.solved_case import SolvedCase

VTK_CORNERS = np.array([0, 4, 6, 2, 1, 5, 7, 3])
"""Corner 4·dx + 2·dy + dz of each corner of a VTK_HEXAHEDRON: around the bottom, then around the top."""


def to_meshio(solved: SolvedCase) -> meshio.Mesh:
    """The cells of a solved case.

    Points are nodes at rest, in metres. Point data: `displacement` (m), `load` and `reaction` (N). Cell data:
    `von_mises` (Pa), `fill` (part of the cell that holds material; threshold it at 0.5 to see the body), and
    `smallest_jacobian` (smallest volume ratio at a Gauss point with material).
    """
    stress_pa, jacobian = cell_fields(solved)
    return meshio.Mesh(
        solved.placement.to_metres(solved.body.node_positions),
        [("hexahedron", solved.body.cell_nodes[:, VTK_CORNERS])],
        point_data={
            "displacement": solved.displacement_m,
            "load": solved.loads_n,
            "reaction": solved.reactions_n,
        },
        cell_data={
            "von_mises": [stress_pa],
            "fill": [solved.body.fill],
            "smallest_jacobian": [jacobian],
        },
    )


def write_vtu(solved: SolvedCase, path: Path) -> None:
    """Write a case as VTK unstructured grid, binary and compressed."""
    meshio.write(path, to_meshio(solved), file_format="vtu")
