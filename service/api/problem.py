"""Errors as RFC 9457 problem documents, and pydantic's validation errors as ours."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from pydantic import ValidationError
from pydantic_core import ErrorDetails, to_json

from service.api.status import INTERNAL, status_of
from service.core.errors import (
    InvalidCamera,
    InvalidFrame,
    InvalidRequest,
    InvalidShape,
    MaterialOutOfRange,
    Overloaded,
    PhysNetError,
)

MEDIA_TYPE = "application/problem+json"

MAX_LISTED = 8
"""Fields in error that a problem document lists beside the first."""

# Which error a wrong value below each part of a request is. What is missing, unknown or not JSON is `invalid_request`.
_ERROR_BELOW: Mapping[str, type[InvalidRequest]] = {
    "camera": InvalidCamera,
    "up": InvalidCamera,
    "material": MaterialOutOfRange,
    "mask": InvalidFrame,
    "shape": InvalidShape,
}
_FORM_ERRORS = frozenset(
    {"missing", "extra_forbidden", "model_type", "literal_error", "string_type", "bytes_type", "bytes_invalid_encoding"}
)


class ValidationFailed(Exception):
    """Carries one error of the tree and the further fields in error, so that a client can mend all at once."""

    def __init__(self, error: InvalidRequest, others: Sequence[Mapping[str, str]]) -> None:
        super().__init__(error.message)
        self.error = error
        self.others = others


def field_path(location: Sequence[int | str]) -> str | None:
    """`("loads", 0, "force_n")` as `loads[0].force_n`; None for the document itself."""
    path = ""
    for step in location:
        path += f"[{step}]" if isinstance(step, int) else f".{step}" if path else step
    return path or None


def validation_failed(failure: ValidationError) -> ValidationFailed:
    """What pydantic found, as an error of our own tree with the field's path, expected and actual."""
    details = failure.errors(include_url=False)
    others = [
        {"field": field_path(detail["loc"]) or "", "detail": detail["msg"]} for detail in details[1 : 1 + MAX_LISTED]
    ]
    return ValidationFailed(_as_invalid_request(details[0]), others)


def _as_invalid_request(detail: ErrorDetails) -> InvalidRequest:
    kind, location = detail["type"], detail["loc"]
    path = field_path(location)
    if kind == "json_invalid":
        return InvalidRequest(f"The request is not JSON: {detail['msg']}.", expected="a JSON object")
    cls = InvalidRequest
    if location and kind not in _FORM_ERRORS:
        cls = _ERROR_BELOW.get(str(location[0]), InvalidRequest)
    if kind == "missing":
        return cls(f"`{path}` is missing.", field=path, expected="a value", actual="nothing")
    if kind == "extra_forbidden":
        return cls(f"`{path}` is not a field of this request.", field=path, expected="no such field")
    # pydantic's messages begin with the kind of thing it wants: "Input should be …", "List should have …".
    _, _, message = detail["msg"].rstrip(".").partition(" should ")
    message = f"should {message}" if message else f"is refused: {detail['msg'].rstrip('.')}"
    subject = f"`{path}`" if path else "The request"
    expected = message.removeprefix("should ").removeprefix("be ")
    return cls(f"{subject} {message}.", field=path, expected=expected, actual=_shown(detail["input"]))


def _shown(value: object) -> str | int | float:
    """A value short enough to send back. Long strings are data: only their length says something."""
    if isinstance(value, bool) or value is None:
        return {True: "true", False: "false", None: "null"}[value]
    if isinstance(value, (int, float)):
        return value if math.isfinite(value) and abs(value) < 2**53 else str(value)[:40]
    if isinstance(value, str):
        return value if len(value) <= 80 else f"a string of {len(value)} characters"
    if isinstance(value, (list, tuple)):
        return f"an array of {len(value)}"
    return "an object" if isinstance(value, dict) else type(value).__name__


def problem_document(error: BaseException, request_id: str) -> dict[str, Any]:
    """The problem document of an error. What is not in the tree gives no more away than its request id."""
    others: Sequence[Mapping[str, str]] = ()
    if isinstance(error, ValidationFailed):
        others = error.others
        error = error.error
    if not isinstance(error, PhysNetError):
        return document(
            "internal",
            INTERNAL.http,
            "The service failed on this request; its log has the details under the request id.",
            request_id,
        )
    return document(
        error.code,
        status_of(error).http,
        error.message,
        request_id,
        field=error.field,
        expected=error.expected,
        actual=error.actual,
        errors=list(others) or None,
    )


def document(code: str, status: int, detail: str, request_id: str, **more: object) -> dict[str, Any]:
    """A problem document by its members; those that are None are left out."""
    members = {
        "type": f"/problems/{code}",
        "title": code.replace("_", " ").capitalize(),
        "status": status,
        "detail": detail,
        "code": code,
        **more,
        "request_id": request_id,
    }
    return {key: value for key, value in members.items() if value is not None}


def problem_bytes(problem: Mapping[str, Any]) -> bytes:
    """The document as UTF-8 JSON; a NaN that slipped into it becomes null, which JSON can say."""
    return to_json(problem, inf_nan_mode="null")


def problem_headers(error: BaseException) -> dict[str, str]:
    """Headers that go with an error: when to try again, or how to authenticate."""
    if isinstance(error, Overloaded):
        # Retry-After counts whole seconds; a robot that can do better finds the rest in the detail.
        return {"Retry-After": str(max(1, math.ceil(error.retry_after_s)))}
    if status_of(error).http == 401:
        return {"WWW-Authenticate": "Bearer"}
    return {}
