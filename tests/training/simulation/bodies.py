"""Shapes and reference computations that several simulator tests share."""

import numpy as np
import scipy.sparse as sp

from training.simulation.body import Body
from training.simulation.elements import PAIRS_24
from training.simulation.enhanced import EnhancedHexahedron
from training.simulation.factor import factorise
from training.simulation.mean_dilatation import MeanDilatationHexahedron
from training.simulation.surface import Distance


def box(center, half) -> Distance:
    """Exact distance to an axis-aligned box."""
    center, half = np.float32(center), np.float32(half)

    def distance(points):
        q = np.abs(points - center) - half
        outside = np.sqrt((np.maximum(q, 0.0) ** 2).sum(axis=1))
        return (outside + np.minimum(q.max(axis=1), 0.0)).astype(np.float32)

    return distance


def sphere(center, radius) -> Distance:
    center = np.float32(center)
    return lambda points: (np.linalg.norm(points - center, axis=1) - np.float32(radius)).astype(np.float32)


def union(*parts: Distance) -> Distance:
    return lambda points: np.min([part(points) for part in parts], axis=0)


def bridge(members: int = 12) -> Distance:
    """Two legs and a beam; every face lies on a grid plane of twelfths."""
    assert members % 12 == 0
    legs = [box([x, 0.5, 0.25], [1 / 12, 2 / 12, 0.25]) for x in (3 / 12, 9 / 12)]
    return union(*legs, box([0.5, 0.5, 7 / 12], [4 / 12, 2 / 12, 1 / 12]))


def column(width: float, height: float) -> Distance:
    return box([0.5, 0.5, height / 2], [width / 2, width / 2, height / 2])


def whole_cube(points):
    """Everything is inside, so that every cell of the grid is full."""
    return np.full(len(points), -1.0, np.float32)


ELEMENTS = [MeanDilatationHexahedron, EnhancedHexahedron]


def at_rest(element, cells: int):
    """Displacements and internal parameters of cells at rest."""
    return np.zeros((24, cells)), np.zeros((element.internal, cells))


def full_stiffness(body: Body, poisson_ratio: float, element=MeanDilatationHexahedron) -> sp.csr_array:
    """Stiffness over all degrees of freedom, clamped ones too, assembled the plain way."""
    law = element(body.cell_edge, body.octant_fill, poisson_ratio)
    upper = law.tangent(*at_rest(law, len(body.active))).stiffness
    local = np.zeros((24, 24, upper.shape[1]))
    rows, columns = PAIRS_24
    local[rows, columns] = upper
    local[columns, rows] = upper
    dof = (3 * body.cell_nodes[:, :, None] + np.arange(3)).reshape(-1, 24)
    row = np.repeat(dof, 24, axis=1)
    column = np.tile(dof, (1, 24))
    values = local.transpose(2, 0, 1).reshape(len(dof), -1)
    size = 3 * body.nodes
    return sp.coo_array((values.ravel(), (row.ravel(), column.ravel())), shape=(size, size)).tocsr()


def solve_dirichlet(stiffness, fixed, values, forces=None):
    """Displacements with some degrees of freedom prescribed; `fixed` and `values` are (nodes, 3)."""
    fixed = fixed.ravel()
    solution = np.where(fixed, values.ravel(), 0.0)
    load = np.zeros(len(solution)) if forces is None else forces.ravel().copy()
    load -= stiffness @ solution
    free = np.flatnonzero(~fixed)
    # our factor, which other tests prove: SciPy's own takes seconds on a full cube
    upper = sp.csr_array(sp.triu(stiffness[free][:, free], format="csr"))
    solution[free] = factorise(upper).solve(load[free][:, None])[:, 0]
    return solution.reshape(-1, 3)


def on_boundary(body: Body):
    """Nodes on the faces of the cube."""
    return ((body.node_grid == 0) | (body.node_grid == body.cells)).any(axis=1)
