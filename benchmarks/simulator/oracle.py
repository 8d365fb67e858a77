"""The time that scikit-fem takes for what the simulator solves."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from training.simulation.body import Body
from training.simulation.material_law import lame
from training.simulation.solver import LinearSolver


def measure_oracle(body: Body, poisson_ratio: float = 0.3) -> dict[str, float]:
    """One load on one body: our assembly, factor and solve beside scikit-fem's, on the same cells."""
    import scipy.sparse as sp
    import skfem
    from skfem.models.elasticity import linear_elasticity

    def timed(action: Callable[[], Any]) -> tuple[Any, float]:
        start = time.process_time()
        return action(), time.process_time() - start

    body.__dict__.pop("pattern", None)
    forces = np.zeros((1, body.nodes, 3))
    forces[0, body.node_grid[:, 2] == body.node_grid[:, 2].max(), 0] = 1e-4
    _, ours = timed(lambda: LinearSolver(body, poisson_ratio).solve_forces(forces))

    def assemble() -> tuple[Any, ...]:
        line = np.linspace(0.0, 1.0, body.cells + 1)
        mesh = skfem.MeshHex.init_tensor(line, line, line)
        index = np.floor(mesh.p[:, mesh.t].mean(axis=1).T * body.cells).astype(int)
        wanted = np.zeros((body.cells,) * 3, bool)
        wanted[tuple(body.active.T)] = True
        mesh = mesh.restrict(np.flatnonzero(wanted[tuple(index.T)]))
        basis = skfem.Basis(mesh, skfem.ElementVector(skfem.ElementHex1()), intorder=2)
        mu, lam = lame(poisson_ratio)
        stiffness = linear_elasticity(lam, mu).assemble(basis)
        rhs = np.zeros(stiffness.shape[0])
        top = np.isclose(mesh.p[2], body.node_positions[:, 2].max())
        rhs[basis.nodal_dofs[0, top]] = 1e-4
        held = basis.get_dofs(lambda x: np.isclose(x[2], 0.0))
        return skfem.condense(stiffness, rhs, D=held, expand=False)

    (matrix, rhs), assembly = timed(assemble)
    _, superlu = timed(lambda: skfem.solve(matrix, rhs))
    result = {"cells": len(body.active), "ours_s": ours, "skfem_assembly_s": assembly, "skfem_superlu_s": superlu}
    try:
        import pypardiso
    except ImportError:
        return result
    return {**result, "skfem_pardiso_s": timed(lambda: pypardiso.spsolve(sp.csr_matrix(matrix), rhs))[1]}
