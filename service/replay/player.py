"""Plays a recording at its own pace and gathers what comes of it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np

from service.client.frames import Answer
from service.client.question import Question
from service.client.stream import FrameStream
from service.core.errors import PhysNetError
from service.replay.frames import RecordedFrame


@dataclass(frozen=True)
class Played:
    """A frame, what was asked about it, and what became of it."""

    frame: RecordedFrame
    question: Question
    answer: Answer


@dataclass
class Summary:
    """Of a recording that was played.

    Attributes:
        sent, answered, skipped, failed: Frames, and what became of them.
        recorded_s, played_s: How long the recording is, and how long it took.
        round_trip_ms: Of each answered frame.
        problems: How often each code was answered, with the words of the first.
    """

    sent: int = 0
    answered: int = 0
    skipped: int = 0
    failed: int = 0
    recorded_s: float = 0.0
    played_s: float = 0.0
    round_trip_ms: list[float] = field(default_factory=list)
    problems: dict[str, tuple[int, str]] = field(default_factory=dict)

    def percentile_ms(self, percent: float) -> float:
        """Of the round trips; NaN where nothing was answered."""
        return float(np.percentile(self.round_trip_ms, percent)) if self.round_trip_ms else float("nan")

    def count(self, answer: Answer) -> None:
        """Take in what became of a frame."""
        if answer.overtaken_by is not None:
            self.skipped += 1
        elif answer.error is not None:
            self.failed += 1
            times, words = self.problems.get(answer.error.code, (0, answer.error.message))
            self.problems[answer.error.code] = (times + 1, words)
        else:
            self.answered += 1
            self.round_trip_ms.append(answer.round_trip_ms)


def paced(
    frames: Iterable[RecordedFrame], rate: float, sleep: Callable[[float], object] = time.sleep,
    clock: Callable[[], float] = time.monotonic,
) -> Iterator[RecordedFrame]:
    """Frames when they are due.

    A frame that is late is not waited for, and the next ones come when they would have come: a slow reader makes the
    recording no longer than it is.

    Args:
        frames: In the order of time.
        rate: 2 is twice as fast as recorded; infinity waits for nothing.
        sleep: Waits.
        clock: Seconds that only rise.
    """
    first_ns: int | None = None
    began = clock()
    for frame in frames:
        first_ns = frame.time_ns if first_ns is None else first_ns
        due_s = began + 1e-9 * (frame.time_ns - first_ns) / rate
        if (wait_s := due_s - clock()) > 0.0:
            sleep(wait_s)
        yield frame


def play(
    frames: Iterable[RecordedFrame],
    ask: Callable[[RecordedFrame], Question],
    stream: FrameStream,
    take: Callable[[Played], object],
    progress: Callable[[Summary], object] = lambda _: None,
    every: bool = False,
) -> Summary:
    """Send frames as they come and hand each answer on; returns when the last is there.

    Args:
        frames: As they are to be sent (`paced`).
        ask: What is asked about a frame.
        stream: With overtaken frames as answers, and a backlog of all frames. It is closed at the end.
        take: Called with every frame that was answered, refused or overtaken, in this thread.
        progress: Called after each frame and each answer.
        every: Send a frame only when the one before is answered, so that none is overtaken.

    Raises:
        PhysNetError: The stream broke for good.
    """
    summary = Summary()
    asked: dict[int, tuple[RecordedFrame, Question]] = {}
    settled = threading.Semaphore(0)
    broken: list[Exception] = []

    def send() -> None:
        first_ns: int | None = None
        try:
            for frame in frames:
                question = ask(frame)
                first_ns = frame.time_ns if first_ns is None else first_ns
                number = summary.sent
                asked[number] = (frame, question)
                stream.ask(question, number)
                summary.sent += 1
                summary.recorded_s = 1e-9 * (frame.time_ns - first_ns)
                if every:
                    settled.acquire()
        except Exception as error:
            broken.append(error)
        finally:
            stream.close(timeout_s=0.0)

    began = time.monotonic()
    sending = threading.Thread(target=send, name="physnet-replay", daemon=True)
    sending.start()
    try:
        for answer in stream:
            frame, question = asked.pop(answer.frame_id)
            summary.count(answer)
            settled.release()
            take(Played(frame, question, answer))
            summary.played_s = time.monotonic() - began
            progress(summary)
    except BaseException:
        stream.close(drain=False)
        raise
    sending.join()
    summary.played_s = time.monotonic() - began
    if broken and not (isinstance(broken[0], PhysNetError) and summary.failed):
        raise broken[0]
    return summary
