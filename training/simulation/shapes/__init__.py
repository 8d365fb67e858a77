"""Bodies as signed distance functions: primitives, how they combine, and shapes that stand on the ground."""

from training.simulation.shapes.field import Bounds, Field
from training.simulation.shapes.shape import (
    Shape,
    min_thickness,
    normalise,
    stand,
    tight_bounds,
    to_cube,
    voxelize,
)

__all__ = ["Bounds", "Field", "Shape", "min_thickness", "normalise", "stand", "tight_bounds", "to_cube", "voxelize"]
