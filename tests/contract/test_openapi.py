"""What clients build on: routes, documents and codes may grow, but nothing a client uses may go or change meaning.

After a change that is meant, write the baseline anew: `PHYSNET_WRITE_BASELINE=1 python -m pytest tests/contract`.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import pytest

from service.api import convert
from service.api.handler import Handler
from service.api.openapi import example_request
from service.api.rest import create_http
from service.api.status import meanings
from service.settings import Settings

BASELINE = Path(__file__).with_name("http_v1.json")
CODES = {
    "invalid_request": 400,
    "invalid_frame": 422,
    "invalid_camera": 422,
    "invalid_shape": 422,
    "empty_object": 422,
    "no_support_plane": 422,
    "contact_off_body": 422,
    "material_out_of_range": 422,
    "unknown_material": 422,
    "unknown_model": 404,
    "reconstruction_gone": 410,
    "payload_too_large": 413,
    "unauthenticated": 401,
    "overloaded": 503,
    "deadline_exceeded": 504,
    "model_mismatch": 500,
    "internal": 500,
}


@pytest.fixture(scope="module")
def api() -> dict[str, Any]:
    return json.loads(json.dumps(create_http(Handler(), Settings()).openapi()))


def test_what_clients_use_is_still_there(api):
    published = _contract(api)
    if os.environ.get("PHYSNET_WRITE_BASELINE"):
        BASELINE.write_text(json.dumps(published, indent=1, ensure_ascii=False) + "\n", "utf-8")
    committed = json.loads(BASELINE.read_text("utf-8"))
    assert set(committed["routes"]) <= set(published["routes"])
    for field, committed_type in committed["fields"].items():
        assert published["fields"].get(field) == committed_type, field
    # A field that a request did not need yesterday must not be needed today.
    new_in_requests = {field for field in published["fields"] if "Body." in field} - set(committed["fields"])
    assert not [field for field in new_in_requests if published["fields"][field].endswith("required")]


def _contract(api: dict[str, Any]) -> dict[str, Any]:
    """Routes, and every field of our own documents with its type, free of how FastAPI or pydantic lay them out."""
    routes = [f"{method.upper()} {path}" for path, methods in api["paths"].items() for method in methods]
    fields = {}
    for name, schema in api["components"]["schemas"].items():
        if not name.endswith(("Body", "Reply")):
            continue
        for field, part in schema.get("properties", {}).items():
            needed = "required" if field in schema.get("required", []) else "optional"
            fields[f"{name}.{field}"] = f"{_type(part)} {needed}"
    return {"routes": sorted(routes), "fields": dict(sorted(fields.items()))}


def _type(schema: dict[str, Any]) -> str:
    match schema:
        case {"$ref": reference}:
            return reference.rpartition("/")[2]
        case {"anyOf": choices}:
            return "|".join(_type(choice) for choice in choices)
        case {"enum": values}:
            return "|".join(map(repr, values))
        case {"const": value}:
            return repr(value)
        case {"prefixItems": items}:
            return f"[{', '.join(map(_type, items))}]"
        case {"items": items}:
            return f"{_type(items)}[]"
        case {"additionalProperties": dict(values)}:
            return f"{{{_type(values)}}}"
    return schema["type"]


def test_codes_and_their_status_are_stable():
    assert {code: status.http for code, status in meanings().items()} == CODES


def test_every_reference_resolves(api):
    def references(node: Any) -> list[str]:
        if isinstance(node, dict):
            own = [node["$ref"]] if isinstance(node.get("$ref"), str) else []
            return own + [found for value in node.values() for found in references(value)]
        return [found for item in node for found in references(item)] if isinstance(node, list) else []

    names = {reference.rpartition("/")[2] for reference in references(api)}
    assert {"DeformBody", "DeformReply", "ProblemReply", "LoadBody", "MaterialsReply"} <= names
    assert names <= set(api["components"]["schemas"])


def test_the_routes_of_the_design_are_there(api):
    assert {"/v1/deform", "/v1/materials", "/v1/models", "/healthz", "/readyz", "/metrics"} <= set(api["paths"])
    content = api["paths"]["/v1/deform"]["post"]["requestBody"]["content"]
    assert set(content) == {"application/json", "multipart/form-data"}
    reply = api["paths"]["/v1/deform"]["post"]["responses"]["200"]["content"]
    assert set(reply) == {"application/json", "application/x-npz", "model/gltf-binary"}


def test_every_field_of_a_request_is_explained(api):
    for name in ("CameraBody", "DepthBody", "ShapeBody", "LoadBody"):
        for field, schema in api["components"]["schemas"][name]["properties"].items():
            assert schema.get("description"), f"{name}.{field}"


def test_the_example_is_a_request():
    body = convert.parse_body(json.dumps(example_request()).encode())
    request = convert.deform_request(body, max_loads=1)
    assert len(request.source.depth.data) > 100


def test_the_examples_run_in_their_order(live_service):
    httpx = pytest.importorskip("httpx")
    api = httpx.get(f"{live_service.url}/openapi.json").json()
    examples = api["components"]["examples"]
    assert list(examples) == ["frame", "shape", "again"]
    assert examples["frame"]["value"] == example_request()
    first = ""
    for name, example in examples.items():
        body = example["value"]
        if name == "again":
            unknown = httpx.post(f"{live_service.url}/v1/deform", json=body, timeout=30)
            assert (unknown.status_code, unknown.json()["code"]) == (410, "reconstruction_gone")
            body["reconstruction_id"] = first
        reply = httpx.post(f"{live_service.url}/v1/deform", json=body, timeout=30)
        assert reply.status_code == 200, (name, reply.text)
        assert reply.json()["loads"][0]["max_displacement_m"] > 0, name
        first = first or reply.json()["reconstruction_id"]
