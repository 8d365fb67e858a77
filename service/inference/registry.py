"""The models a service runs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from service.core.manifest import Manifest
from service.inference.deformation import DeformationModel
from service.inference.graph import Graph
from service.inference.graphs import open_graphs
from service.inference.reconstruction import ReconstructionModel
from service.inference.spare_cores import SpareCores


@dataclass(frozen=True)
class Models:
    """One network of each kind, and both as they are."""

    reconstruction: ReconstructionModel
    deformation: DeformationModel
    graphs: tuple[Graph, ...] = ()

    @property
    def manifests(self) -> tuple[Manifest, ...]:
        return self.reconstruction.manifest, self.deformation.manifest


def load_models(directory: Path, threads: int, cores: int = 1) -> Models:
    """Open the models of a folder, see `open_graphs` and `models_of`.

    Raises:
        ModelMismatch: A kind is missing or twice there, or a model does not fit its manifest or this service.
    """
    return models_of(open_graphs(directory, threads), cores)


def models_of(graphs: tuple[Graph, ...], cores: int = 1) -> Models:
    """The models that run opened networks, one of each kind.

    Args:
        graphs: As `open_graphs` gives them.
        cores: With two or more, what a question need not do in turn is done on two at once.
    """
    seen, pushed = graphs
    (network,), (encoder, generator) = seen.sessions, pushed.sessions
    return Models(
        reconstruction=ReconstructionModel(network, seen.manifest),
        deformation=DeformationModel(encoder, generator, pushed.manifest, SpareCores(cores - 1)),
        graphs=graphs,
    )
