"""Questions of every kind, asked before the first robot asks one.

The networks' sessions plan their memory in their first runs, kernels are loaded or, where this is the first start on
this kind of processor, compiled. A robot that were the first to take a way through the pipeline would wait for it.

    python -m service.warm_up      what `warm_up` runs beside itself where kernels are compiled: those of the solve
"""

from __future__ import annotations

import contextlib
import logging
import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace

import cv2
import numpy as np

from service.core.arrays import GRID_SIZE, Occupancy
from service.core.camera import make_intrinsics
from service.core.compiled import on_compiling
from service.core.condition import Condition
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
from service.core.motion import motion
from service.core.prior import ElasticPrior
from service.inference.deformation import Prior
from service.inference.registry import Models
from service.inference.spare_cores import Once
from service.pipeline import Body, Pipeline
from service.reconstructions import Reconstructions
from service.settings import available_cores

log = logging.getLogger(__name__)

WIDTH, HEIGHT, FOCAL_PX = 160, 120, 150.0
TABLE_M, TOP_M, SIDE_M = 0.6, 0.5, 0.12
"""A cube of 12 cm, nearly, on a table that the camera looks straight down on."""

RUBBER = Material(young_modulus_pa=1e5, poisson_ratio=0.4)
DOWN = Load(force_n=np.array([0.0, 0.0, 5.0]), contact_m=np.array([0.0, 0.0, TOP_M]))
PUSH: Condition = np.array([0.5, 0.5, 0.5, 0.0, 0.0, -1.0, -3.0, 0.4, 0.1], np.float32)
AT_PIXEL = Load(force_n=np.array([1.0, 0.0, 5.0]), contact_px=(WIDTH / 2, HEIGHT / 2))


KEPT_BYTES, KEPT_S = 2**25, 600.0
"""What the questions reconstruct is kept apart from what robots may ask again, as long as compiling may take."""


def warm_up(models: Models) -> None:
    """Ask one question of every kind; what networks in training answer is of no account."""
    beside = _Beside()
    with on_compiling(beside.begin):
        kept = Reconstructions[Body](KEPT_BYTES, KEPT_S)
        pipeline = Pipeline(models.reconstruction, models.deformation, kept=kept)
        questions = list(_questions())
        with contextlib.suppress(PhysNetError):
            pipeline.predict(replace(questions[0], loads=()))
        _deform_unsolved(models)
        beside.wait()
        earlier = None
        for request in questions:
            with contextlib.suppress(PhysNetError):
                earlier = pipeline.predict(request).reconstruction_id or earlier
        if earlier is not None:
            with contextlib.suppress(PhysNetError):
                pipeline.predict(DeformRequest(EarlierReconstruction(earlier), RUBBER, (DOWN,)))


class _Beside:
    """Another process that compiles the coarse solve, half of it all, while this one compiles what needs no solve."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None

    def begin(self) -> None:
        """Called before the first kernel is compiled, if one is."""
        # Nothing is wrong, but whoever waits should see it where logs are not set up, too.
        log.warning(
            "compiling for this processor: up to a minute, this once; later starts load what is kept in __pycache__, "
            "or where NUMBA_CACHE_DIR says"
        )
        if available_cores() > 1:
            self._process = subprocess.Popen(
                [sys.executable, "-m", __name__], env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
                stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            )  # fmt: skip

    def wait(self) -> None:
        """What it did not do, for whatever reason, is compiled here."""
        if self._process is not None:
            self._process.wait()


def _deform_unsolved(models: Models) -> None:
    """The network's half of a deformation, for a body that the solve would not move."""
    still = np.zeros((1, 3, 16, 16, 16), np.float32), np.zeros((1, 3, 32, 32, 32), np.float32)
    block = _block()
    answer = models.deformation(block, [PUSH], prior=Prior(still[0], Once(lambda: still[1]), np.ones(1, bool)))
    motion(answer.field[0], block, answer.probability[0], threshold=0.5, edge_m=0.2)


def _solve() -> None:
    ElasticPrior(_block(), RUBBER.poisson_ratio).displacements([PUSH])


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
    block = _block()
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[:3, 3] = (-0.1, 0.1, TABLE_M)
    # One is answered in its own grid; the other stands askew in its own and is looked up in another.
    for side_m, up in ((0.2, None), (0.1, np.array([0.3, 0.0, -1.0]))):
        yield DeformRequest(KnownShape(pack_bits(block).tobytes(), side_m / GRID_SIZE, pose, up), RUBBER, (DOWN,))


def _block() -> Occupancy:
    block = np.zeros((GRID_SIZE,) * 3, bool)
    block[14:50, 14:50, :36] = True
    return block


def _png(image: np.ndarray) -> bytes:
    _, file = cv2.imencode(".png", image)
    return file.tobytes()


if __name__ == "__main__":
    _solve()
