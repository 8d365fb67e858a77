"""What travels with a model: where it came from, what it expects, what it scored."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, ValidationError

from service.core.contract import CONDITION_CONTRACT, GRID_CONTRACT
from service.core.errors import ModelMismatch


class TensorSpec(BaseModel):
    """Name, dtype and shape of a graph's input or output; a string is a free dimension."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str
    dtype: Literal["float32"]
    shape: tuple[int | str, ...]


class Manifest(BaseModel):
    """`models/<name>/<version>/manifest.json`."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str
    version: str
    kind: Literal["reconstruction", "deformation"]
    graph: str
    """File name of the ONNX graph beside the manifest."""
    files: dict[str, str]
    """Every file beside the manifest but itself, with its sha256."""
    inputs: tuple[TensorSpec, ...]
    outputs: tuple[TensorSpec, ...]
    grid_contract: str
    condition_contract: str | None
    """None for a network that takes no condition."""
    threshold: float
    """Occupancy probability, tuned on validation, above which a voxel counts as filled."""
    condition_range: dict[str, tuple[float, float]]
    """Range of each condition field over the training set; outside it an answer is flagged."""
    configuration: dict[str, Any]
    """Network and training configuration, as saved in the checkpoint."""
    run: str
    """Name of the training run the weights came from."""
    dataset: dict[str, Any]
    """Manifest of the data set the run was trained on."""
    commit: str
    """Git commit of the code that exported the graph."""
    parity: float
    """Largest absolute difference between torch and ONNX Runtime at export."""
    evaluation: dict[str, Any]
    """The evaluation table on held-out shapes."""


def read_manifest(directory: Path) -> Manifest:
    """Read and check a model folder: the manifest, its contracts and the digest of every file.

    Raises:
        ModelMismatch: Something is missing, was changed after export, or speaks another contract.
    """
    path = directory / "manifest.json"
    try:
        manifest = Manifest.model_validate_json(path.read_bytes())
    except FileNotFoundError as error:
        raise ModelMismatch(f"{directory} has no manifest.json: export the model again.") from error
    except ValidationError as error:
        raise ModelMismatch(f"{path} is not a manifest this service knows: {error}") from error
    _expect(path, "grid contract", GRID_CONTRACT, manifest.grid_contract)
    if manifest.condition_contract is not None:
        _expect(path, "condition contract", CONDITION_CONTRACT, manifest.condition_contract)
    if manifest.graph not in manifest.files:
        raise ModelMismatch(f"{path} names the graph {manifest.graph} but has no digest for it.")
    for name, digest in manifest.files.items():
        file = directory / name
        if not file.is_file():
            raise ModelMismatch(f"{file} is missing: export the model again.", expected=digest)
        _expect(file, "sha256", digest, hashlib.sha256(file.read_bytes()).hexdigest())
    return manifest


def _expect(path: Path, what: str, expected: str, actual: str) -> None:
    if expected != actual:
        raise ModelMismatch(
            f"{path}: {what} is {actual}, expected {expected}. Export the model again with this version.",
            expected=expected,
            actual=actual,
        )
