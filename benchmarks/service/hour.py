"""What an hour's load does to the service's memory: as many answers as a stream of 30 frames a second has in it.

    python -m benchmarks.service.hour [--answers 108000]

Two clients, one on a stream and one that posts forms, each ask again as soon as they are answered, so that the hour
takes as long as two cores need for it. Whatever is kept for later questions is full long before the end. Written:
resident memory once a minute, after the first answers and at the end, and the most there ever was.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import time
from collections import Counter
from pathlib import Path
from typing import Any

from service.bench.process import RunningService, running_service
from service.bench.question import sample_question
from service.bench.report import machine
from service.bench.targets import OK, Target, make_target

FRAMES = 30 * 3600
WARM_UP = 2000
"""Answers after which everything that is kept is there."""

RESULTS = Path(__file__).resolve().parent / "results"


async def _ask(target: Target, outcomes: Counter[str], answers: int) -> None:
    await target.open()
    while outcomes.total() < answers:
        outcomes[(await target.ask()).outcome] += 1
    await target.close()


async def _load(service: RunningService, outcomes: Counter[str], answers: int) -> None:
    question = sample_question()
    targets = [make_target(name, service.http, service.grpc, question) for name in ("grpc-stream", "http-multipart")]
    await asyncio.gather(*(_ask(target, outcomes, answers) for target in targets))


def measure(answers: int) -> dict[str, Any]:
    """The document that is written."""
    outcomes: Counter[str] = Counter()
    with running_service("--log-level", "warning") as service:
        asyncio.run(_load(service, outcomes, min(WARM_UP, answers)))
        warm_mib, began = service.resident_mib(), time.perf_counter()
        asyncio.run(_load(service, outcomes, answers))
        elapsed_s, last_mib, peak_mib = time.perf_counter() - began, service.resident_mib(), service.peak_mib()
        memory = [(round(seconds), round(mib, 1)) for seconds, mib in service.memory[::60]]
    return {
        "machine": machine(), "answers": outcomes.total(), "failed": outcomes.total() - outcomes[OK],
        "elapsed_s": round(elapsed_s, 1), "warm_mib": round(warm_mib, 1), "last_mib": round(last_mib, 1),
        "peak_mib": round(peak_mib, 1), "resident_mib": memory,
    }  # fmt: skip


def main() -> None:
    """Measure, print, write `results/hour.json`."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--answers", type=int, default=FRAMES)
    document = measure(parser.parse_args().answers)
    (RESULTS / "hour.json").write_text(json.dumps(document, indent=1) + "\n", "utf-8")
    print({key: value for key, value in document.items() if key not in ("machine", "resident_mib")})


if __name__ == "__main__":
    main()
