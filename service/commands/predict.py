"""`physnet predict`: one push on one depth image, answered here or by a service."""

from __future__ import annotations

import argparse
import json
import time
import uuid
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from service.commands import grammar
from service.commands.exits import EPILOG, FAILED, OK, REFUSED, UsageError
from service.commands.options import (
    FILE,
    MATERIAL,
    check_folder,
    complete_with,
    models_options,
    output_options,
    settings_of,
)
from service.commands.terminal import Terminal
from service.core.errors import DeadlineExceeded, ModelMismatch, Overloaded, PhysNetError

if TYPE_CHECKING:
    from service.client.question import Question
    from service.client.result import Result
    from service.settings import Settings


def add_predict(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Register the command."""
    parser = commands.add_parser(
        "predict", parents=[models_options(), output_options()], help="what one push does to an object", epilog=EPILOG,
        description="Answer one request, with the models of this machine or, with --server, by a running service. "
        "Vectors are in the camera's frame: x right, y down, z away from it.",
        usage="physnet predict DEPTH --intrinsics FX,FY,CX,CY|JSON --material NAME|E,NU\n"
        "                       --press U,V|X,Y,Z --force N|X,Y,Z [-o FILE] [options]",
    )  # fmt: skip
    complete_with(parser.add_argument("depth", type=Path, metavar="DEPTH", help="image: 16-bit PNG or .npy"), FILE)
    complete_with(
        parser.add_argument(
            "--intrinsics", required=True, metavar="FX,FY,CX,CY|JSON", help="numbers, or a file with fx fy cx cy"
        ),
        FILE,
    )
    parser.add_argument("--unit-m", type=float, metavar="M", help="metres per count")
    complete_with(
        parser.add_argument("--mask", type=Path, metavar="PNG", help="pixels of the object; found if absent"), FILE
    )
    parser.add_argument("--up", metavar="X,Y,Z", help="against gravity; found if absent")
    complete_with(
        parser.add_argument(
            "--material", required=True, metavar="NAME|E,NU", help="a name (`physnet materials`), `Shore A 30`, or Pa,ν"
        ),
        MATERIAL,
    )
    parser.add_argument("--press", required=True, metavar="U,V|X,Y,Z", help="contact: a pixel, or metres")
    parser.add_argument("--force", required=True, metavar="N|X,Y,Z", help="newtons along --direction, or a vector")
    parser.add_argument("--direction", metavar="X,Y,Z", help="of the force, any length; away from the camera if absent")
    parser.add_argument("--patch-radius-m", type=float, metavar="M", help="radius of the patch that is pressed")
    complete_with(
        parser.add_argument(
            "-o", "--output", type=Path, action="append", default=[], metavar="FILE",
            help="write the answer, as its suffix says: .npz .ply .glb .bt .binvox; may be given again",
        ),
        FILE,
    )  # fmt: skip
    complete_with(
        parser.add_argument("--picture", type=Path, metavar="PNG", help="draw the answer (needs physnet[pictures])"),
        FILE,
    )
    parser.add_argument("--server", metavar="URL", help="ask this service: http://127.0.0.1:8000 or grpc://127.0.0.1:8001")
    parser.set_defaults(run=_run)


def _run(given: argparse.Namespace) -> int:
    from service.api.problem import ValidationFailed
    from service.client.formats.files import SUFFIXES

    terminal = Terminal(given.color)
    for path in given.output:
        if path.suffix.lower() not in SUFFIXES:
            raise UsageError(f"--output: {path} must end in one of {' '.join(SUFFIXES)}")
        check_folder("--output", path)
    if given.picture:
        check_folder("--picture", given.picture)
    settings = settings_of(given)
    try:
        question = grammar.question_of(given)
        began = time.perf_counter()
        if given.server:
            with terminal.working(f"asking {given.server}"):
                result = _ask_service(given.server, question, settings)
        else:
            with terminal.working("opening the models and predicting"):
                result = _ask_here(question, settings)
        elapsed_ms = 1e3 * (time.perf_counter() - began)
    except ModelMismatch:
        raise
    except (PhysNetError, ValidationFailed) as error:
        return _tell_refusal(error, given.json, terminal)
    written = [result.save(path) for path in given.output]
    if given.picture:
        given.picture.write_bytes(_picture(question, result))
        written.append(given.picture)
    _report(result, written, elapsed_ms, given.json, terminal)
    return OK


def _ask_service(url: str, question: Question, settings: Settings) -> Result:
    from service.client import PhysNetClient

    token = settings.token.get_secret_value() if settings.token else None
    try:
        client = PhysNetClient(url, token=token)
    except ModuleNotFoundError as missing:
        reason = f"needs {missing.name}: pip install 'physnet[client]', or ask over gRPC (grpc://HOST:8001)"
        raise UsageError(f"--server: {url} {reason}") from None
    except ValueError as error:
        raise UsageError(f"--server: {error}") from None
    with client:
        return client.ask(question)


def _ask_here(question: Question, settings: Settings) -> Result:
    """The answer of the embedded predictor: the question as a robot would post it, and the reply that it would get."""
    from service.app import build_pipeline
    from service.replay.embedded import answer

    return answer(build_pipeline(settings).predictor, question, settings.max_loads)


def _tell_refusal(error: Exception, as_json: bool, terminal: Terminal) -> int:
    from service.api.problem import problem_document
    from service.client.errors import ServiceUnreachable, UnexpectedReply

    problem = problem_document(error, uuid.uuid4().hex)
    if isinstance(error, PhysNetError):
        # A service's own code and words, also where they are newer than ours.
        problem |= {"code": error.code, "detail": error.message}
    if as_json:
        terminal.print(json.dumps(problem))
    else:
        where = f" [{problem['field']}]" if "field" in problem else ""
        terminal.complain(f"{problem['code']}{where}: {problem['detail']}")
    failed = isinstance(error, Overloaded | DeadlineExceeded | ServiceUnreachable | UnexpectedReply)
    return FAILED if failed else REFUSED


def _picture(question: Question, result: Result) -> bytes:
    from service.client.question import Image
    from service.core.camera import make_intrinsics, pixel_to_point
    from service.core.depth import decode_depth
    from service.picture import deformation_picture

    assert isinstance(question.source, Image)
    assert question.camera is not None
    asked = question.camera
    camera = make_intrinsics(
        asked.fx, asked.fy, asked.cx, asked.cy, asked.width, asked.height, list(asked.distortion) or None
    )
    image, push = question.source, question.pushes[0]
    depth_m = decode_depth(image.encoding, image.data, image.unit_m, camera.width, camera.height)
    if push.contact_m is not None:
        contact_m = np.array(push.contact_m, np.float64)
    else:
        assert push.contact_px is not None
        contact_m = pixel_to_point(push.contact_px[0], push.contact_px[1], depth_m, camera)
    force_n = np.array(push.force_n, np.float64)
    material = question.material if isinstance(question.material, str) else f"E = {question.material[0]:.3g} Pa"
    answer = result[0]
    force, moved_mm = float(np.linalg.norm(force_n)), 1e3 * answer.max_displacement_m
    displacement_m = None if answer.displacement_m is None else answer.displacement_m.astype(np.float32)
    return deformation_picture(
        depth_m=depth_m,
        observed=result.seen,
        reconstruction=result.reconstruction,
        deformed=answer.deformed,
        displacement_m=displacement_m,
        grid=result.grid,
        intrinsics=(camera.fx, camera.fy, camera.cx, camera.cy),
        contact_m=contact_m,
        force_n=force_n,
        caption=f"{force:.3g} N on {material}: moves {moved_mm:.1f} mm at most",
    )


def _report(result: Result, written: list[Path], elapsed_ms: float, as_json: bool, terminal: Terminal) -> None:
    answer = result[0]
    flags = sorted(result.flags | answer.flags)
    if as_json:
        document: dict[str, Any] = {
            "request_id": result.request_id,
            "model": {"name": result.model[0], "version": result.model[1]},
            "voxel_size_m": result.grid.pitch_m,
            "camera_from_grid": result.grid.camera_from_grid.tolist(),
            "max_displacement_m": answer.max_displacement_m,
            "mean_displacement_m": answer.mean_displacement_m,
            "load_number": answer.load_number,
            "flags": flags,
            "timing_ms": result.timing_ms,
            "files": [str(path) for path in written],
        }
        terminal.print(json.dumps(document))
        return
    largest = terminal.paint(f"{1e3 * answer.max_displacement_m:.2f} mm", "bold")
    terminal.print(f"largest displacement  {largest}")
    terminal.print(f"mean displacement     {1e3 * answer.mean_displacement_m:.2f} mm")
    terminal.print(f"load number           {answer.load_number:.3g}")
    terminal.print(f"voxel                 {1e3 * result.grid.pitch_m:.2f} mm")
    terminal.print(f"flags                 {terminal.paint(', '.join(flags), 'yellow') if flags else 'none'}")
    predicted_ms = result.timing_ms.get("total", elapsed_ms)
    terminal.print(f"time                  {predicted_ms:.1f} ms ({elapsed_ms / 1e3:.1f} s with start and transfer)")
    for path in written:
        terminal.print(f"written               {path}")
