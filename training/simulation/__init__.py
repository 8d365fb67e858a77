"""Ground truth: signed distance shapes, a finite-cell elasticity solver, and a depth camera with its sensor noise."""
