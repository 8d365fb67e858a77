"""The OpenAPI document: what FastAPI cannot infer from a route that reads its own body."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi
from pydantic.json_schema import models_json_schema

from service.api.schemas import DeformBody, DeformReply, ProblemReply

API_VERSION = "1.0.0"

DESCRIPTION = (
    "One depth frame of an object in; its full shape and the shape it takes under a push out, in the camera's own "
    "metric frame. Units are SI. Errors are RFC 9457 problem documents with a stable `code`."
)

EXAMPLE_FILE = Path(__file__).resolve().parent / "example_request.json"


def _ref(model: type) -> dict[str, str]:
    return {"$ref": f"#/components/schemas/{model.__name__}"}


PROBLEMS: dict[int | str, dict[str, Any]] = {
    "4XX": {
        "description": "The request was refused.",
        "content": {"application/problem+json": {"schema": _ref(ProblemReply)}},
    },
    "5XX": {
        "description": "The service could not answer.",
        "content": {"application/problem+json": {"schema": _ref(ProblemReply)}},
    },
}


def example_request() -> dict[str, Any]:
    """A request that runs as it stands: a box on a table, rendered at 160×120, pushed from the side."""
    example: dict[str, Any] = json.loads(EXAMPLE_FILE.read_text("utf-8"))
    return example


def _deform() -> dict[str, Any]:
    multipart = {
        "type": "object",
        "required": ["request"],
        "properties": {
            "request": _ref(DeformBody),
            "depth": {"type": "string", "format": "binary", "description": "The depth image."},
            "mask": {"type": "string", "format": "binary", "description": "The mask of the object."},
        },
    }
    return {
        "responses": {
            200: {
                "description": "The shapes.",
                "content": {
                    "application/json": {"schema": _ref(DeformReply)},
                    "application/x-npz": {"schema": {"type": "string", "format": "binary"}},
                    "model/gltf-binary": {"schema": {"type": "string", "format": "binary"}},
                },
            }
        },
        "openapi_extra": {
            "parameters": [
                {
                    "name": "X-Deadline-Ms",
                    "in": "header",
                    "required": False,
                    "description": "Milliseconds from arrival after which the request is not worth answering.",
                    "schema": {"type": "number", "exclusiveMinimum": 0},
                },
            ],
            "requestBody": {
                "required": True,
                "content": {
                    "application/json": {"schema": _ref(DeformBody), "example": example_request()},
                    "multipart/form-data": {
                        "schema": multipart,
                        "encoding": {"request": {"contentType": "application/json"}},
                    },
                },
            },
        },
    }


DEFORM = _deform()


def document(app: FastAPI, *, secured: bool) -> dict[str, Any]:
    """The whole document, built once."""
    if app.openapi_schema is None:
        schema = get_openapi(title=app.title, version=app.version, description=app.description, routes=app.routes)
        models = [(DeformBody, "validation"), (DeformReply, "serialization"), (ProblemReply, "serialization")]
        _, extra = models_json_schema(models, ref_template="#/components/schemas/{model}")  # type: ignore[arg-type]
        components = schema.setdefault("components", {})
        components.setdefault("schemas", {}).update(extra.get("$defs", {}))
        if secured:
            components["securitySchemes"] = {"bearer": {"type": "http", "scheme": "bearer"}}
            schema["security"] = [{"bearer": []}]
        app.openapi_schema = schema
    return app.openapi_schema
