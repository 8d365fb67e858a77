"""Bodies never trained on, each seen under one circumstance after the other: noisier sensors, other viewpoints.

What a reconstruction is asked by `python -m training.experiments.reconstructions MODEL --conditions BODIES`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from service.core.arrays import Occupancy
from service.core.camera import Intrinsics
from service.core.errors import PhysNetError
from service.core.segmentation import segment
from service.core.voxels import VoxelView, voxelize
from training.data.frames import Frame, Hints, draw_view
from training.data.views_config import ViewsConfig
from training.simulation.camera import Viewpoint, direction, look_at, render
from training.simulation.distance_grid import DistanceGrid
from training.simulation.families import FAMILIES, sample_shape
from training.simulation.grid_body import sampled, scaled
from training.simulation.sensor import PERFECT, SensorModel, apply_sensor
from training.simulation.shapes import Shape

SEED = 1_000_003
"""Of the bodies and places; no data set has it."""
SIZE_M = 0.15
"""Longest edge of every body."""
FOCAL_PX, WIDTH, HEIGHT = 600.0, 640, 480


@dataclass(frozen=True)
class Circumstance:
    """How a body is seen; what is not named is as in most views that a network is trained on.

    Attributes:
        name: Of its row in the table.
        elevation_deg: Range of the camera's elevation above the support.
        roll_deg: Turn of the camera about its own view.
        span_px: Pixels that the body's diagonal spans.
        sensor: What adds noise.
    """

    name: str
    elevation_deg: tuple[float, float] = (25.0, 45.0)
    roll_deg: float = 0.0
    span_px: float = 160.0
    sensor: SensorModel = field(default_factory=SensorModel)


AS_TRAINED = Circumstance("drawn as for training: any viewpoint and sensor, a table that ends, clutter")
CIRCUMSTANCES = (
    AS_TRAINED,
    Circumstance("as most are seen: from 25° to 45°, half a Kinect's noise"),
    Circumstance("perfect sensor", sensor=PERFECT),
    Circumstance("noise of a Kinect", sensor=SensorModel(noise_scale=1.0)),
    Circumstance("twice that, more than was trained on", sensor=SensorModel(noise_scale=2.0)),
    Circumstance("disparity in coarse steps", sensor=SensorModel(disparity_quantum=2.5e-3)),
    Circumstance("from 5° to 15°", elevation_deg=(5.0, 15.0)),
    Circumstance("from 60° to 85°, seldom trained on", elevation_deg=(60.0, 85.0)),
    Circumstance("from 85° to 89°, never trained on", elevation_deg=(85.0, 89.0)),
    Circumstance("camera rolled by 45°, never trained on", roll_deg=45.0),
    Circumstance("40 pixels, smaller than was trained on", span_px=40.0),
    Circumstance("350 pixels, larger than was trained on", span_px=350.0),
)


def views_under(
    circumstances: tuple[Circumstance, ...], bodies: int
) -> Iterator[tuple[Circumstance, VoxelView, Occupancy]]:
    """Every body under every circumstance, from the same side, with its mask; not where it cannot be segmented.

    Bodies are of all families in turn, members three voxels and more thick, upright. Yields what the service makes of
    the frame and the truth in the same grid.
    """
    for number in range(bodies):
        rng = np.random.default_rng(np.random.SeedSequence((SEED, number)))
        body = sampled(sample_shape(FAMILIES[number % len(FAMILIES)], rng))
        body = scaled(body, SIZE_M / float((body.bounds[:, 1] - body.bounds[:, 0]).max()))
        azimuth, height = rng.uniform(0, 2 * math.pi), rng.random()
        for circumstance in circumstances:
            own = np.random.default_rng((SEED, number))
            if circumstance is AS_TRAINED:
                found = draw_view(body, ViewsConfig(), own)
            else:
                found = _seen(body, circumstance, azimuth, height, own)
            if found is not None:
                yield circumstance, *found


def _seen(
    body: DistanceGrid, circumstance: Circumstance, azimuth: float, height: float, rng: np.random.Generator
) -> tuple[VoxelView, Occupancy] | None:
    low, high = circumstance.elevation_deg
    elevation = math.radians(low + height * (high - low))
    centre, extent = body.bounds.mean(axis=1), body.bounds[:, 1] - body.bounds[:, 0]
    distance_m = FOCAL_PX * float(np.linalg.norm(extent)) / circumstance.span_px
    eye = centre + distance_m * direction(elevation, azimuth)
    camera = Intrinsics(FOCAL_PX, FOCAL_PX, WIDTH / 2, HEIGHT / 2, WIDTH, HEIGHT)
    view = Viewpoint(look_at(eye.tolist(), centre.tolist(), math.radians(circumstance.roll_deg)), camera)
    rendering = render(Shape("object", body), *view)
    depth_m = apply_sensor(rendering.depth_m, rng, FOCAL_PX, circumstance.sensor, holes_near=rendering.mask)
    hints = Hints(rendering.mask, view.camera_from_world[:3, 2], None)
    try:
        found = segment(depth_m, camera, *hints)
    except PhysNetError:
        return None
    if found.support is None:
        return None
    seen = voxelize(found.points, depth_m, camera, found.support.normal, found.support.offset_m)
    frame = Frame(view, depth_m, hints, seen)
    return frame.view, frame.truth(body)
