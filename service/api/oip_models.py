"""What is served by the Open Inference Protocol: both networks as they are, and the cascade of them, `physnet`."""

from __future__ import annotations

import time
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from service.api.handler import Handler
from service.api.oip_tensors import Given, Tensor, read_inputs
from service.core.camera import make_intrinsics, parse_up
from service.core.errors import InvalidRequest, Overloaded, UnknownModel
from service.core.grids import Grid
from service.core.manifest import TensorSpec
from service.core.materials import material
from service.core.messages import DeformRequest, DeformResult, EncodedImage, Load, Observation
from service.inference.graph import Graph
from service.scheduler import Answer

CASCADE = "physnet"

Arrays = dict[str, np.ndarray]


@dataclass
class Statistics:
    """Since the start: counts, and sums in nanoseconds."""

    success: int = 0
    fail: int = 0
    success_ns: int = 0
    fail_ns: int = 0
    queue_ns: int = 0
    infer_ns: int = 0
    last_ms: int = 0


@dataclass(frozen=True)
class Model:
    """A model of the protocol.

    Attributes:
        infer: From the inputs and the deadline to every output; runs in a worker's turn.
    """

    name: str
    version: str
    platform: str
    filename: str
    inputs: tuple[Tensor, ...]
    outputs: tuple[Tensor, ...]
    infer: Callable[[Arrays, float], Awaitable[Answer[Arrays]]]
    statistics: Statistics = field(default_factory=Statistics)


@dataclass(frozen=True)
class Inference:
    """The answer of a model: those of its outputs that were asked for, in that order."""

    model: Model
    outputs: list[tuple[Tensor, np.ndarray]]


class Models:
    """Every model that is served, by its name.

    Args:
        handler: Gives the workers' turns.
        max_loads: Most loads, that is, elements of a free dimension of a network.
    """

    def __init__(self, handler: Handler, max_loads: int) -> None:
        self._handler = handler
        self._max_loads = max_loads
        self._models: dict[str, Model] = {}

    @property
    def ready(self) -> bool:
        return self._handler.ready

    def all(self) -> Mapping[str, Model]:
        """The models; none before they are loaded."""
        if not self._models and self._handler.graphs:
            graphs = [self._network(graph) for graph in self._handler.graphs]
            self._models = {model.name: model for model in (*graphs, self._cascade())}
        return self._models

    def find(self, name: str, version: str = "") -> Model:
        """A model; an empty version is the one served.

        Raises:
            Overloaded: The models are still being loaded.
            UnknownModel: None has that name and version.
        """
        if not self.ready:
            raise Overloaded("The models are still being loaded; try again in a second.", retry_after_s=1.0)
        model = self.all().get(name)
        if model is None:
            raise UnknownModel(
                f"There is no model `{name[:80]}`.", field="model_name", expected=sorted(self.all()), actual=name[:80]
            )
        if version not in ("", model.version):
            raise UnknownModel(
                f"`{name}` has no version {version[:40]}.",
                field="model_version", expected=model.version, actual=version[:40],
            )  # fmt: skip
        return model

    async def infer(
        self, name: str, version: str, given: Sequence[Given], wanted: Sequence[str], deadline: float
    ) -> Inference:
        """Answer with the outputs that are wanted, all where none is named.

        Raises:
            PhysNetError: What is wrong with the request, or that it cannot be answered now.
        """
        model = self.find(name, version)
        began = time.perf_counter_ns()
        try:
            known = {tensor.name: tensor for tensor in model.outputs}
            for output in wanted:
                if output not in known:
                    raise InvalidRequest(
                        f"The model has no output `{output[:80]}`.",
                        field=f"outputs[{output[:80]}]", expected=sorted(known), actual=output[:80],
                    )  # fmt: skip
            answer = await model.infer(read_inputs(given, model.inputs), deadline)
        except BaseException:
            model.statistics.fail += 1
            model.statistics.fail_ns += time.perf_counter_ns() - began
            raise
        took_ns, queue_ns = time.perf_counter_ns() - began, round(1e9 * answer.queued_s)
        model.statistics.success += 1
        model.statistics.success_ns += took_ns
        model.statistics.queue_ns += queue_ns
        model.statistics.infer_ns += max(0, took_ns - queue_ns)
        model.statistics.last_ms = time.time_ns() // 1_000_000
        outputs = [(known[output], answer.result[output]) for output in wanted or known]
        return Inference(model, outputs)

    def _network(self, graph: Graph) -> Model:
        manifest = graph.manifest

        async def infer(arrays: Arrays, deadline: float) -> Answer[Arrays]:
            loads = max(arrays[tensor.name].shape[0] for tensor in inputs)
            if loads > self._max_loads:
                raise InvalidRequest(
                    "More elements of the free dimension than this service takes.",
                    field="inputs", expected=f"at most {self._max_loads}", actual=loads,
                )  # fmt: skip
            return await self._handler.call(partial(graph.run, arrays), deadline)

        inputs, outputs = (
            tuple(Tensor("FP32", spec) for spec in specs) for specs in (manifest.inputs, manifest.outputs)
        )
        return Model(manifest.kind, manifest.version, "onnxruntime_onnx", manifest.graph, inputs, outputs, infer)

    def _cascade(self) -> Model:
        async def infer(arrays: Arrays, deadline: float) -> Answer[Arrays]:
            answer = await self._handler.deform(_question(arrays, self._max_loads), deadline)
            return Answer(_arrays(answer.result), answer.queued_s)

        # What the cascade is changes with either network, so its version names both.
        version = "+".join(graph.manifest.version for graph in self._handler.graphs)
        return Model(CASCADE, version, "physnet", "", CASCADE_INPUTS, CASCADE_OUTPUTS, infer)


def _tensor(datatype: str, name: str, *shape: int | str, optional: bool = False) -> Tensor:
    return Tensor(datatype, TensorSpec(name, shape), optional)


CASCADE_INPUTS = (
    _tensor("FP32", "depth_m", "height", "width"),
    _tensor("FP64", "intrinsics_px", 4),
    _tensor("FP64", "material", 2),
    _tensor("FP64", "contact_m", "n", 3),
    _tensor("FP64", "force_n", "n", 3),
    _tensor("FP64", "patch_radius_m", "n", optional=True),
    _tensor("FP64", "up", 3, optional=True),
    _tensor("FP64", "distortion", "coefficients", optional=True),
)
"""Depth in metres, 0 or NaN where there is no reading; fx, fy, cx, cy; Young's modulus in Pa and Poisson's ratio."""

CASCADE_OUTPUTS = (
    _tensor("BOOL", "reconstruction", 64, 64, 64),
    _tensor("BOOL", "deformed", "n", 64, 64, 64),
    _tensor("FP32", "displacement_m", "n", 3, 64, 64, 64),
    _tensor("FP64", "voxel_size_m", 1),
    _tensor("FP64", "camera_from_grid", 4, 4),
    _tensor("FP64", "max_displacement_m", "n"),
    _tensor("FP64", "load_number", "n"),
    _tensor("BYTES", "flags", "n"),
)
"""As in the reply of `POST /v1/deform`; `flags` are those of the frame and of the load, separated by commas."""


def _question(arrays: Arrays, max_loads: int) -> DeformRequest:
    depth_m, forces, contacts = arrays["depth_m"], arrays["force_n"], arrays["contact_m"]
    if len(forces) > max_loads:
        raise InvalidRequest(
            f"A request may carry {max_loads} loads; send the others in further requests.",
            field="inputs[force_n]", expected=f"at most {max_loads}", actual=len(forces),
        )  # fmt: skip
    for name in ("force_n", "contact_m", "patch_radius_m"):
        least = 0.0 if name == "patch_radius_m" else -np.inf
        # A NaN is not greater than anything either.
        if name in arrays and not ((arrays[name] > least) & (arrays[name] < np.inf)).all():
            raise InvalidRequest(
                f"`{name}` must hold finite numbers, and a radius is positive.", field=f"inputs[{name}].data",
                expected="> 0" if name == "patch_radius_m" else "finite",
            )  # fmt: skip
    height, width = depth_m.shape
    fx, fy, cx, cy = arrays["intrinsics_px"].tolist()
    distortion = arrays["distortion"].tolist() if "distortion" in arrays else None
    radii = arrays["patch_radius_m"].tolist() if "patch_radius_m" in arrays else [None] * len(forces)
    young_modulus_pa, poisson_ratio = arrays["material"].tolist()
    return DeformRequest(
        source=Observation(
            make_intrinsics(fx, fy, cx, cy, width, height, distortion),
            EncodedImage("32FC1", depth_m.tobytes()),
            up=parse_up(tuple(arrays["up"].tolist())) if "up" in arrays else None,
        ),
        material=material(young_modulus_pa, poisson_ratio),
        loads=tuple(
            Load(force, contact, None, radius) for force, contact, radius in zip(forces, contacts, radii, strict=True)
        ),
    )


def _arrays(result: DeformResult) -> Arrays:
    grid: Grid = result.grid
    loads = result.loads
    return {
        "reconstruction": result.reconstruction,
        "deformed": np.stack([load.deformed for load in loads]),
        "displacement_m": np.stack([load.displacement_m for load in loads]),
        "voxel_size_m": np.array([grid.pitch_m]),
        "camera_from_grid": grid.camera_from_grid,
        "max_displacement_m": np.array([load.max_displacement_m for load in loads]),
        "load_number": np.array([load.load_number for load in loads]),
        "flags": np.array([",".join(sorted(result.flags | load.flags)) for load in loads]),
    }
