"""The book that a stream keeps of its frames: which one waits, which are under way, what became of the others.

No thread and no event loop here; the streams of both kinds keep theirs in it.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from service.client.question import Question
from service.client.result import Result
from service.core.errors import PhysNetError

MAX_IN_FLIGHT = 8
"""Frames sent and not yet answered. A service answers an overtaken frame at once, so on a good link there are two or
three; on a bad one the newest waits here, where a still newer one can take its place, and not in a socket's buffer."""

BACKLOG = 64
"""Answers not yet read, beyond which the oldest are dropped: who reads them late wants the newest."""


@dataclass(frozen=True)
class Answer:
    """What became of one frame: exactly one of `result`, `error` and `overtaken_by`.

    Results come in the order of their frames; that a frame was overtaken is told as soon as it is known, of one on this
    side at once and of one in the service a way back later, so that a later frame's notice may come first.

    Attributes:
        frame_id: The frame's.
        result: The answer.
        error: What was wrong with it, or that the connection broke.
        overtaken_by: The frame that took its place before inference, on this side of the wire or in the service: a
            later one, and not always the next, which may itself have been overtaken on the way to where this one was.
        round_trip_ms: Since the frame was handed to the stream.
        age_ms: In the service: the frame's age at the end of each stage, where the wire tells.
    """

    frame_id: int
    result: Result | None = None
    error: PhysNetError | None = None
    overtaken_by: int | None = None
    round_trip_ms: float = 0.0
    age_ms: Mapping[str, float] = field(default_factory=dict)

    def unwrap(self) -> Result:
        """The result.

        Raises:
            PhysNetError: What was wrong with the frame.
            ValueError: It was overtaken.
        """
        if self.error is not None:
            raise self.error
        if self.result is None:
            raise ValueError(f"frame {self.frame_id} was overtaken by frame {self.overtaken_by}")
        return self.result


@dataclass(frozen=True)
class Frame:
    """A question with its number and the time it was handed over (`time.perf_counter()`)."""

    frame_id: int
    question: Question
    since: float


@dataclass
class Counts:
    """What became of the frames of a stream so far; `dropped` are answers that nobody read in time."""

    sent: int = 0
    answered: int = 0
    skipped: int = 0
    failed: int = 0
    dropped: int = 0


class FrameBook:
    """Args:
    max_in_flight: Most frames under way.
    backlog: Most answers kept for the reader.
    with_skipped: Whether overtaken frames are answers too; they are counted in any case.
    """

    def __init__(self, max_in_flight: int, backlog: int, with_skipped: bool) -> None:
        self._max_in_flight = max_in_flight
        self._backlog = backlog
        self._with_skipped = with_skipped
        self._last_id = -1
        self._waiting: Frame | None = None
        self._under_way: dict[int, Frame] = {}
        self.answers: deque[Answer] = deque()
        self.counts = Counts()

    def add(self, question: Question, frame_id: int | None) -> Frame:
        """A new frame takes the place of the one that waits.

        Raises:
            ValueError: Its id is not greater than that of the one before.
        """
        number = self._last_id + 1 if frame_id is None else frame_id
        if number <= self._last_id:
            raise ValueError(f"frames are numbered upwards: {number} comes after {self._last_id}")
        self._last_id = number
        frame = Frame(number, question, time.perf_counter())
        self.counts.sent += 1
        overtaken, self._waiting = self._waiting, frame
        if overtaken is not None:
            self._settle(overtaken, Answer(overtaken.frame_id, overtaken_by=number))
        return frame

    def next(self) -> Frame | None:
        """The newest frame, now under way; None where none waits or too many are."""
        if self._waiting is None or len(self._under_way) >= self._max_in_flight:
            return None
        frame, self._waiting = self._waiting, None
        self._under_way[frame.frame_id] = frame
        return frame

    def done(self, answer: Answer) -> None:
        """What became of a frame that was under way."""
        frame = self._under_way.pop(answer.frame_id, None)
        if frame is not None:
            self._settle(frame, answer)

    def lose(self, error: PhysNetError, *, waiting_too: bool = False) -> None:
        """The connection broke: what was under way is not coming back."""
        lost = [*self._under_way.values()]
        self._under_way.clear()
        if waiting_too and self._waiting is not None:
            lost.append(self._waiting)
            self._waiting = None
        for frame in lost:
            self._settle(frame, Answer(frame.frame_id, error=error))

    @property
    def idle(self) -> bool:
        """Whether nothing waits and nothing is under way."""
        return self._waiting is None and not self._under_way

    @property
    def waits(self) -> bool:
        """Whether a frame waits."""
        return self._waiting is not None

    def _settle(self, frame: Frame, answer: Answer) -> None:
        answer = replace(answer, round_trip_ms=1e3 * (time.perf_counter() - frame.since))
        if answer.overtaken_by is not None:
            self.counts.skipped += 1
            if not self._with_skipped:
                return
        elif answer.error is not None:
            self.counts.failed += 1
        else:
            self.counts.answered += 1
        self.answers.append(answer)
        if len(self.answers) > self._backlog:
            self.answers.popleft()
            self.counts.dropped += 1
