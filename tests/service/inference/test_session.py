import dataclasses
from pathlib import Path

import numpy as np
import pytest

from service.core.errors import ModelMismatch
from service.core.manifest import TensorSpec
from service.inference.artefacts import read_manifest
from service.inference.session import open_sessions


def test_a_session_runs_on_the_processor_with_the_threads_asked_for(model_folders: dict[str, Path]) -> None:
    folder = model_folders["reconstruction"]
    (session,) = open_sessions(folder, read_manifest(folder), threads=[1])
    assert session.get_providers() == ["CPUExecutionProvider"]
    assert session.get_session_options().intra_op_num_threads == 1
    (probability,) = session.run(["probability"], {"view": np.zeros((1, 2, 64, 64, 64), np.float32)})
    assert probability.shape == (1, 64, 64, 64)


@pytest.mark.parametrize("which", ["inputs", "outputs"])
@pytest.mark.parametrize("wrong", ["name", "shape", "missing"])
def test_tensors_that_are_not_the_manifests_are_refused(
    which: str, wrong: str, model_folders: dict[str, Path]
) -> None:
    folder = model_folders["reconstruction"]
    manifest = read_manifest(folder)
    (spec,) = getattr(manifest, which)
    specs: tuple[TensorSpec, ...] = {
        "name": (dataclasses.replace(spec, name="another"),),
        "shape": (dataclasses.replace(spec, shape=(1, 32, 32, 32)),),
        "missing": (),
    }[wrong]
    with pytest.raises(ModelMismatch, match=f"the graph's {which} are not those of its manifest"):
        open_sessions(folder, dataclasses.replace(manifest, **{which: specs}), threads=[1])


def test_of_two_graphs_the_second_takes_what_the_first_gives(model_folders: dict[str, Path]) -> None:
    folder = model_folders["deformation"]
    manifest = read_manifest(folder)
    encoder, generator = open_sessions(folder, manifest, threads=[1, 2])
    assert [graph.get_session_options().intra_op_num_threads for graph in (encoder, generator)] == [1, 2]
    handed_on = {tensor.name for tensor in encoder.get_outputs()}
    assert handed_on < {tensor.name for tensor in generator.get_inputs()}
    assert not handed_on & {spec.name for spec in manifest.inputs}
    with pytest.raises(ModelMismatch, match="the graph's inputs are not those of its manifest"):
        open_sessions(folder, dataclasses.replace(manifest, encoder=None), threads=[1])
