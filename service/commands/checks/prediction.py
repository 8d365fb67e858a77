"""One whole prediction on the bundled example: does it run, does it make sense, how long does it take."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from service.commands.checks.check import Check
from service.core.errors import PhysNetError
from service.settings import Settings

if TYPE_CHECKING:
    from service.core.messages import DeformResult

REPEATS = 7
CAMERA_PERIOD_MS = 1000.0 / 30.0
"""Frames come no faster; a prediction that takes longer skips some."""


def check_prediction(settings: Settings) -> Iterator[Check]:
    """Load the models, answer the example of the API's documentation, and look at the answer."""
    from service.api import convert
    from service.api.openapi import example_request
    from service.app import build_pipeline

    began = time.perf_counter()
    try:
        predictor = build_pipeline(settings).predictor
    except PhysNetError as error:
        yield Check("prediction", "fail", f"the models do not load: {error.message}", "see above")
        return
    except Exception as error:  # ONNX Runtime raises its own; whatever it is, a person is to read it
        mend = "pip install --force-reinstall onnxruntime; if it stays, report it with this output"
        yield Check("prediction", "fail", f"the models do not load: {error}", mend)
        return
    yield Check("start", "ok", f"models opened and warmed up in {time.perf_counter() - began:.2f} s")
    body = convert.parse_body(json.dumps(example_request()).encode())
    request = convert.deform_request(body, settings.max_loads)
    times_ms, result = [], None
    try:
        for _ in range(REPEATS):
            began = time.perf_counter()
            result = predictor.predict(request)
            times_ms.append(1e3 * (time.perf_counter() - began))
    except Exception as error:  # as above
        yield Check("prediction", "fail", f"{type(error).__name__}: {error}", "report it with this output")
        return
    assert result is not None
    if (wrong := _wrong(result)) is not None:
        yield Check("prediction", "fail", wrong, "the models are not those of this version: see the digests above")
        return
    moved_mm = 1e3 * result.loads[0].max_displacement_m
    yield Check("prediction", "ok", f"the bundled example moves by {moved_mm:.2f} mm")
    yield _timing(times_ms, result, settings.threads)


def _wrong(result: DeformResult) -> str | None:
    """What no answer to the example may be."""
    answer = result.loads[0]
    if not result.reconstruction.any():
        return "the example's box is reconstructed as nothing"
    if not np.isfinite(answer.displacement_m).all():
        return "the displacement of the example is not finite"
    if not 0.0 < answer.max_displacement_m < result.grid.edge_m:
        return f"the example moves by {1e3 * answer.max_displacement_m:.3g} mm, a box of {result.grid.edge_m:.2f} m"
    return None


def _timing(times_ms: list[float], result: DeformResult, threads: int) -> Check:
    middle = float(np.median(times_ms))
    slowest = max((name for name in result.timing_ms if name != "total"), key=lambda name: result.timing_ms[name])
    told = (
        f"{middle:.1f} ms in the middle of {len(times_ms)} ({min(times_ms):.1f} to {max(times_ms):.1f}) "
        f"with {threads} thread{'s' * (threads != 1)}, most of it in {slowest!r}"
    )
    if middle > CAMERA_PERIOD_MS:
        mend = "slower than a camera of 30 frames a second: frames are skipped; more cores, or fewer other programs"
        return Check("timing", "warn", told, mend)
    return Check("timing", "ok", told)
