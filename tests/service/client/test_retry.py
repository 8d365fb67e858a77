"""When a client asks again, and for how long it waits."""

from __future__ import annotations

import json
import time
from datetime import UTC, datetime, timedelta
from email.utils import format_datetime

import pytest

from service.client import ContactOffBody, DeadlineExceeded, Overloaded, Retry, ServiceUnreachable, UnexpectedReply
from service.client.errors import RETRY_AFTER_S, problem_error
from service.client.http_wire import decode
from service.client.retry import Attempts
from service.core.errors import ModelMismatch, PhysNetError

GONE = ServiceUnreachable("No connection.")


def test_pauses_grow_to_a_bound_and_are_drawn_at_random():
    retry = Retry(attempts=100, first_s=0.1, longest_s=1.0)
    for tried, longest_s in ((1, 0.1), (2, 0.2), (3, 0.4), (5, 1.0), (90, 1.0)):
        drawn = [retry.pause_s(tried, GONE) for _ in range(300)]
        assert 0.0 <= min(drawn) < 0.1 * longest_s
        assert 0.9 * longest_s < max(drawn) <= longest_s
    assert Retry().without_end().pause_s(5000, GONE) <= Retry().longest_s


def test_an_overloaded_service_is_left_alone_for_as_long_as_it_asks():
    pause_s = Retry(first_s=0.01).pause_s(1, Overloaded("Full.", retry_after_s=3.0))
    assert 3.0 <= pause_s <= 3.01


@pytest.mark.parametrize("error", [ContactOffBody("Off."), DeadlineExceeded("Late."), PhysNetError("A bug."),
                                   ModelMismatch("Broken."), UnexpectedReply("What?")])  # fmt: skip
def test_what_a_second_try_cannot_mend_is_raised_at_once(error):
    assert Retry().pause_s(1, error) is None
    with pytest.raises(type(error)):
        Attempts(Retry(), 10.0).pause_s(error)


def test_tries_are_counted_and_end_at_the_deadline():
    attempts = Attempts(Retry(attempts=3, first_s=0.0), 10.0)
    for _ in range(2):
        assert attempts.pause_s(GONE) == 0.0
    with pytest.raises(ServiceUnreachable):
        attempts.pause_s(GONE)
    # A pause that would last beyond the deadline is not begun.
    with pytest.raises(Overloaded):
        Attempts(Retry(), 1.0).pause_s(Overloaded("Full.", retry_after_s=2.0))
    late = Attempts(Retry(), 0.001)
    time.sleep(0.002)
    with pytest.raises(DeadlineExceeded, match=r"0\.001 s"):
        late.left_s()


def refused(code: str, status: int = 503, **headers: str) -> PhysNetError:
    content = json.dumps({"code": code, "detail": "Words.", "errors": [{"field": "loads[1]", "detail": "More."}]})
    with pytest.raises(PhysNetError) as caught:
        decode(status, headers, content.encode())
    return caught.value


def test_retry_after_is_seconds_or_a_date_or_a_guess():
    assert refused("overloaded", **{"retry-after": "7"}).retry_after_s == 7.0
    later = format_datetime(datetime.now(UTC) + timedelta(seconds=30), usegmt=True)
    assert 25.0 < refused("overloaded", **{"retry-after": later}).retry_after_s <= 30.0
    assert refused("overloaded", **{"retry-after": "soon"}).retry_after_s == RETRY_AFTER_S
    assert refused("overloaded").retry_after_s == RETRY_AFTER_S


def test_every_code_of_the_service_has_its_class():
    from service.api.status import STATUS

    for cls in STATUS:
        error = problem_error({"code": cls.code, "detail": "Words.", "field": "up"})
        assert type(error) is cls
        assert error.message == "Words."
    assert refused("invalid_request", 400).__notes__ == ["also loads[1]: More."]
    assert type(problem_error({"code": "internal", "detail": "Words."})) is PhysNetError
