"""Drawing on a Ray cluster: the same draws, the same set, on as many machines as there are."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterator
from typing import Any, TypeVar

from training.data.store import StoreError

IN_FLIGHT = 3
"""Groups a CPU that are handed out at a time: the cluster stays busy, and few are drawn again after a failure."""

Outcome = TypeVar("Outcome")


def draw_on_cluster(
    draw_one: Callable[[Callable[[int], Any], int], Outcome], draw: Callable[[int], Any], todo: list[int], workers: int
) -> Iterator[tuple[int, Outcome]]:
    """Outcomes of all draws, in the order in which they are ready.

    A draw whose worker dies, or whose machine does, is drawn again elsewhere: it depends on its index alone, so that
    the set does not show it.

    Args:
        draw_one: Makes an outcome of a draw and an index; runs on the cluster.
        draw: Picklable.
        todo: Indices.
        workers: CPUs of the local cluster that is started where RAY_ADDRESS names none.

    Raises:
        StoreError: Ray is not installed.
    """
    try:
        import ray
    except ImportError as error:
        raise StoreError("Ray is not installed: pip install 'physnet[training,cluster]'") from error
    from training.data.generate import THREAD_VARIABLES

    started_here = not ray.is_initialized()
    if started_here:
        # One thread for the linear algebra of each worker, as with processes.
        environment = {"env_vars": {name: "1" for name in THREAD_VARIABLES}}
        local: dict[str, Any] = {} if "RAY_ADDRESS" in os.environ else {"num_cpus": workers, "include_dashboard": False}
        ray.init(log_to_driver=False, logging_level=logging.ERROR, runtime_env=environment, **local)
    try:
        task = ray.remote(num_cpus=1, max_retries=-1)(draw_one)
        shared = ray.put(draw)
        waiting: dict[Any, int] = {}
        rest = iter(todo)
        cpus: dict[str, float] = ray.cluster_resources()  # type: ignore[no-untyped-call]
        limit = IN_FLIGHT * max(1, int(cpus.get("CPU", 1)))
        while True:
            while len(waiting) < limit and (index := next(rest, None)) is not None:
                waiting[task.remote(shared, index)] = index
            if not waiting:
                return
            (ready,), _ = ray.wait(list(waiting), num_returns=1)
            index = waiting.pop(ready)
            try:
                outcome = ray.get(ready)
            except ray.exceptions.RayTaskError as error:
                raise error.cause from error
            yield index, outcome
    finally:
        if started_here:
            ray.shutdown()
