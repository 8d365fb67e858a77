import json
import shutil
from pathlib import Path

import pytest

from service.core.errors import ModelMismatch
from service.inference.artefacts import read_manifest


@pytest.fixture
def folder(model_folders: dict[str, Path], tmp_path: Path) -> Path:
    """A copy that a test may spoil."""
    return Path(shutil.copytree(model_folders["reconstruction"], tmp_path / "model"))


def change(folder: Path, **changes: object) -> None:
    path = folder / "manifest.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **changes}))


def test_shipped_models_fit_their_manifests(model_folders: dict[str, Path]) -> None:
    for kind, folder in model_folders.items():
        manifest = read_manifest(folder)
        assert manifest.kind == kind
        assert {*manifest.graphs, "CARD.md"} == set(manifest.files)


def test_one_changed_byte_is_found(folder: Path) -> None:
    graph = folder / read_manifest(folder).graph
    content = bytearray(graph.read_bytes())
    content[len(content) // 2] ^= 1
    graph.write_bytes(content)
    with pytest.raises(ModelMismatch, match="not the file that was exported") as caught:
        read_manifest(folder)
    assert caught.value.expected != caught.value.actual
    assert len(str(caught.value.actual)) == 64


def test_a_missing_file_is_named(folder: Path) -> None:
    graph = read_manifest(folder).graph
    (folder / graph).unlink()
    with pytest.raises(ModelMismatch, match=f"{graph} is missing"):
        read_manifest(folder)


def test_a_folder_without_a_manifest_is_named(tmp_path: Path) -> None:
    with pytest.raises(ModelMismatch, match=r"has no manifest\.json"):
        read_manifest(tmp_path)


@pytest.mark.parametrize("content", [b"", b"{", b"[]", b"\xff\xfe\x00", b'{"name": 1}'])
def test_a_manifest_that_cannot_be_read_is_named(folder: Path, content: bytes) -> None:
    (folder / "manifest.json").write_bytes(content)
    with pytest.raises(ModelMismatch, match=r"manifest\.json"):
        read_manifest(folder)


@pytest.mark.parametrize("inputs", [[{}], [{"name": "view"}], "view", [["view", 3]], None])
def test_tensors_that_are_not_described_are_refused(folder: Path, inputs: object) -> None:
    change(folder, inputs=inputs)
    with pytest.raises(ModelMismatch, match=r"manifest\.json"):
        read_manifest(folder)


def test_another_grid_contract_is_refused_with_the_file(folder: Path) -> None:
    change(folder, grid_contract="0")
    with pytest.raises(ModelMismatch, match=r"manifest\.json.*grid contract is 0"):
        read_manifest(folder)
