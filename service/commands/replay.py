"""`physnet replay`: a recording of depth frames played to a service, or to the models of this machine."""

from __future__ import annotations

import argparse
import json
import math
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

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
from service.commands.terminal import Terminal, bar

if TYPE_CHECKING:
    from service.client.question import Question
    from service.client.stream import FrameStream
    from service.replay.frames import RecordedFrame
    from service.replay.player import Played, Summary

_KEEP_ALL = sys.maxsize


def add_replay(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Register the command."""
    parser = commands.add_parser(
        "replay", parents=[models_options(), output_options()], help="play a recording (needs physnet[replay])",
        epilog=EPILOG, description="Send the depth frames of a ROS 1 bag, ROS 2 bag or MCAP file at their own pace to "
        "the models of this machine or, with --server, to a service, and write what came back as a recording that "
        "Foxglove or Rerun opens. The same push is asked of every frame.",
        usage="physnet replay BAG --material NAME|E,NU --press U,V|X,Y,Z --force N|X,Y,Z\n"
        "                      [--server URL] [-o MCAP] [options]",
    )  # fmt: skip
    complete_with(parser.add_argument("recording", type=Path, metavar="BAG", help=".bag, .mcap, or a ROS 2 bag"), FILE)
    parser.add_argument("--material", required=True, metavar="NAME|E,NU", help="a name, `Shore A 30`, or Pa,ν")
    parser.add_argument("--press", required=True, metavar="U,V|X,Y,Z", help="contact: a pixel, or metres (camera)")
    parser.add_argument("--force", required=True, metavar="N|X,Y,Z", help="newtons along --direction, or a vector")
    parser.add_argument("--direction", metavar="X,Y,Z", help="of the force, any length; away from the camera if absent")
    parser.add_argument("--patch-radius-m", type=float, metavar="M", help="radius of the patch that is pressed")
    parser.add_argument("--depth", metavar="TOPIC", help="depth images; the only ones if absent")
    parser.add_argument("--info", metavar="TOPIC", help="their CameraInfo; the one beside them if absent")
    parser.add_argument(
        "--up-frame", metavar="FRAME", help="frame whose z axis points up, such as base_link, by the recording's TF"
    )
    parser.add_argument(
        "--rate", type=float, default=1.0, metavar="X", help="pace: 2 is twice as fast; 0 waits for every answer"
    )
    parser.add_argument("--limit", type=int, metavar="N", help="play the first N frames only")
    parser.add_argument("--server", metavar="URL", help="ask this service: grpc://HOST:PORT (streams) or http://…")
    complete_with(parser.add_argument("-o", "--output", type=Path, metavar="MCAP", help="for Foxglove"), FILE)
    complete_with(parser.add_argument("--rerun", type=Path, metavar="RRD", help="for Rerun (physnet[rerun])"), FILE)
    parser.set_defaults(run=_run)
    material = next(action for action in parser._actions if action.dest == "material")
    complete_with(material, MATERIAL)


def _run(given: argparse.Namespace) -> int:
    # Of the `replay` extra; its absence is said by one of these imports, in one line.
    try:
        from service.replay.frames import find_topics, recorded_frames
        from service.replay.player import paced, play
        from service.replay.progress import document, line, report
        from service.replay.recording import RecordingError, open_recording
    except ModuleNotFoundError as missing:
        raise ModuleNotFoundError(f"{missing.name} is missing: pip install 'physnet[replay]'") from missing
    if not (math.isfinite(given.rate) and given.rate >= 0.0):
        raise UsageError("--rate: must be a number, 0 or more")
    for option, path in (("--output", given.output), ("--rerun", given.rerun)):
        if path:
            check_folder(option, path)
    terminal = Terminal(given.color)
    try:
        with ExitStack() as stack:
            recording = stack.enter_context(open_recording(given.recording))
            topics = find_topics(recording, given.depth, given.info)
            frames = recorded_frames(recording, topics, given.up_frame)
            if given.limit is not None:
                frames = _first(frames, given.limit)
            stream = stack.enter_context(_stream(given, stack, terminal))
            writers = _writers(given, stack)
            progress = terminal.progress()
            stack.callback(progress.end)
            # Of the first N frames nobody knows how long they take.
            duration_s = recording.duration_s if given.limit is None else 0.0

            def tell(summary: Summary) -> None:
                share = bar(summary.recorded_s / duration_s) if duration_s > 0.0 else ""
                progress.show(lambda: share + line(summary))

            every = given.rate == 0.0
            summary = play(
                frames if every else paced(frames, given.rate), lambda frame: _question(given, frame), stream,
                lambda played: _write(played, writers), tell, every,
            )  # fmt: skip
    except RecordingError as error:
        raise UsageError(str(error)) from None
    if summary.sent == 0:
        raise UsageError(f"{given.recording}: no frames on {topics.depth}")
    terminal.print(json.dumps(document(summary)) if given.json else report(summary))
    if summary.answered:
        return OK
    return REFUSED if set(summary.problems) - {"unreachable", "overloaded", "deadline_exceeded"} else FAILED


def _first(frames: Any, limit: int) -> Any:
    from itertools import islice

    return islice(frames, limit)


def _stream(given: argparse.Namespace, stack: ExitStack, terminal: Terminal) -> FrameStream:
    """Of a service, or of the models of this machine."""
    settings = settings_of(given)
    if given.server:
        from service.client import PhysNetClient

        token = settings.token.get_secret_value() if settings.token else None
        try:
            client = stack.enter_context(PhysNetClient(given.server, token=token))
        except ValueError as error:
            raise UsageError(f"--server: {error}") from None
        # One that is not there is told at once, and not frame by frame.
        client.models()
        return client.stream(backlog=_KEEP_ALL, with_skipped=True)
    from service.replay.embedded import EmbeddedClient

    with terminal.working("opening the models"):
        return EmbeddedClient(settings).stream(backlog=_KEEP_ALL, with_skipped=True)


def _writers(given: argparse.Namespace, stack: ExitStack) -> list[Any]:
    writers: list[Any] = []
    if given.output:
        from service.replay.foxglove import FoxgloveWriter

        writers.append(stack.enter_context(FoxgloveWriter(given.output)))
    if given.rerun:
        from service.replay.rerun_log import RerunWriter

        writers.append(stack.enter_context(RerunWriter(given.rerun)))
    return writers


def _question(given: argparse.Namespace, frame: RecordedFrame) -> Question:
    from service.client.question import question

    push = grammar.push_of(given, frame.camera)
    return question(frame.depth, frame.camera, push, grammar.material_of(given.material), up=frame.up)


def _write(played: Played, writers: list[Any]) -> None:
    result = played.answer.result
    if result is None or not writers:
        return
    from service.replay.force import force_of

    force = force_of(played.question.pushes[0], played.frame.depth, played.frame.camera)
    for writer in writers:
        writer.write(played.frame, result, played.answer.round_trip_ms, force)
