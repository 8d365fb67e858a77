"""What travels with a model: where it came from, what it expects, what it scored."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

from service.core.contract import CONDITION_CONTRACT, GRID_CONTRACT
from service.core.errors import ModelMismatch

KINDS = ("reconstruction", "deformation")


@dataclass(frozen=True)
class TensorSpec:
    """Name and shape of a float32 tensor of a graph; a string in the shape is a free dimension."""

    name: str
    shape: tuple[int | str, ...]


@dataclass(frozen=True)
class Manifest:
    """`models/<name>/<version>/manifest.json`.

    Attributes:
        name: Of the model.
        version: Numbers and dots.
        kind: `reconstruction` or `deformation`.
        graph: File name of the ONNX graph beside the manifest; of two the one that gives the answer.
        files: Every file beside the manifest, with its sha256.
        inputs: The network's inputs.
        outputs: The network's outputs.
        grid_contract: Version of the grids it was trained on.
        condition_contract: Version of its condition vector; None for a network that takes none.
        threshold: Occupancy probability, tuned on validation, above which a voxel counts as filled.
        condition_range: Range of each condition field over the training set; outside it an answer is flagged.
        configuration: Network and training configuration, as saved in the checkpoint.
        run: Name of the training run the weights came from.
        dataset: Manifest of the data set the run was trained on.
        commit: Git commit of the code that exported the graph.
        parity: Largest absolute difference between torch and ONNX Runtime at export.
        evaluation: Figures on held-out bodies.
        encoder: File name of the graph that goes before: its inputs are the network's, its outputs are inputs of
            `graph` beside the network's other ones. None where one graph is all of the network.
        note: What whoever exported it had to say.
    """

    name: str
    version: str
    kind: str
    graph: str
    files: dict[str, str]
    inputs: tuple[TensorSpec, ...]
    outputs: tuple[TensorSpec, ...]
    grid_contract: str
    condition_contract: str | None
    threshold: float
    condition_range: dict[str, tuple[float, float]]
    configuration: dict[str, Any]
    run: str
    dataset: dict[str, Any]
    commit: str
    parity: float
    evaluation: dict[str, Any]
    encoder: str | None = None
    note: str = ""

    @property
    def graphs(self) -> tuple[str, ...]:
        """File names of the graphs, in the order in which they run."""
        return (self.graph,) if self.encoder is None else (self.encoder, self.graph)

    def to_json(self) -> dict[str, Any]:
        """Plain dictionaries and lists, ready for a JSON encoder."""
        return dataclasses.asdict(self)

    @classmethod
    def from_json(cls, document: Any) -> Manifest:
        """Inverse of `to_json`, for a document read from a file.

        Raises:
            ModelMismatch: A field is missing or unknown, the kind is unknown, or it speaks another contract.
        """
        names = {field.name for field in dataclasses.fields(cls)}
        needed = {field.name for field in dataclasses.fields(cls) if field.default is dataclasses.MISSING}
        found = set(document) if isinstance(document, dict) else set()
        if not needed <= found <= names:
            raise ModelMismatch(
                "The manifest does not have the fields this service knows; export the model again.",
                expected=sorted(needed - found), actual=", ".join(sorted(found - names)),
            )  # fmt: skip
        manifest = cls(
            **{
                **document,
                "inputs": tuple(TensorSpec(spec["name"], tuple(spec["shape"])) for spec in document["inputs"]),
                "outputs": tuple(TensorSpec(spec["name"], tuple(spec["shape"])) for spec in document["outputs"]),
                "condition_range": {
                    name: (float(low), float(high)) for name, (low, high) in document["condition_range"].items()
                },
            }
        )
        _expect("kind", " or ".join(KINDS), manifest.kind, manifest.kind in KINDS)
        _expect("grid contract", GRID_CONTRACT, manifest.grid_contract, manifest.grid_contract == GRID_CONTRACT)
        if manifest.kind == "deformation":
            found_contract = str(manifest.condition_contract)
            _expect("condition contract", CONDITION_CONTRACT, found_contract, found_contract == CONDITION_CONTRACT)
        for graph in manifest.graphs:
            if graph not in manifest.files:
                raise ModelMismatch(f"The manifest names the graph {graph} but has no digest for it.")
        return manifest


def _expect(what: str, expected: str, actual: str, holds: bool) -> None:
    if not holds:
        raise ModelMismatch(
            f"The model's {what} is {actual}, this service expects {expected}; export it again with this version.",
            expected=expected,
            actual=actual,
        )
