"""The served networks bare in ONNX Runtime, beside the paper's, in turns in one run.

    python -m benchmarks.networks [--repeats 5] [--threads 1]

The paper's cascade is built from the `paper` presets with random weights, which take as long as trained ones, and
exported as it is. Needs the training extra, and 3 GB of disk and 4 of memory while it runs.
"""

from __future__ import annotations

import argparse
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import onnxruntime
import torch
from torch import nn

from service.inference.registry import load_models
from service.settings import Settings
from training.configs import DEFORMATION_PRESETS, RECONSTRUCTION_PRESETS
from training.networks.build import build_deformation, build_reconstruction

LEAST_REALTIME = 20
"""Calls of each served network for one of the paper's: they are that much shorter."""


def main() -> None:
    """Print the median of each, and how many times faster the served cascade is."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=5, help="calls of each of the paper's networks")
    parser.add_argument("--threads", type=int, default=Settings().threads)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        calls = _served(given.threads) | _published(Path(scratch), given.threads)
        times: dict[str, list[float]] = {name: [] for name in calls}
        for _ in range(given.repeats):
            for name, call in calls.items():
                for _ in range(LEAST_REALTIME if name.startswith("served") else 1):
                    began = time.perf_counter()
                    call()
                    times[name].append(1e3 * (time.perf_counter() - began))
    medians = {name: float(np.median(found)) for name, found in times.items()}
    for name, ms in medians.items():
        print(f"{name:28s} {ms:9.1f} ms")
    served = sum(ms for name, ms in medians.items() if name.startswith("served"))
    published = sum(medians.values()) - served
    print(f"cascade: served {served:.1f} ms, paper {published:.0f} ms, {published / served:.0f} times")


def _served(threads: int) -> dict[str, Callable[[], object]]:
    """Both graphs on inputs of their shapes, one load."""
    calls: dict[str, Callable[[], object]] = {}
    rng = np.random.default_rng(0)
    for graph in load_models(Settings().models, threads).graphs:
        feeds = {
            tensor.name: (rng.random([1 if isinstance(n, str) else n for n in tensor.shape]) < 0.1).astype(np.float32)
            for tensor in graph.manifest.inputs
        }
        calls[f"served {graph.manifest.kind}"] = lambda run=graph.run, feeds=feeds: run(feeds)
    return calls


def _published(scratch: Path, threads: int) -> dict[str, Callable[[], object]]:
    """The paper's networks, exported without their weights being trained."""
    view, rest = torch.zeros(1, 2, 64, 64, 64), torch.zeros(1, 1, 64, 64, 64)
    physnet = DEFORMATION_PRESETS["paper"].network
    latent = physnet.latent
    condition = torch.zeros(1, 9)
    networks: dict[str, tuple[nn.Module, tuple[torch.Tensor, ...]]] = {
        "paper reconstruction": (build_reconstruction(RECONSTRUCTION_PRESETS["paper"].network), (view,)),
        "paper deformation": (build_deformation(physnet), (rest, condition, torch.zeros(1, latent))),
    }
    calls: dict[str, Callable[[], object]] = {}
    for name, (network, inputs) in networks.items():
        path = scratch / f"{name}.onnx"
        names = [f"input{i}" for i in range(len(inputs))]
        with warnings.catch_warnings(), torch.no_grad():
            warnings.simplefilter("ignore")
            torch.onnx.export(network.eval(), inputs, str(path), input_names=names, dynamo=False)
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = threads
        session = onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
        kept = {tensor.name for tensor in session.get_inputs()}  # what does not matter to the answer is left out
        feeds = {n: tensor.numpy() for n, tensor in zip(names, inputs, strict=True) if n in kept}
        calls[name] = lambda run=session.run, feeds=feeds: run(None, feeds)
    return calls


if __name__ == "__main__":
    main()
