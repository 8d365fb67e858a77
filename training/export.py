"""From a checkpoint to a self-contained ONNX graph with its manifest, refused where it differs from torch."""

from __future__ import annotations

import copy
import hashlib
import json
import tempfile
import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import onnx
import onnxruntime
import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

from service.core.condition import CONDITION_FIELDS
from service.core.contract import CONDITION_CONTRACT, GRID_CONTRACT
from service.core.manifest import Manifest, TensorSpec
from service.core.prior_lattice import LATTICE_SIZE
from training.data.store import code_version
from training.evaluate import as_tuned
from training.networks.blocks import Stem
from training.networks.checkpoint import load_network
from training.networks.deformation import DeformationConfig, DeformationNetwork
from training.networks.reconstruction import ReconstructionNetwork, tempered

OPSET = 20
PARITY_TOLERANCE = 1e-4


Shapes: TypeAlias = dict[str, tuple[int | str, ...]]


class ExportError(Exception):
    """The model cannot be exported as asked; the message says why."""


class ReconstructionGraph(nn.Module):
    """What is served: probabilities instead of logits."""

    def __init__(self, network: ReconstructionNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, view: Float[Tensor, "1 2 64 64 64"]) -> Tensor:
        return torch.sigmoid(self.network(view))


class EncoderGraph(nn.Module):
    """What a deformation makes of a body, once for all its loads."""

    def __init__(self, network: DeformationNetwork) -> None:
        super().__init__()
        self.encoder = network.encoder

    def forward(self, rest: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        middle, coarse, mean, log_variance = self.encoder(rest)
        return middle, coarse, mean, torch.exp(0.5 * log_variance)


class GeneratorGraph(nn.Module):
    """What it makes of loads: what to add to the coarse solve's displacement; the service looks the body up through
    the sum.
    """

    def __init__(self, network: DeformationNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, *inputs: Tensor) -> Tensor:
        return self.network.generate(*inputs)


@dataclass(frozen=True)
class Tensors:
    """The tensors of a graph, by name; a string is a free dimension."""

    inputs: Shapes
    outputs: Shapes


RECONSTRUCTION_TENSORS = Tensors({"view": (1, 2, 64, 64, 64)}, {"probability": (1, 64, 64, 64)})


def deformation_tensors(config: DeformationConfig) -> tuple[Tensors, Tensors]:
    """Of the encoder, and of the generator, which takes what the encoder gives."""
    _, middle, coarse = config.channels
    latent = (1, config.latent)
    handed_on: dict[str, tuple[int | str, ...]] = {
        "middle": (1, middle, 8, 8), "coarse": (1, coarse, 4, 4), "mean": latent, "deviation": latent,
    }  # fmt: skip
    loads: dict[str, tuple[int | str, ...]] = {
        "condition": ("loads", 9), "noise": ("loads", config.latent), "prior": ("loads", 3, *(LATTICE_SIZE,) * 3),
    }  # fmt: skip
    return (
        Tensors({"rest": (1, 1, 64, 64, 64)}, handed_on),
        Tensors({**handed_on, **loads}, {"correction": ("loads", 3, *(LATTICE_SIZE,) * 3)}),
    )


@dataclass(frozen=True)
class Part:
    """One graph of a network: a file, what is in it, its tensors."""

    file: str
    graph: nn.Module
    tensors: Tensors


def export_model(
    checkpoint: Path, directory: Path, name: str, version: str, threshold: float,
    condition_range: dict[str, tuple[float, float]], evaluation: dict[str, Any], note: str = "",
) -> Manifest:  # fmt: skip
    """Write `directory/name/version/`: its graphs, manifest.json and CARD.md.

    A deformation network is two graphs, so that a body is encoded once, whatever is asked about it; it says the share
    of its correction that the evaluation was made with. A reconstruction network is as sure as it was there.

    Raises:
        ExportError: ONNX Runtime's answers differ from torch's by more than 1e-4 on random inputs.
    """
    network, state = load_network(checkpoint)
    if isinstance(network, DeformationNetwork):
        network = as_tuned(network, evaluation)
    if isinstance(network, ReconstructionNetwork):
        network = tempered(network, evaluation.get("temperature", 1.0))
    kind, parts = _parts(network)
    inputs, outputs = _outside(parts)
    folder = directory / name / version
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder) as scratch:
        for part in parts:
            _write_onnx(part, Path(scratch))
        parity = max(_difference(network, parts, Path(scratch), seed) for seed in range(3))
        if parity > PARITY_TOLERANCE:
            raise ExportError(
                f"torch and ONNX Runtime differ by {parity:.2e} (at most {PARITY_TOLERANCE:.0e}); not written"
            )
        for part in parts:
            (Path(scratch) / part.file).replace(folder / part.file)
    manifest = Manifest(
        name=name, version=version, kind=kind, graph=parts[-1].file,
        encoder=parts[0].file if len(parts) > 1 else None,
        files={},
        inputs=tuple(TensorSpec(n, s) for n, s in inputs.items()),
        outputs=tuple(TensorSpec(n, s) for n, s in outputs.items()),
        grid_contract=GRID_CONTRACT,
        condition_contract=CONDITION_CONTRACT if kind == "deformation" else None,
        threshold=threshold, condition_range=condition_range, configuration=state["config"],
        run=checkpoint.parent.name, dataset=state["dataset"], commit=code_version(), parity=parity,
        evaluation=evaluation, note=note,
    )  # fmt: skip
    return write_manifest(folder, manifest)


def write_manifest(folder: Path, manifest: Manifest) -> Manifest:
    """Write card and manifest of the graphs that lie in the folder; the manifest comes back with all digests."""
    card = folder / "CARD.md"
    card.write_text(model_card(manifest))
    names = (*manifest.graphs, card.name)
    digests = {name: hashlib.sha256((folder / name).read_bytes()).hexdigest() for name in names}
    manifest = replace(manifest, files=digests)
    (folder / "manifest.json").write_text(json.dumps(manifest.to_json(), indent=1) + "\n")
    return manifest


def condition_range_of(conditions: Float[np.ndarray, "n 9"]) -> dict[str, tuple[float, float]]:
    """Smallest and largest value of each condition field, widened by a hundredth of the range between them: a finite
    sample never reaches the bounds it was drawn from.

    Mirror images and quarter turns are part of the training, so the horizontal fields span the whole square.
    """
    ranges = {}
    for column, field in enumerate(CONDITION_FIELDS):
        low, high = float(conditions[:, column].min()), float(conditions[:, column].max())
        if field in ("contact_x", "contact_y"):
            low, high = 0.0, 1.0
        elif field.startswith("direction"):
            low, high = -1.0, 1.0
        else:
            margin = 0.01 * (high - low)
            low, high = low - margin, high + margin
        ranges[field] = (round(low, 4), round(high, 4))
    return ranges


def _parts(network: nn.Module) -> tuple[str, list[Part]]:
    """Kind of a network, and what is served of it, in the order in which it runs."""
    if isinstance(network, ReconstructionNetwork):
        return "reconstruction", [Part("model.onnx", ReconstructionGraph(network).eval(), RECONSTRUCTION_TENSORS)]
    if isinstance(network, DeformationNetwork):
        encoder, generator = deformation_tensors(network.config)
        return "deformation", [
            Part("encoder.onnx", EncoderGraph(network).eval(), encoder),
            Part("generator.onnx", GeneratorGraph(network).eval(), generator),
        ]
    raise ExportError(f"there is no served graph for a {type(network).__name__}")


def _outside(parts: list[Part]) -> tuple[Shapes, Shapes]:
    """Inputs and outputs of a network: without what its graphs hand on."""
    handed_on = {name for part in parts[:-1] for name in part.tensors.outputs}
    given = {n: shape for part in parts for n, shape in part.tensors.inputs.items() if n not in handed_on}
    return given, parts[-1].tensors.outputs


def _example(shapes: Shapes, seed: int, loads: int) -> dict[str, np.ndarray]:
    """Random but valid inputs: binary grids, a condition within its ranges."""
    rng = np.random.default_rng(seed)
    inputs: dict[str, np.ndarray] = {}
    for name, shape in shapes.items():
        size = tuple(loads if isinstance(n, str) else n for n in shape)
        if name == "condition":
            direction = rng.normal(size=(loads, 3))
            direction /= np.linalg.norm(direction, axis=1, keepdims=True)
            rest = rng.uniform([0.2, 0.2, 0.1, -3.5, 0.0, 0.08], [0.8, 0.8, 0.7, -2.0, 0.49, 0.2], (loads, 6))
            inputs[name] = np.concatenate([rest[:, :3], direction, rest[:, 3:]], axis=1).astype(np.float32)
        elif name == "noise":
            inputs[name] = rng.normal(size=size).astype(np.float32)
        else:
            inputs[name] = (rng.random(size) < 0.5).astype(np.float32)
    return inputs


def _write_onnx(part: Part, folder: Path) -> None:
    graph, tensors, path = part.graph, part.tensors, folder / part.file
    example = tuple(torch.from_numpy(a) for a in _example(tensors.inputs, seed=0, loads=2).values())
    free = {
        name: {axis: n for axis, n in enumerate(shape) if isinstance(n, str)}
        for name, shape in {**tensors.inputs, **tensors.outputs}.items()
    }
    with warnings.catch_warnings():
        # The exporter that traces is the older of torch's two. It stays as long as its graphs are checked against
        # torch below: it writes one self-contained file and needs no further library.
        warnings.filterwarnings("ignore", category=DeprecationWarning)
        # What tracing might freeze, the number of loads above all, would show in that comparison.
        warnings.filterwarnings("ignore", category=torch.jit.TracerWarning)  # type: ignore[attr-defined]
        torch.onnx.export(
            _without_norms(graph), example, str(path),
            input_names=list(tensors.inputs), output_names=list(tensors.outputs), opset_version=OPSET,
            dynamo=False, dynamic_axes={name: axes for name, axes in free.items() if axes},
        )  # fmt: skip
    model = onnx.load(str(path))
    for value in (*model.graph.input, *model.graph.output):
        # The exporter names what it cannot infer after the operator that made it; state the shape that is promised.
        for dimension, size in zip(
            value.type.tensor_type.shape.dim, (tensors.inputs | tensors.outputs)[value.name], strict=True
        ):
            if isinstance(size, str):
                dimension.dim_param = size
            else:
                dimension.dim_value = size
    onnx.checker.check_model(model, full_check=True)
    onnx.save(model, str(path))


def _without_norms(graph: nn.Module) -> nn.Module:
    """The same with normalisations in their convolutions; those of convolutions proper the exporter folds itself."""
    graph = copy.deepcopy(graph)
    for block in [module for module in graph.modules() if isinstance(module, Stem)]:
        assert isinstance(block.norm, nn.BatchNorm2d), "a graph is written once"
        block.conv = fuse_conv_bn_eval(block.conv, block.norm)
        block.norm = nn.Identity()
    return graph


def _difference(network: nn.Module, parts: list[Part], folder: Path, seed: int) -> float:
    """Largest one between the network's answer and that of its graphs, run one after the other."""
    inputs = _example(_outside(parts)[0], seed, loads=1 + seed)
    served = dict(inputs)
    for part in parts:
        session = onnxruntime.InferenceSession(str(folder / part.file), providers=["CPUExecutionProvider"])
        names = list(part.tensors.outputs)
        served |= zip(names, session.run(names, {name: served[name] for name in part.tensors.inputs}), strict=True)
    with torch.no_grad():
        answer = network.eval()(*(torch.from_numpy(a) for a in inputs.values()))
    expected = answer[0] if isinstance(network, DeformationNetwork) else torch.sigmoid(answer)
    (name,) = parts[-1].tensors.outputs
    return float(np.abs(served[name] - expected.numpy()).max())


def model_card(manifest: Manifest) -> str:
    """The card in Markdown, from the manifest alone: nothing in it is typed by hand."""
    data = manifest.dataset
    figures = {k: f"{v:.4f}" if isinstance(v, float) else v for k, v in manifest.evaluation.items()}
    rows = "\n".join(f"| {key} | {value} |" for key, value in figures.items())
    settings = {k: v for k, v in manifest.configuration.items() if k != "network"}
    return f"""# {manifest.name} {manifest.version}

A {manifest.kind} network of PhysNet, exported from run `{manifest.run}` at commit `{manifest.commit}`.
{f"{chr(10)}{manifest.note}{chr(10)}" if manifest.note else ""}
| evaluation on bodies never trained on | |
|---|---|
{rows}

Occupancy threshold: {manifest.threshold}. Largest difference between torch and ONNX Runtime at export:
{manifest.parity:.1e}.

- Network: `{json.dumps(manifest.configuration["network"])}`
- Training: `{json.dumps(settings)}`
- Data: {data["samples"]} samples in {data["groups"]} groups, `{data["digest"]}`, made at `{data["code"]}` by
  `{json.dumps(data["configuration"])}`
"""
