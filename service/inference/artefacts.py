"""Reading a model folder: its manifest, and every file against its digest."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

from service.core.errors import ModelMismatch
from service.core.manifest import Manifest


def read_manifest(directory: Path) -> Manifest:
    """The manifest of a model folder, checked.

    Raises:
        ModelMismatch: Something is missing, was changed after export, or speaks another contract.
    """
    path = directory / "manifest.json"
    try:
        manifest = Manifest.from_json(json.loads(path.read_bytes()))
    except FileNotFoundError as error:
        raise ModelMismatch(f"{directory} has no manifest.json: export the model again.") from error
    except (ValueError, KeyError, TypeError) as error:
        raise ModelMismatch(f"{path} is not a manifest this service knows: {error}") from error
    except ModelMismatch as error:
        raise ModelMismatch(f"{path}: {error.message}", expected=error.expected, actual=error.actual) from error
    for name, digest in manifest.files.items():
        file = directory / name
        if not file.is_file():
            raise ModelMismatch(f"{file} is missing: export the model again.", expected=digest)
        found = hashlib.sha256(file.read_bytes()).hexdigest()
        if found != digest:
            raise ModelMismatch(
                f"{file} is not the file that was exported: its digest differs.", expected=digest, actual=found
            )
    return manifest
