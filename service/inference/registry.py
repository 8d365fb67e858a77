"""The models a service runs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from service.core.manifest import Manifest
from service.inference.deformation import DeformationModel
from service.inference.graph import Graph
from service.inference.graphs import open_graphs
from service.inference.reconstruction import ReconstructionModel


@dataclass(frozen=True)
class Models:
    """One network of each kind, and both as they are."""

    reconstruction: ReconstructionModel
    deformation: DeformationModel
    graphs: tuple[Graph, ...] = ()

    @property
    def manifests(self) -> tuple[Manifest, ...]:
        return self.reconstruction.manifest, self.deformation.manifest


def load_models(directory: Path, threads: int) -> Models:
    """Open the models of a folder, see `open_graphs`.

    Raises:
        ModelMismatch: A kind is missing or twice there, or a model does not fit its manifest or this service.
    """
    return models_of(open_graphs(directory, threads))


def models_of(graphs: tuple[Graph, ...]) -> Models:
    """The models that run opened networks, one of each kind."""
    seen, pushed = graphs
    return Models(
        reconstruction=ReconstructionModel(seen.session, seen.manifest),
        deformation=DeformationModel(pushed.session, pushed.manifest),
        graphs=graphs,
    )
