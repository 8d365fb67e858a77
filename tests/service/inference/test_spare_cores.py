import gc
import threading
from collections.abc import Iterator

import pytest

from service.core.spread import Spread
from service.inference.spare_cores import Once, SpareCores

LONG_S = 30.0


@pytest.fixture
def held() -> Iterator[tuple[SpareCores, threading.Event]]:
    """One spare thread, busy until the event is set."""
    spare, go_on, begun = SpareCores(1), threading.Event(), threading.Event()

    def hold() -> None:
        begun.set()
        go_on.wait(LONG_S)

    spare.offer(Once(hold))
    assert begun.wait(LONG_S)
    yield spare, go_on
    go_on.set()


def test_a_result_is_worked_out_once() -> None:
    made: list[int] = []
    once = Once(lambda: made.append(1) or len(made))
    threads = [threading.Thread(target=once) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert (once(), made) == (1, [1])


def test_what_failed_is_tried_again() -> None:
    answers = iter([ZeroDivisionError, 7])

    def work() -> int:
        answer = next(answers)
        if isinstance(answer, int):
            return answer
        raise answer

    once = Once(work)
    with pytest.raises(ZeroDivisionError):
        once()
    assert once() == 7


def test_what_is_offered_is_worked_out_meanwhile() -> None:
    spare, done = SpareCores(1), threading.Event()
    once = spare.offer(Once(lambda: done.set() or threading.current_thread().name))
    assert done.wait(LONG_S)
    assert once().startswith("spare-core")


def test_who_asks_does_not_wait_for_busy_threads(held: tuple[SpareCores, threading.Event]) -> None:
    spare, _ = held
    assert spare.offer(Once(lambda: threading.current_thread()))() is threading.current_thread()
    done: list[tuple[int, int]] = []
    spare.spread(lambda first, end: done.append((first, end)), 5)
    assert done == [(0, 2), (2, 5)]


def test_without_spare_cores_all_is_done_in_turn() -> None:
    spare, done = SpareCores(0), list[tuple[int, int]]()
    spare.spread(lambda first, end: done.append((first, end)), 5)
    assert done == [(0, 5)]
    once = spare.offer(Once(lambda: done.append((9, 9))))
    assert done == [(0, 5)]
    once()
    assert done[1:] == [(9, 9)]


def test_with_a_request_for_each_core_none_is_spare() -> None:
    spare, parts = SpareCores(1), list[tuple[int, int]]()

    def spread() -> list[tuple[int, int]]:
        parts.clear()
        spare.spread(lambda first, end: parts.append((first, end)), 4)
        return sorted(parts)

    with spare.answering():
        assert spread() == [(0, 2), (2, 4)]
        with spare.answering():
            assert spread() == [(0, 4)]
        assert spread() == [(0, 2), (2, 4)]


@pytest.mark.parametrize("count", [0, 1])
@pytest.mark.parametrize("numbers", [1, 2, 5])
def test_each_number_is_worked_on_and_only_a_single_one_in_parts(count: int, numbers: int) -> None:
    spare = SpareCores(count)

    def work(i: int, spread: Spread) -> list[tuple[int, int, int]]:
        parts: list[tuple[int, int, int]] = []
        spread(lambda first, end: parts.append((i, first, end)), 4)
        return sorted(parts)

    expected = [[(i, 0, 4)] for i in range(numbers)] if numbers > 1 or not count else [[(0, 0, 2), (0, 2, 4)]]
    assert spare.each(work, numbers) == expected


@pytest.mark.parametrize("count", [0, 1])
def test_what_a_part_raises_is_raised(count: int) -> None:
    def work(first: int, end: int) -> None:
        if end == 4:
            raise ValueError("the last")

    with pytest.raises(ValueError, match="the last"):
        SpareCores(count).spread(work, 4)


def test_the_threads_end_with_their_owner() -> None:
    spare = SpareCores(1)
    done = threading.Event()
    ours: list[threading.Thread] = []
    spare.offer(Once(lambda: ours.append(threading.current_thread()) or done.set()))
    assert done.wait(LONG_S)
    del spare
    gc.collect()
    ours[0].join(LONG_S)
    assert not ours[0].is_alive()
