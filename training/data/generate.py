"""Filling a store: every group from its own seed, on as many processes as asked, resumable at any moment."""

from __future__ import annotations

import multiprocessing
import os
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
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
    configuration: dict[str, Any], engine: str = "processes",
) -> dict[str, Any]:  # fmt: skip
    """Draw the groups that are not there yet, then write the manifest.

    Args:
        store: Where they go; groups that are there are kept.
        draw: Picklable; from a group's index to its arrays, or `Dropped`.
        groups: Indices wanted.
        workers: Processes, each with one thread for its linear algebra.
        configuration: Written to the manifest.
        engine: `processes` of this machine, or `ray`, on the cluster at RAY_ADDRESS or a local one.

    Raises:
        StoreError: The folder holds another set, or the disk is full.
    """
    store.begin(configuration)
    todo = [index for index in groups if not store.is_done(index)]
    for variable in THREAD_VARIABLES:
        os.environ[variable] = "1"
    started, printed, done, samples = time.monotonic(), 0.0, 0, 0
    for count in _ENGINES[engine](store, draw, todo, workers):
        done, samples = done + 1, samples + count
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


def _with_processes(
    store: Store, draw: Callable[[int], dict[str, np.ndarray]], todo: list[int], workers: int
) -> Iterator[int]:
    """Samples of each group as it is written by a process of this machine."""
    # Spawned, not forked: the libraries read their number of threads when they load.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, mp_context=context, initializer=_end_with_parent) as pool:
        futures = [pool.submit(_draw_and_write, store, draw, index) for index in todo]
        try:
            for future in as_completed(futures):
                yield future.result()
        except BaseException:
            # What is wrong with one group is wrong with the next: a bug, or a disk that is full.
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _with_ray(
    store: Store, draw: Callable[[int], dict[str, np.ndarray]], todo: list[int], workers: int
) -> Iterator[int]:
    """The same on a Ray cluster, whose machines need not share a disk: the groups are written here."""
    from training.data.cluster import draw_on_cluster

    for index, outcome in draw_on_cluster(draw_one, draw, todo, workers):
        yield write_one(store, index, outcome)


_ENGINES = {"processes": _with_processes, "ray": _with_ray}
ENGINES = tuple(_ENGINES)


def _end_with_parent() -> None:
    """Let no worker outlive a generation that was killed: it would wait for work for ever."""
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def watch() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def draw_one(draw: Callable[[int], dict[str, np.ndarray]], index: int) -> dict[str, np.ndarray] | str:
    """The arrays of a group, or the reason why there are none."""
    try:
        return draw(index)
    except Dropped as error:
        return error.reason


def write_one(store: Store, index: int, outcome: dict[str, np.ndarray] | str) -> int:
    """Put an outcome of `draw_one` into the store; returns how many samples it has."""
    if isinstance(outcome, str):
        store.write_drop(index, outcome)
        return 0
    store.write_group(index, outcome)
    return len(outcome["sample"])


def _draw_and_write(store: Store, draw: Callable[[int], dict[str, np.ndarray]], index: int) -> int:
    return write_one(store, index, draw_one(draw, index))
