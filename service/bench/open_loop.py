"""Questions sent when they are due, whatever became of those before: a slow service is not asked more gently."""

from __future__ import annotations

import asyncio
import threading
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from service.bench.histogram import Histogram
from service.bench.targets import OK, Reply, Target

WARM_UP = 5
"""Questions asked one after the other before anything is measured, on each connection."""

LAST_REPLIES_S = 30.0
"""How long after the last question its reply is waited for."""


@dataclass
class Measured:
    """What became of every question of one run.

    Attributes:
        latency: Of those answered, from when they were due until the whole reply was there.
        outcomes: How many ended in which way.
        lag: How much later than due questions left the generator, which is part of their latency.
        stages_ms: The service's own timings of each answer.
        points: (seconds into the run, latency ms, outcome) of every question.
        elapsed_s: From the first due time to the last reply.
        clients: Connections.
        per_client: Answers that each of them had.
    """

    latency: Histogram = field(default_factory=Histogram)
    outcomes: Counter[str] = field(default_factory=Counter)
    lag: Histogram = field(default_factory=Histogram)
    stages_ms: dict[str, list[float]] = field(default_factory=dict)
    points: list[tuple[float, float, str]] = field(default_factory=list)
    elapsed_s: float = 0.0
    clients: int = 1
    per_client: Counter[int] = field(default_factory=Counter)

    def count(self, client: int, due: float, began: float, sent: float, reply: Reply) -> None:
        """Take one reply in; times are of `time.perf_counter()`."""
        latency_ms = 1e3 * (reply.finished - due)
        self.outcomes[reply.outcome] += 1
        self.lag.record(1e3 * (sent - due))
        self.points.append((due - began, latency_ms, reply.outcome))
        self.elapsed_s = max(self.elapsed_s, reply.finished - began)
        if reply.outcome == OK:
            self.latency.record(latency_ms)
            self.per_client[client] += 1
            for stage, elapsed_ms in reply.timing_ms.items():
                self.stages_ms.setdefault(stage, []).append(elapsed_ms)

    def stage_medians_ms(self) -> dict[str, float]:
        """Median of each stage."""
        return {stage: float(np.median(times)) for stage, times in self.stages_ms.items()}


def questions_each(rate_hz: float, duration_s: float) -> int:
    """Questions that each client asks."""
    return max(1, round(duration_s * rate_hz))


async def open_loop(
    targets: Sequence[Target], rate_hz: float, duration_s: float, measured: Measured | None = None
) -> Measured:
    """Ask `rate_hz` questions a second of each target for a time.

    Args:
        targets: Clients; their questions are due at even distances from each other's.
        rate_hz: Of each client, positive.
        duration_s: How long, positive.
        measured: Takes everything in as it comes, for another thread to look at.
    """
    for target in targets:
        await target.open()
        for _ in range(WARM_UP):
            await target.ask()
    measured = Measured() if measured is None else measured
    measured.clients = len(targets)
    loop = asyncio.get_running_loop()
    due_now: asyncio.Queue[tuple[int, float] | None] = asyncio.Queue()
    began = time.perf_counter() + 0.1
    due = sorted(
        (began + (index + client / len(targets)) / rate_hz, client)
        for client in range(len(targets))
        for index in range(questions_each(rate_hz, duration_s))
    )

    def pace() -> None:
        # A thread, because an event loop's timers are late by up to a millisecond.
        for when, client in due:
            time.sleep(max(0.0, when - time.perf_counter()))
            loop.call_soon_threadsafe(due_now.put_nowait, (client, when))
        loop.call_soon_threadsafe(due_now.put_nowait, None)

    async def ask(client: int, when: float) -> None:
        sent = time.perf_counter()
        try:
            reply = await targets[client].ask()
        except Exception as error:  # every question is counted, whatever a library makes of it
            reply = Reply(type(error).__name__, time.perf_counter())
        measured.count(client, when, began, sent, reply)

    threading.Thread(target=pace, name="pace", daemon=True).start()
    asking: set[asyncio.Task[None]] = set()
    while (item := await due_now.get()) is not None:
        task = asyncio.create_task(ask(*item))
        asking.add(task)
        task.add_done_callback(asking.discard)
    if asking:
        _, late = await asyncio.wait(asking, timeout=LAST_REPLIES_S)
        for task in late:
            task.cancel()
            measured.outcomes["no_reply"] += 1
    for target in targets:
        await target.close()
    return measured


async def closed_loop(target: Target, questions: int) -> Measured:
    """Ask one question after the other: how long an answer takes where nobody else asks."""
    await target.open()
    for _ in range(WARM_UP):
        await target.ask()
    measured = Measured()
    began = time.perf_counter()
    for _ in range(questions):
        due = time.perf_counter()
        measured.count(0, due, began, due, await target.ask())
    await target.close()
    return measured
