"""The OpenAPI document: what FastAPI cannot infer from a route that reads its own body."""

from __future__ import annotations

import base64
import json
from pathlib import Path
from typing import Any

import numpy as np
from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi
from pydantic.json_schema import models_json_schema

from service.api.schemas import DeformBody, DeformReply, ProblemReply
from service.core.arrays import GRID_SIZE
from service.core.grids import pack_bits

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


def examples() -> dict[str, dict[str, Any]]:
    """Requests that run as they stand, by what they show; `again` once its id is that of an earlier reply."""
    frame = example_request()
    block = np.zeros((GRID_SIZE,) * 3, bool)
    block[16:48, 16:48, :32] = True
    shape = {
        "encoding": "bits",
        "data": base64.b64encode(pack_bits(block).tobytes()).decode("ascii"),
        "voxel_size_m": 0.003125,
        "camera_from_grid": [[1, 0, 0, -0.1], [0, 0, -1, 0.1], [0, 1, 0, 0.5], [0, 0, 0, 1]],
    }
    load = {"contact_m": [0.0, 0.05, 0.55], "force_n": [0.0, 0.0, 2.0]}
    material = {"name": "silicone"}
    again = {"reconstruction_id": "0123456789abcdef0123456789abcdef", "material": material, "loads": frame["loads"]}
    return {
        "frame": {"summary": "A depth frame and one push", "value": frame},
        "shape": {
            "summary": "A known shape: a block of 10 cm half a metre in front of the camera",
            "value": {"shape": shape, "material": material, "loads": [load]},
        },
        "again": {"summary": "What was reconstructed before, of another material", "value": again},
    }


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
        components["examples"] = examples()
        if secured:
            components["securitySchemes"] = {"bearer": {"type": "http", "scheme": "bearer"}}
            schema["security"] = [{"bearer": []}]
        app.openapi_schema = schema
    return app.openapi_schema
