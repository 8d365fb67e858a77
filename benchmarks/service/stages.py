"""Where every millisecond goes: processor time of each stage on one thread, on the sample frames.

    python -m benchmarks.service.stages --name after [--tree DIR] [--repeats 20]

Processor time, and its least value over the repeats, because it changes little with what else the machine does; the
latency of a service is measured by `physnet bench`. `--tree` times the `service` package and the models of another
checkout on the same frames. Results are written to `results/stages-NAME.json`; `benchmarks.service.report`
puts them into docs/performance.md.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
RESULTS = Path(__file__).resolve().parent / "results"

PUSHES: dict[str, tuple[tuple[float, float], tuple[float, float, float]]] = {
    "sugar_box": ((385.0, 125.0), (9.0, 0.0, 4.5)),
    "mug": ((365.0, 215.0), (0.0, 6.0, 24.0)),
    "bowl": ((260.0, 225.0), (20.0, 6.0, 0.0)),
}


def main() -> None:
    """Time the package in a process of its own, whose path names the tree first, and write what it prints."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--name", required=True, help="of the results file")
    parser.add_argument("--tree", type=Path, default=ROOT, help="checkout whose `service` is timed")
    parser.add_argument("--repeats", type=int, default=20)
    parser.add_argument("--here", action="store_true", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.here:
        print(json.dumps(timed(given.repeats)))
        return
    one_thread = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
    command = [sys.executable, str(Path(__file__).resolve()), "--here", "--name", given.name]
    found = subprocess.run(
        [*command, "--repeats", str(given.repeats)], env={**os.environ, **one_thread, "PYTHONPATH": str(given.tree)},
        cwd=given.tree, check=True, capture_output=True, text=True,
    )  # fmt: skip
    document = json.loads(found.stdout)
    RESULTS.mkdir(exist_ok=True)
    (RESULTS / f"stages-{given.name}.json").write_text(json.dumps(document, indent=1) + "\n", "utf-8")
    for frame, stages in document["frames"].items():
        print(f"{frame:12s}", "  ".join(f"{stage} {ms:.2f}" for stage, ms in stages.items()))


def timed(repeats: int) -> dict[str, Any]:
    """Least processor milliseconds of each stage, by frame."""
    import cv2

    import service.pipeline
    from service.api import convert, rpc_convert
    from service.api.generated import deformation_pb2 as pb
    from service.inference.registry import load_models

    replies: Any = convert  # where they are in the first versions
    with contextlib.suppress(ImportError):
        from service.api import replies
    cv2.setNumThreads(1)
    # The pipeline's own watch, reading the processor's clock: on one thread that is the stage's work.
    service.pipeline.time = SimpleNamespace(perf_counter=time.process_time)  # type: ignore[assignment]
    models = load_models(Path.cwd() / "models", threads=1)
    networks = {"reconstruct": models.reconstruction, "deform": models.deformation}
    inside: dict[str, float] = {}
    for stage, network in networks.items():
        for name in {"_session", "_encoder"} & set(vars(network)):
            session = getattr(network, name)
            setattr(network, name, SimpleNamespace(run=_clocked(session.run, inside, stage)))
    if hasattr(models.deformation, "prior"):
        prior = models.deformation.prior

        def whole(*asked: Any, **also: Any) -> Any:
            answer = prior(*asked, **also)
            if callable(answer.backward):  # else it is there already, as in older versions
                answer.backward()
            return answer

        models.deformation.prior = _clocked(whole, inside, "prior")  # type: ignore[method-assign]
    if hasattr(models.deformation, "prepare"):  # where the solve is set up
        models.deformation.prepare = _clocked(  # type: ignore[method-assign]
            models.deformation.prepare, inside, "prior"
        )

    def as_bytes(result: Any, outputs: Any) -> bytes:
        if not hasattr(rpc_convert, "fill_response"):  # older versions made the message, too
            return bytes(rpc_convert.deform_response(result, outputs, "x").SerializeToString())
        response = pb.DeformResponse()
        rpc_convert.fill_response(response, result, outputs, "x")
        return response.SerializeToString()

    pipeline = service.pipeline.Pipeline(models.reconstruction, models.deformation)
    frames: dict[str, dict[str, float]] = {}
    for frame, (contact_px, force_n) in PUSHES.items():
        folder = ROOT / "examples" / "frames" / frame
        body = {
            "camera": json.loads((folder / "intrinsics.json").read_text("utf-8")),
            "depth": {"encoding": "png16"},
            "material": {"name": "dragon_skin_10"},
            "loads": [{"contact_px": contact_px, "force_n": force_n}],
        }
        text, files = json.dumps(body).encode(), {"depth": (folder / "depth.png").read_bytes()}
        least: dict[str, float] = {}
        for _ in range(repeats + 2):
            inside.clear()
            began = time.process_time()
            request = convert.deform_request(convert.parse_body(text), 64, files)
            parsed = time.process_time()
            result = pipeline.predict(request)
            predicted = time.process_time()
            as_bytes(result, request.outputs)
            as_message = time.process_time()
            replies.reply_json(replies.reply_document(result, request.outputs, "x"), result.timing_ms)
            as_json = time.process_time()
            stages = {"parse": 1e3 * (parsed - began), **result.timing_ms}
            prior_ms = inside.pop("prior", 0.0)
            for stage, graph_ms in inside.items():
                stages[f"{stage}: network"] = graph_ms
                stages[f"{stage}: around it"] = stages.pop(stage) - graph_ms
            if prior_ms:
                stages["deform: prior"] = prior_ms
                stages["deform: around it"] -= prior_ms
            stages["encode gRPC"] = 1e3 * (as_message - predicted)
            stages["encode JSON"] = 1e3 * (as_json - as_message)
            for stage, ms in stages.items():
                least[stage] = min(ms, least.get(stage, ms))
        frames[frame] = least
    return {"frames": frames, "load_average": os.getloadavg(), "repeats": repeats}


def _clocked(work: Callable[..., Any], inside: dict[str, float], stage: str) -> Callable[..., Any]:
    """The same function, which adds up the processor time inside it."""

    def timed_work(*arguments: Any, **named: Any) -> Any:
        began = time.process_time()
        found = work(*arguments, **named)
        inside[stage] = inside.get(stage, 0.0) + 1e3 * (time.process_time() - began)
        return found

    return timed_work


if __name__ == "__main__":
    main()
