"""Weights of a served reconstruction graph, put back into a network that can be trained further.

A checkpoint holds more than a model does: export folds batch normalisation into the convolutions, divides by a
temperature and rounds to 8-bit integers. What is served can be multiplied out again; what normalisation was taken off
is measured anew, on views, so that the network answers alike whether it normalises by its batch or by what is kept.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import torch
from jaxtyping import Float
from onnx import numpy_helper
from torch import Tensor, nn

from service.core.manifest import Manifest
from training.networks.blocks import PlaneBlock, Stem
from training.networks.reconstruction import ReconstructionNetwork

_PRODUCTS = ("Conv", "Gemm", "MatMul")

WEIGHT_RMS = 0.1
"""Of a convolution before a normalisation, which makes its scale free: about that of weights after a long training.

An optimizer's step is as long whatever the weights are. Those folded into their normalisation are down to 0.003, and
200 steps at a rate of 1e-3 left nothing of them: validation IoU 0.79 to 0.73.
"""


def take_served_weights(
    network: ReconstructionNetwork, folder: Path, views: Iterable[Float[Tensor, "batch 2 64 64 64"]]
) -> str:
    """Give a network the weights of an exported model of the same channels and blocks, in floats or in integers.

    Args:
        network: Left in evaluation.
        folder: `models/<name>/<version>`.
        views: Batches by which activations are measured; a few hundred views are enough.

    Returns:
        What was taken: the model, its version and the run that it came from.

    Raises:
        ValueError: The model is no reconstruction network of this configuration.
    """
    manifest = Manifest.from_json(json.loads((folder / "manifest.json").read_text()))
    graph = _folded(folder / manifest.graph)
    temperature = float(manifest.evaluation.get("temperature", 1.0))
    try:
        weights = _weights(graph)
        with torch.no_grad():
            _put_in(network, weights, temperature)
    except (KeyError, ValueError, RuntimeError) as error:
        raise ValueError(f"{folder} is no reconstruction network of this configuration: {error}") from error
    _normalise(network.eval(), views)
    return f"{manifest.name} {manifest.version} as it is served, of run {manifest.run}"


def _folded(path: Path) -> onnx.GraphProto:
    """The graph with its weights as constants: one in integers has them so, one in floats lays them out as it runs."""
    graph = onnx.load(str(path)).graph
    if any(node.op_type == "DequantizeLinear" for node in graph.node):
        return graph
    options = onnxruntime.SessionOptions()
    options.graph_optimization_level = onnxruntime.GraphOptimizationLevel.ORT_ENABLE_BASIC
    with tempfile.TemporaryDirectory() as scratch:
        options.optimized_model_filepath = str(Path(scratch) / "model.onnx")
        onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
        return onnx.load(options.optimized_model_filepath).graph


def _place(name: str) -> str:
    """Of a product in the graph, in the network: `/network/down.0/down.0.1/block/conv/Conv` is `down.0.1.block.conv`.

    Products outside of any module are the ones that `ReconstructionNetwork.forward` writes out itself.
    """
    parts = name.removesuffix("/MatMulAddFusion").removeprefix("/network/").split("/")
    *modules, operator = parts
    if not modules:
        return {"MatMul": "spread", "MatMul_1": "head.0"}[operator]
    nested = modules[1:] if len(modules) > 1 and modules[1].startswith(f"{modules[0]}.") else modules
    return ".".join(nested)


def _weights(graph: onnx.GraphProto) -> dict[str, tuple[Tensor, Tensor | None]]:
    """Weight and bias of every product, by its place in the network; integers are multiplied out."""
    kept = {tensor.name: numpy_helper.to_array(tensor) for tensor in graph.initializer}
    makers = {output: node for node in graph.node for output in node.output}
    added = {name: node for node in graph.node if node.op_type == "Add" for name in node.input}

    def value(name: str) -> Tensor:
        if name in kept:
            return torch.from_numpy(kept[name].copy())
        rounded, scale, zero = (kept[given].astype(np.float32) for given in makers[name].input)
        axis = next((a.i for a in makers[name].attribute if a.name == "axis"), 1)
        shape = [-1 if dimension == axis and scale.size > 1 else 1 for dimension in range(rounded.ndim)]
        return torch.from_numpy((rounded - zero.reshape(shape)) * scale.reshape(shape))

    def bias(product: onnx.NodeProto) -> Tensor | None:
        after = added.get(product.output[0])  # where a product of matrices has its own, in a graph of floats
        names = [*product.input[2:], *(name for name in (after.input if after else ()) if name in kept)]
        return value(names[0]) if names else None

    products = [node for node in graph.node if node.op_type in _PRODUCTS]
    return {_place(node.name): (value(node.input[1]), bias(node)) for node in products}


def _put_in(
    network: ReconstructionNetwork, weights: dict[str, tuple[Tensor, Tensor | None]], temperature: float
) -> None:
    """Each where it belongs, in the layout of training; normalisations do nothing but add the bias."""
    for name, module in network.named_modules():
        if isinstance(module, PlaneBlock | Stem):
            place = f"{name}.conv" if isinstance(module, PlaneBlock) else name
            weight, bias = weights[place]
            if isinstance(module, Stem):
                out, inputs, *kernel = module.conv.weight.shape
                weight = weight.T.reshape(out, *kernel, inputs).permute(0, 3, 1, 2)
            _copy(module.conv.weight, weight)
            assert isinstance(module.norm, nn.BatchNorm2d) and bias is not None
            module.norm.running_mean.zero_()  # type: ignore[union-attr]
            module.norm.running_var.fill_(1 - module.norm.eps)  # type: ignore[union-attr]
            module.norm.weight.fill_(1.0)
            _copy(module.norm.bias, bias)
    spoken = {f"up.{level}": up.conv for level, up in enumerate(network.up)} | {
        "spread": network.spread, "head.0": network.head[0]
    }  # fmt: skip
    for place, conv in spoken.items():
        weight, bias = weights[place]
        assert isinstance(conv, nn.Conv2d)
        _copy(conv.weight, _by_channel(weight.T)[..., None, None])
        if conv.bias is not None and bias is not None:
            _copy(conv.bias, _by_channel(bias))
    for place in ("seen", "detail"):
        weight, bias = weights[place]
        linear = getattr(network, place)
        _copy(linear.weight, weight.T)
        if linear.bias is not None and bias is not None:
            _copy(linear.bias, bias)
    for layer in (network.head, network.detail):
        for parameter in layer.parameters():
            parameter.mul_(temperature)


def _by_channel(spoken: Tensor) -> Tensor:
    """What a pixel says of its four parts, part by part, as PyTorch's pixel shuffle has it: channel by channel."""
    return spoken.reshape(4, -1, *spoken.shape[1:]).transpose(0, 1).flatten(0, 1)


def _copy(parameter: Tensor, given: Tensor) -> None:
    if parameter.shape != given.shape:
        raise ValueError(f"a tensor of {tuple(given.shape)} stands where {tuple(parameter.shape)} is wanted")
    parameter.copy_(given)


@torch.no_grad()
def _normalise(network: ReconstructionNetwork, views: Iterable[Float[Tensor, "batch 2 64 64 64"]]) -> None:
    """Give every normalisation the moments of what comes to it, and scale and shift that undo them.

    The convolutions before them are brought to `WEIGHT_RMS`; that is undone, too.
    """
    sums = {norm: torch.zeros(3, norm.num_features, dtype=torch.float64) for _, norm in _normalised(network)}

    def add_up(norm: nn.BatchNorm2d, given: tuple[Tensor, ...]) -> None:
        values = given[0].double().transpose(0, 1).flatten(1)
        sums[norm] += torch.stack([torch.full_like(values[:, 0], values.shape[1]), values.sum(1), (values**2).sum(1)])

    hooks = [norm.register_forward_pre_hook(add_up) for norm in sums]
    for batch in views:
        network(batch)
    for hook in hooks:
        hook.remove()
    for (conv, norm), (count, total, squares) in zip(_normalised(network), sums.values(), strict=True):
        mean = total / count
        variance = (squares / count - mean**2).clamp_min(0)
        scale = WEIGHT_RMS / conv.weight.double().square().mean().sqrt()
        conv.weight.mul_(scale)
        assert norm.running_mean is not None and norm.running_var is not None
        norm.running_mean.copy_(scale * mean)
        norm.running_var.copy_(scale**2 * variance)
        norm.weight.copy_((scale**2 * variance + norm.eps).sqrt() / scale)
        norm.bias.add_(mean.to(norm.bias.dtype))


def _normalised(network: nn.Module) -> Iterator[tuple[nn.Conv2d, nn.BatchNorm2d]]:
    """Every convolution that is normalised, with its normalisation."""
    for module in network.modules():
        if isinstance(module, PlaneBlock | Stem):
            assert isinstance(module.norm, nn.BatchNorm2d)
            yield module.conv, module.norm
