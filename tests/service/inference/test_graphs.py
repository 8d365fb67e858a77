import json
import shutil
from pathlib import Path

import pytest

from service.core.errors import ModelMismatch
from service.inference.graph import Graph
from service.inference.graphs import open_graphs


def install(source: Path, models: Path, name: str, version: str) -> None:
    """A model under another name and version."""
    folder = shutil.copytree(source, models / name / version)
    path = folder / "manifest.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), "name": name, "version": version}))


@pytest.fixture
def directory(model_folders: dict[str, Path], tmp_path: Path) -> Path:
    for kind, folder in model_folders.items():
        install(folder, tmp_path, kind, "0.9.0")
    return tmp_path


def test_one_model_of_each_kind_is_opened(directory: Path) -> None:
    graphs = open_graphs(directory, threads=1)
    assert [(graph.manifest.kind, graph.manifest.name) for graph in graphs] == [
        ("reconstruction", "reconstruction"), ("deformation", "deformation"),
    ]  # fmt: skip


def test_the_newest_version_is_opened_by_number_not_by_letter(directory: Path, model_folders: dict[str, Path]) -> None:
    for version in ("0.10.0", "0.2.0"):
        install(model_folders["deformation"], directory, "deformation", version)
    assert [graph.manifest.version for graph in open_graphs(directory, threads=1)] == ["0.9.0", "0.10.0"]


@pytest.mark.parametrize("kind", ["reconstruction", "deformation"])
def test_a_missing_kind_is_named(kind: str, directory: Path) -> None:
    shutil.rmtree(directory / kind)
    with pytest.raises(ModelMismatch, match=f"holds no {kind} model"):
        open_graphs(directory, threads=1)


def test_an_empty_folder_holds_no_model(tmp_path: Path) -> None:
    with pytest.raises(ModelMismatch, match="holds no reconstruction model"):
        open_graphs(tmp_path / "nowhere", threads=1)


def test_two_models_of_one_kind_are_ambiguous(directory: Path, model_folders: dict[str, Path]) -> None:
    install(model_folders["deformation"], directory, "another", "0.1.0")
    with pytest.raises(ModelMismatch, match="two deformation models"):
        open_graphs(directory, threads=1)


def test_a_version_is_numbers_and_dots(directory: Path, model_folders: dict[str, Path]) -> None:
    install(model_folders["deformation"], directory, "deformation", "1.0-beta")
    with pytest.raises(ModelMismatch, match=r"1\.0-beta: a version is numbers and dots"):
        open_graphs(directory, threads=1)


def test_an_old_version_that_is_broken_does_not_matter(directory: Path, model_folders: dict[str, Path]) -> None:
    install(model_folders["deformation"], directory, "deformation", "0.1.0")
    (directory / "deformation" / "0.1.0" / "manifest.json").write_text("{")
    assert open_graphs(directory, threads=1)[1].manifest.version == "0.9.0"


def test_a_deformation_in_one_graph_is_refused(directory: Path) -> None:
    """As they were exported before 0.3.2."""
    path = directory / "deformation" / "0.9.0" / "manifest.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), "encoder": None}))
    with pytest.raises(ModelMismatch, match="not in 2 graphs"):
        open_graphs(directory, threads=1)


def test_a_model_in_a_folder_of_another_name_or_version_is_refused(directory: Path) -> None:
    (directory / "deformation" / "0.9.0").rename(directory / "deformation" / "0.9.1")
    with pytest.raises(ModelMismatch, match=r"0\.9\.1 holds deformation 0\.9\.0"):
        open_graphs(directory, threads=1)


def test_what_runs_beside_other_work_has_one_thread(directory: Path) -> None:
    reconstruction, deformation = open_graphs(directory, threads=2)
    assert [_threads(graph) for graph in (reconstruction, deformation)] == [[2], [1, 2]]


def _threads(graph: Graph) -> list[int]:
    return [session.get_session_options().intra_op_num_threads for session in graph.sessions]
