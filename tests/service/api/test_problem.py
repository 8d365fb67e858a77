"""Errors as problem documents, with the field, and nothing given away."""

from __future__ import annotations

import json

import pytest

from service.api.convert import parse_body
from service.api.problem import ValidationFailed, field_path, problem_bytes, problem_document, problem_headers
from service.core.errors import ContactOffBody, Overloaded, Unauthenticated
from tests.service.box_scene import BoxScene

GOOD = BoxScene(width=32, height=24, focal_px=30.0).request()


def refused(body: object) -> dict:
    data = body if isinstance(body, bytes) else json.dumps(body).encode()
    with pytest.raises(ValidationFailed) as caught:
        parse_body(data)
    return problem_document(caught.value, "r-1")


def changed(path: str, value: object) -> dict:
    """The good request with one value replaced, or removed where `...`."""
    body = json.loads(json.dumps(GOOD))
    *parents, last = path.split(".")
    place = body
    for step in parents:
        place = place[int(step)] if step.isdigit() else place.setdefault(step, {})
    if value is ...:
        del place[last]
    else:
        place[last] = value
    return body


def test_the_good_request_is_good():
    assert parse_body(json.dumps(GOOD).encode()).camera.width == 32


@pytest.mark.parametrize(
    ("path", "value", "code", "field"),
    [
        ("material", ..., "invalid_request", "material"),
        ("loads", ..., "invalid_request", "loads"),
        ("loads", [], "invalid_request", "loads"),
        ("loads", {}, "invalid_request", "loads"),
        ("loads.0.force_n", ..., "invalid_request", "loads[0].force_n"),
        ("loads.0.force_n", [1.0, 2.0], "invalid_request", "loads[0].force_n[2]"),
        ("loads.0.force_n", [1.0, "2", 3.0], "invalid_request", "loads[0].force_n[1]"),
        ("loads.0.force_n", [float("nan"), 0.0, 0.0], "invalid_request", "loads[0].force_n[0]"),
        ("loads.0.contact_m", [float("inf"), 0.0, 0.0], "invalid_request", "loads[0].contact_m[0]"),
        ("loads.0.patch_radius_m", 0.0, "invalid_request", "loads[0].patch_radius_m"),
        ("loads.0.patch_radius_m", float("nan"), "invalid_request", "loads[0].patch_radius_m"),
        ("camera.fx", ..., "invalid_request", "camera.fx"),
        ("camera.fx", "615", "invalid_camera", "camera.fx"),
        ("camera.fx", None, "invalid_camera", "camera.fx"),
        ("camera.width", 32.5, "invalid_camera", "camera.width"),
        ("camera.focal", 1.0, "invalid_request", "camera.focal"),
        ("camera", 3, "invalid_request", "camera"),
        ("up", [0.0, -1.0], "invalid_request", "up[2]"),
        ("up", [0.0, "x", 1.0], "invalid_camera", "up[1]"),
        ("material.young_modulus_pa", "soft", "material_out_of_range", "material.young_modulus_pa"),
        ("material.name", 7, "invalid_request", "material.name"),
        ("depth.data", "!!!", "invalid_request", "depth.data"),
        ("depth.data", "YWJj\nZGVm", "invalid_request", "depth.data"),
        ("depth.data", 5, "invalid_request", "depth.data"),
        ("mask", {"data": "%"}, "invalid_request", "mask.data"),
        ("mask.polarity", "white", "invalid_request", "mask.polarity"),
        ("roi", [0, 0, 1], "invalid_request", "roi[3]"),
        ("roi", [0, 0, 1, 1.5], "invalid_request", "roi[3]"),
        ("outputs", ["mesh"], "invalid_request", "outputs[0]"),
        ("threshold", 1.0, "invalid_request", "threshold"),
        ("uncertainty_samples", -1, "invalid_request", "uncertainty_samples"),
        ("uncertainty_samples", 10**30, "invalid_request", "uncertainty_samples"),
        ("frame", 1, "invalid_request", "frame"),
    ],
)
def test_a_wrong_field_is_named(path, value, code, field):
    problem = refused(changed(path, value))
    assert (problem["code"], problem["field"]) == (code, field)
    assert problem["type"] == f"/problems/{code}"
    assert problem["status"] in (400, 422)
    assert problem["request_id"] == "r-1"
    assert field in problem["detail"]
    assert problem["detail"].endswith(".")
    # A wrong value is described; a missing or unknown one has none.
    assert problem["expected"]
    json.loads(problem_bytes(problem))


@pytest.mark.parametrize("body", [b"", b"{", b"[]", b"null", b"\xff\xfe", b'"x"', b"[" * 100_000, b'{"loads": NaN'])
def test_what_is_no_json_object_is_refused(body):
    problem = refused(body)
    assert problem["code"] == "invalid_request"
    assert problem["status"] == 400
    assert len(json.dumps(problem)) < 1000


def test_further_fields_in_error_are_listed_too():
    body = changed("camera.fx", "x")
    body["surprise"] = 1
    problem = refused(body)
    assert problem["field"] == "camera.fx"
    assert [other["field"] for other in problem["errors"]] == ["surprise"]


def test_a_flood_of_errors_is_cut_short():
    problem = refused(changed("loads", [{"force_n": "x"}] * 1000))
    assert len(problem["errors"]) == 8


def test_data_of_an_error_of_the_core_is_carried():
    error = ContactOffBody("Too far.", field="loads[0].contact_m", expected=0.02, actual=0.31)
    problem = problem_document(error, "id")
    assert problem == {
        "type": "/problems/contact_off_body",
        "title": "Contact off body",
        "status": 422,
        "detail": "Too far.",
        "code": "contact_off_body",
        "field": "loads[0].contact_m",
        "expected": 0.02,
        "actual": 0.31,
        "request_id": "id",
    }


def test_an_unknown_exception_gives_nothing_away():
    problem = problem_document(RuntimeError("/home/secret/path token=abc"), "id")
    assert problem["status"] == 500
    assert problem["code"] == "internal"
    assert "secret" not in json.dumps(problem)
    assert "abc" not in json.dumps(problem)


def test_headers_say_when_and_how_to_try_again():
    assert problem_headers(Overloaded("full", retry_after_s=0.05)) == {"Retry-After": "1"}
    assert problem_headers(Overloaded("full", retry_after_s=2.1)) == {"Retry-After": "3"}
    assert problem_headers(Unauthenticated("who?")) == {"WWW-Authenticate": "Bearer"}


def test_a_nan_in_an_error_does_not_break_the_document():
    error = ContactOffBody("Off.", actual=float("nan"))
    assert json.loads(problem_bytes(problem_document(error, "id")))["actual"] is None


def test_paths_read_like_code():
    assert field_path(("loads", 0, "contact_m", 2)) == "loads[0].contact_m[2]"
    assert field_path(()) is None
