"""What robots ask after the start finds every kernel loaded."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from numba.core.dispatcher import Dispatcher

import service.warm_up as warm_up_module
from service.core.camera import make_intrinsics
from service.core.grids import pack_bits
from service.core.materials import Material
from service.core.messages import DeformRequest, EarlierReconstruction, EncodedImage, KnownShape, Load, Observation
from service.inference.registry import load_models
from service.pipeline import Body, Pipeline
from service.reconstructions import Reconstructions
from service.warm_up import warm_up
from tests.conftest import ROOT
from tests.poses import pose
from tests.synthetic_scenes import CAMERA, Box, render


def loaded() -> dict[str, int]:
    """How often each kernel of the service has been compiled or loaded, by its name."""
    modules = [module for name, module in sys.modules.items() if name.startswith("service")]
    kernels = {kernel for module in modules for kernel in vars(module).values() if isinstance(kernel, Dispatcher)}
    return {f"{kernel.__module__}.{kernel.__name__}": len(kernel.signatures) for kernel in kernels}


def questions() -> list[DeformRequest]:
    """In other words than the warm-up asks them: large and small frames, every encoding, a lens, a turned shape."""
    soft = Material(5e4, 0.3)
    scene = render([Box((-0.05, -0.04, 0.0), (0.05, 0.04, 0.14))], noise_m=0.0005)
    contact_m = (scene.camera_from_table @ [0.0, -0.04, 0.1, 1.0])[:3]
    push = Load(scene.camera_from_table[:3, :3] @ [0.0, 3.0, 0.0], contact_m)
    counts = np.rint(1e4 * np.nan_to_num(scene.depth_m)).astype(np.uint16)
    mask = EncodedImage("png8", cv2.imencode(".png", (scene.shown == 0).astype(np.uint8))[1].tobytes())
    depths = [
        EncodedImage("png16", cv2.imencode(".png", counts)[1].tobytes(), 1e-4),
        EncodedImage("16UC1", counts.tobytes(), 1e-4),
        EncodedImage("32FC1", (1e3 * scene.depth_m).tobytes(), 1e-3),
    ]
    frames = [Observation(CAMERA, depth) for depth in depths]
    lens = replace(CAMERA, distortion=(0.01, 0.0, 0.0, 0.0))
    frames += [replace(frames[0], mask=mask), replace(frames[0], intrinsics=lens)]
    frames += [replace(frames[1], up=scene.up, roi=(20, 20, 600, 440))]
    small = make_intrinsics(CAMERA.fx / 4, CAMERA.fy / 4, CAMERA.cx / 4, CAMERA.cy / 4, 160, 120)
    frames.append(Observation(small, EncodedImage("32FC1", scene.depth_m[::4, ::4].copy().tobytes())))
    asked = [DeformRequest(frame, soft, (push,)) for frame in frames]
    several = (push, replace(push, force_n=np.zeros(3)), push)
    asked.append(DeformRequest(frames[0], soft, several, uncertainty_samples=3))
    brick = np.zeros((64, 64, 64), bool)
    brick[18:46, 22:42, 0:40] = True
    turned = pose((0.4, -0.2, 0.9), (0.05, 0.02, 0.7))
    touched = Load(np.array([1.0, 2.0, 3.0]), (turned @ [0.128, 0.128, 0.16, 1.0])[:3])
    asked += [
        DeformRequest(KnownShape(pack_bits(brick).tobytes(), 0.004, turned, up), soft, (touched,))
        for up in (None, np.array([0.0, -1.0, 0.0]))
    ]
    return asked


def main() -> None:
    """Warm a pipeline up, ask, and name what was loaded on the way."""
    models = load_models(ROOT / "models", threads=1)
    pipeline = Pipeline(models.reconstruction, models.deformation, kept=Reconstructions[Body](2**25, 60.0))
    warm_up(models)
    before = loaded()
    for request in questions():
        answer = pipeline.predict(request)
        assert answer.reconstruction_id is not None
        pipeline.predict(replace(request, source=EarlierReconstruction(answer.reconstruction_id)))
    late = [name for name, count in loaded().items() if count != before[name]]
    print(len(before), *late)


def test_after_the_warm_up_no_question_compiles_or_loads_a_kernel() -> None:
    # A process of its own: in this one other tests have asked already.
    done = subprocess.run(
        [sys.executable, "-W", "error", "-m", "tests.service." + Path(__file__).stem],
        cwd=ROOT, capture_output=True, text=True, timeout=170,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    known, *late = done.stdout.split()
    assert int(known) >= 10
    assert late == []


def test_another_process_compiles_the_solve_meanwhile(monkeypatch: pytest.MonkeyPatch) -> None:
    begun: list[list[str]] = []

    class Process:
        def __init__(self, command: list[str], **_: object) -> None:
            begun.append(command)

        def wait(self) -> int:
            begun.append(["waited"])
            return 0

    monkeypatch.setattr(warm_up_module.subprocess, "Popen", Process)
    for cores, expected in ((2, [[sys.executable, "-m", "service.warm_up"], ["waited"]]), (1, [])):
        begun.clear()
        monkeypatch.setattr(warm_up_module, "available_cores", lambda cores=cores: cores)
        beside = warm_up_module._Beside()
        beside.wait()  # nothing was compiled yet: there is nothing to wait for
        assert begun == []
        beside.begin()
        beside.wait()
        assert begun == expected


def test_what_runs_beside_needs_no_models() -> None:
    done = subprocess.run(
        [sys.executable, "-W", "error", "-m", "service.warm_up"], cwd=ROOT, capture_output=True, text=True, timeout=170
    )
    assert done.returncode == 0, done.stderr


if __name__ == "__main__":
    main()
