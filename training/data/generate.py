"""Filling a store: every group from its own seed, on as many processes as asked, resumable at any moment."""

from __future__ import annotations

import multiprocessing
import os
import sys
import threading
import time
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor, as_completed
from typing import Any

import numpy as np

from training.data.store import Store

THREAD_VARIABLES = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")


class Dropped(Exception):
    """A draw that gives no sample; `reason` is counted in the manifest."""

    def __init__(self, reason: str) -> None:
        super().__init__(reason)
        self.reason = reason


def fill(
    store: Store, draw: Callable[[int], dict[str, np.ndarray]], groups: Iterable[int], workers: int,
    configuration: dict[str, Any],
) -> dict[str, Any]:  # fmt: skip
    """Draw the groups that are not there yet, then write the manifest.

    Args:
        store: Where they go; groups that are there are kept.
        draw: Picklable; from a group's index to its arrays, or `Dropped`.
        groups: Indices wanted.
        workers: Processes, each with one thread for its linear algebra.
        configuration: Written to the manifest.
    """
    todo = [index for index in groups if not store.is_done(index)]
    for variable in THREAD_VARIABLES:
        os.environ[variable] = "1"
    started, printed, done, samples = time.monotonic(), 0.0, 0, 0
    # Spawned, not forked: the libraries read their number of threads when they load.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, mp_context=context, initializer=_end_with_parent) as pool:
        futures = [pool.submit(_draw_one, store, draw, index) for index in todo]
        for future in as_completed(futures):
            done, samples = done + 1, samples + future.result()
            elapsed = time.monotonic() - started
            if elapsed - printed > 10 or done == len(todo):
                printed = elapsed
                left = (len(todo) - done) * elapsed / done / 60
                print(
                    f"[{store.root.name}] {done}/{len(todo)} groups  {samples} samples  "
                    f"{samples / elapsed * 60:.0f} samples/min  {left:.0f} min left",
                    file=sys.stderr, flush=True,
                )  # fmt: skip
    return store.write_manifest(configuration)


def _end_with_parent() -> None:
    """Let no worker outlive a generation that was killed: it would wait for work for ever."""
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def watch() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _draw_one(store: Store, draw: Callable[[int], dict[str, np.ndarray]], index: int) -> int:
    try:
        arrays = draw(index)
    except Dropped as error:
        store.write_drop(index, error.reason)
        return 0
    store.write_group(index, arrays)
    return len(arrays["sample"])
