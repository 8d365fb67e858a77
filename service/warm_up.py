"""Questions of every kind, asked before the first robot asks one.

The networks' sessions plan their memory in their first runs, kernels are loaded or, where this is the first start on
this kind of processor, compiled. A robot that were the first to take a way through the pipeline would wait for it.
"""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Iterator

import cv2
import numpy as np

from service.core.arrays import GRID_SIZE
from service.core.camera import make_intrinsics
from service.core.compiled import on_compiling
from service.core.errors import PhysNetError
from service.core.grids import pack_bits
from service.core.materials import Material
from service.core.messages import (
    DeformRequest,
    EarlierReconstruction,
    EncodedImage,
    KnownShape,
    Load,
    Observation,
)
from service.inference.registry import Models
from service.pipeline import Body, Pipeline
from service.reconstructions import Reconstructions

log = logging.getLogger(__name__)

WIDTH, HEIGHT, FOCAL_PX = 160, 120, 150.0
TABLE_M, TOP_M, SIDE_M = 0.6, 0.5, 0.12
"""A cube of 12 cm, nearly, on a table that the camera looks straight down on."""

RUBBER = Material(young_modulus_pa=1e5, poisson_ratio=0.4)
DOWN = Load(force_n=np.array([0.0, 0.0, 5.0]), contact_m=np.array([0.0, 0.0, TOP_M]))
AT_PIXEL = Load(force_n=np.array([1.0, 0.0, 5.0]), contact_px=(WIDTH / 2, HEIGHT / 2))


KEPT_BYTES, KEPT_S = 2**25, 600.0
"""What the questions reconstruct is kept apart from what robots may ask again, as long as compiling may take."""


def warm_up(models: Models) -> None:
    """Ask one question of every kind; what networks in training answer is of no account."""
    with on_compiling(_tell):
        models.warm_up()
        kept = Reconstructions[Body](KEPT_BYTES, KEPT_S)
        pipeline = Pipeline(models.reconstruction, models.deformation, kept=kept)
        earlier = None
        for request in _questions():
            with contextlib.suppress(PhysNetError):
                earlier = pipeline.predict(request).reconstruction_id or earlier
        if earlier is not None:
            with contextlib.suppress(PhysNetError):
                pipeline.predict(DeformRequest(EarlierReconstruction(earlier), RUBBER, (DOWN,)))


def _tell() -> None:
    # Nothing is wrong, but whoever waits should see it where logs are not set up, too.
    log.warning(
        "compiling for this processor: up to a minute, this once; later starts load what is kept in __pycache__, or "
        "where NUMBA_CACHE_DIR says"
    )


def _questions() -> Iterator[DeformRequest]:
    """From the frame a robot sends most to shapes it knows."""
    camera = make_intrinsics(FOCAL_PX, FOCAL_PX, WIDTH / 2, HEIGHT / 2, WIDTH, HEIGHT)
    half = round(FOCAL_PX * SIDE_M / 2 / TOP_M)
    mask = np.zeros((HEIGHT, WIDTH), np.uint8)
    mask[HEIGHT // 2 - half : HEIGHT // 2 + half, WIDTH // 2 - half : WIDTH // 2 + half] = 255
    depth_m = np.where(mask > 0, np.float32(TOP_M), np.float32(TABLE_M))
    counts = np.rint(1e3 * depth_m).astype(np.uint16)
    as_png, as_floats = EncodedImage("png16", _png(counts)), EncodedImage("32FC1", depth_m.tobytes())
    yield DeformRequest(Observation(camera, as_png), RUBBER, (AT_PIXEL,))
    region = (10, 10, WIDTH - 20, HEIGHT - 20)
    yield DeformRequest(Observation(camera, as_floats, roi=region), RUBBER, (DOWN, AT_PIXEL))
    masked = Observation(camera, as_png, EncodedImage("png8", _png(mask)), up=np.array([0.0, 0.0, -1.0]))
    yield DeformRequest(masked, RUBBER, (DOWN,), uncertainty_samples=2)
    block = np.zeros((GRID_SIZE,) * 3, bool)
    block[14:50, 14:50, :36] = True
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[:3, 3] = (-0.1, 0.1, TABLE_M)
    # One is answered in its own grid; the other stands askew in its own and is looked up in another.
    for side_m, up in ((0.2, None), (0.1, np.array([0.3, 0.0, -1.0]))):
        yield DeformRequest(KnownShape(pack_bits(block).tobytes(), side_m / GRID_SIZE, pose, up), RUBBER, (DOWN,))


def _png(image: np.ndarray) -> bytes:
    _, file = cv2.imencode(".png", image)
    return file.tobytes()
