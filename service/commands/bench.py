"""`physnet bench`: how fast a service answers, and what it does when asked for more than it can."""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from service.commands.exits import EPILOG, FAILED, OK, UsageError
from service.commands.options import FILE, complete_with, models_options, settings_of
from service.commands.terminal import Terminal, bar

if TYPE_CHECKING:
    from service.bench.process import RunningService
    from service.bench.question import BenchQuestion
    from service.settings import Settings

_TARGETS = ("grpc-stream", "grpc", "http-multipart", "http-json")
GRAPH_REPEATS = 40
GRAPH_TURN = 8
"""Questions in a row before it is the networks' turn."""

LOOK_S = 0.5
"""Between two looks at how far a run is."""


def add_bench(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Register the command."""
    parser = commands.add_parser(
        "bench", parents=[models_options()], help="measure a service under load", epilog=EPILOG,
        description="Send the same frame at a steady rate, each question when it is due and whatever became of those "
        "before, and count every latency from then: a service that stalls is not asked more gently (no coordinated "
        "omission). Starts a service of its own unless --server names one. Ends with 1 if any question failed.",
    )  # fmt: skip
    parser.add_argument("--target", choices=_TARGETS, default="grpc-stream", help="the wire (default: %(default)s)")
    parser.add_argument("--rate", type=float, default=30.0, metavar="HZ", help="of each client (default: %(default)s)")
    parser.add_argument("--duration", type=float, default=10.0, metavar="S", help="seconds (default: %(default)s)")
    parser.add_argument("--clients", type=int, default=1, metavar="N", help="connections (default: %(default)s)")
    parser.add_argument("--loads", type=int, default=1, metavar="N", help="what-if loads a question (default: 1)")
    complete_with(parser.add_argument("--depth", type=Path, metavar="FILE", help=".png or .npy; else a sample"), FILE)
    complete_with(parser.add_argument("--intrinsics", type=Path, metavar="JSON", help="of --depth"), FILE)
    parser.add_argument("--press", metavar="U,V", help="pixel of --depth that is pushed; the middle if absent")
    parser.add_argument("--server", metavar="HOST:PORT", help="a service that runs: the port of the wire asked")
    parser.add_argument(
        "--against-graphs", action="store_true",
        help="also: the median of one question alone against the bare sum of its networks, in turns",
    )  # fmt: skip
    complete_with(parser.add_argument("--json", type=Path, metavar="FILE", help="write all that was measured"), FILE)
    complete_with(parser.add_argument("--svg", type=Path, metavar="FILE", help="draw latency by percentile"), FILE)
    parser.set_defaults(run=_run)


def _run(given: argparse.Namespace) -> int:
    from service.bench import report
    from service.bench.open_loop import Measured, open_loop, questions_each
    from service.bench.picture import picture
    from service.bench.process import ServiceFailed
    from service.bench.targets import make_target

    for name in ("rate", "duration"):
        if not (math.isfinite(getattr(given, name)) and getattr(given, name) > 0.0):
            raise UsageError(f"--{name}: must be a positive number")
    for name in ("clients", "loads"):
        if getattr(given, name) < 1:
            raise UsageError(f"--{name}: must be 1 or more")
    if given.against_graphs and given.server:
        raise UsageError("--server: not with --against-graphs, which needs a service with the same models and threads")
    settings = settings_of(given)
    question = _question(given)
    document: dict[str, Any] = {"command": _asked(given), "machine": report.machine()}
    terminal, measured = Terminal(), Measured()
    asked = given.clients * questions_each(given.rate, given.duration)

    def tell() -> str:
        return bar(len(measured.points) / asked) + report.line(measured, asked)

    try:
        with contextlib.ExitStack() as stack:
            with terminal.working("starting a service"):
                service = stack.enter_context(_service(given, settings))
            targets = [make_target(given.target, service.http, service.grpc, question) for _ in range(given.clients)]
            # By another thread and seldom: what is measured here must not wait for what is shown.
            with terminal.watching(tell, LOOK_S):
                asyncio.run(open_loop(targets, given.rate, given.duration, measured))
            document |= report.run_document(measured, service if service.process_id else None)
            if given.against_graphs:
                with terminal.working("asking one after the other, and the networks alone"):
                    document["graphs"] = against_graphs(given.target, service, settings, question)
    except ServiceFailed as error:
        raise OSError(str(error)) from None
    print("\n".join(report.table(document)))
    if given.json:
        given.json.write_text(json.dumps(report.jsonable(document), indent=1) + "\n", "utf-8")
    if given.svg:
        title = f"{given.target}, {given.clients} × {given.rate:g}/s, {given.loads} load(s)"
        given.svg.write_text(picture(measured, title), "utf-8")
    return FAILED if document["failed"] or not document["answered"] else OK


def against_graphs(
    target: str, service: RunningService, settings: Settings, question: BenchQuestion, repeats: int = GRAPH_REPEATS
) -> dict[str, Any]:
    """Median of one question after the other against the bare networks with the same inputs, in turns of a few each.

    Turns, so that whatever else the machine does slows both alike.
    """
    import numpy as np

    from service.bench.graphs import BareGraphs
    from service.bench.open_loop import closed_loop
    from service.bench.targets import make_target

    bare = BareGraphs(settings, question)
    graphs: dict[str, list[float]] = {name: [] for name in bare.names}
    answers: list[float] = []
    for _ in range(-(-repeats // GRAPH_TURN)):
        client = make_target(target, service.http, service.grpc, question)
        alone = asyncio.run(closed_loop(client, GRAPH_TURN))
        answers += [ms for _, ms, outcome in alone.points if outcome == "ok"]
        for _ in range(GRAPH_TURN):
            for name, times in graphs.items():
                times.append(bare.time_ms(name))
    medians = {name: float(np.median(times)) for name, times in graphs.items()}
    bare_ms, service_ms = sum(medians.values()), float(np.median(answers)) if answers else math.nan
    return {"medians_ms": medians, "sum_ms": bare_ms, "service_p50_ms": service_ms, "ratio": service_ms / bare_ms}


@contextlib.contextmanager
def _service(given: argparse.Namespace, settings: Settings) -> Iterator[RunningService]:
    from service.bench.process import RunningService, running_service

    if given.server:
        yield RunningService(http=given.server, grpc=given.server)
        return
    options = ("--models", str(settings.models), "--threads", str(settings.threads), "--log-level", "warning")
    with running_service(*options) as service:
        yield service


def _question(given: argparse.Namespace) -> BenchQuestion:
    from service.bench.question import BenchQuestion, read_camera, sample_question

    if given.depth is None:
        if given.intrinsics or given.press:
            raise UsageError("--intrinsics and --press: belong to --depth")
        return sample_question(given.loads)
    if given.intrinsics is None:
        raise UsageError("--intrinsics: needed with --depth")
    try:
        camera = read_camera(given.intrinsics)
    except ValueError as error:
        raise UsageError(f"--intrinsics: {error}") from None
    encoding = "npy" if given.depth.suffix == ".npy" else "png16"
    contact = (camera["width"] / 2, camera["height"] / 2)
    if given.press:
        try:
            u, v = (float(part) for part in given.press.split(","))
        except ValueError:
            raise UsageError(f"--press: {given.press!r} is not U,V") from None
        contact = (u, v)
    return BenchQuestion(given.depth.read_bytes(), encoding, camera, contact, (0.0, 0.0, 5.0), given.loads)


def _asked(given: argparse.Namespace) -> dict[str, Any]:
    return {
        name: getattr(given, name) if not isinstance(getattr(given, name), Path) else str(getattr(given, name))
        for name in ("target", "rate", "duration", "clients", "loads", "depth", "server", "threads", "models")
    }
