"""What can go wrong with a call: the service's own errors, typed as in `service.core.errors`, and two of the way there.

    PhysNetError
    ├── …                    what the service said: its class by its `code`, with `field`, `expected` and `actual`
    ├── ServiceUnreachable   unreachable        no connection, or it broke
    └── UnexpectedReply      (the reply's own)  something answered that is no service of ours, or a newer one

All are raised; none is hidden in a result.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from service.core.errors import DeadlineExceeded, Overloaded, PhysNetError

RETRY_AFTER_S = 0.5
"""Of an overloaded service that did not say when to try again."""


class ServiceUnreachable(PhysNetError):
    """No connection, or it broke before the reply was whole."""

    code = "unreachable"


class UnexpectedReply(PhysNetError):
    """Something answered that the client does not know; `code` is the reply's own where it has one."""

    code = "unexpected_reply"

    def __init__(self, message: str, *, code: str = "unexpected_reply", **found: Any) -> None:
        super().__init__(message, **found)
        self.code = code  # type: ignore[misc]  # an instance's own: there is no class for it


def problem_error(problem: Mapping[str, Any], retry_after_s: float | None = None) -> PhysNetError:
    """A problem document as the error it tells of, ready to be raised.

    Args:
        problem: `code`, `detail` and, where known, `field`, `expected`, `actual`, `errors`, `request_id`.
        retry_after_s: When a retry has a chance, where the reply says so.
    """
    code, detail = str(problem.get("code", "")), str(problem.get("detail", "The service gave no reason."))
    found = {name: problem.get(name) for name in ("field", "expected", "actual")}
    error: PhysNetError
    if code == Overloaded.code:
        error = Overloaded(detail, retry_after_s=RETRY_AFTER_S if retry_after_s is None else retry_after_s)
    elif code in (known := {cls.code: cls for cls in _tree(PhysNetError)}):
        error = known[code](detail, **found)
    else:
        error = UnexpectedReply(detail, code=code or UnexpectedReply.code, **found)
    # Notes stand under the message wherever a traceback is printed.
    for other in problem.get("errors") or ():
        error.add_note(f"also {other.get('field')}: {other.get('detail')}")
    if problem.get("request_id"):
        error.add_note(f"request id {problem['request_id']}")
    return error


def timed_out(timeout_s: float) -> DeadlineExceeded:
    """No reply in time, on this side of the wire."""
    return DeadlineExceeded(f"The service did not answer within {timeout_s:g} s.", expected=timeout_s)


def _tree(cls: type[PhysNetError]) -> Iterator[type[PhysNetError]]:
    for child in cls.__subclasses__():
        if child.__module__ in (PhysNetError.__module__, __name__) and child is not UnexpectedReply:
            yield child
            yield from _tree(child)
    yield cls
