"""The paper's cascade in torch: reconstruction from a view, deformation from a shape and a condition."""
