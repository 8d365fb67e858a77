import json
from typing import Any

import pytest

from service.core.contract import CONDITION_CONTRACT, GRID_CONTRACT
from service.core.errors import ModelMismatch
from service.core.manifest import Manifest, TensorSpec

MANIFEST = Manifest(
    name="deformation-tiny", version="0.1.0", kind="deformation", graph="model.onnx",
    files={"model.onnx": "aa", "CARD.md": "bb"},
    inputs=(TensorSpec("rest", (1, 1, 64, 64, 64)), TensorSpec("condition", ("loads", 9))),
    outputs=(TensorSpec("displacement", ("loads", 3, 64, 64, 64)),),
    grid_contract=GRID_CONTRACT, condition_contract=CONDITION_CONTRACT, threshold=0.45,
    condition_range={"poisson_ratio": (0.0, 0.49)}, configuration={"seed": 3}, run="a", dataset={"samples": 5},
    commit="abc", parity=1e-6, evaluation={"iou": 0.9},
)  # fmt: skip


def document(**changes: Any) -> dict[str, Any]:
    return {**json.loads(json.dumps(MANIFEST.to_json())), **changes}


def test_a_manifest_comes_back_from_json_as_it_was() -> None:
    assert Manifest.from_json(document()) == MANIFEST


def test_a_missing_field_is_named() -> None:
    lacking = {key: value for key, value in document().items() if key not in ("parity", "threshold")}
    with pytest.raises(ModelMismatch) as caught:
        Manifest.from_json(lacking)
    assert caught.value.expected == ["parity", "threshold"]


def test_an_unknown_field_is_named() -> None:
    with pytest.raises(ModelMismatch) as caught:
        Manifest.from_json(document(colour="red"))
    assert caught.value.actual == "colour"


@pytest.mark.parametrize("content", [[], None, "model", 3])
def test_what_is_no_manifest_at_all_is_refused(content: Any) -> None:
    with pytest.raises(ModelMismatch):
        Manifest.from_json(content)


@pytest.mark.parametrize(
    ("field", "expected"),
    [
        ("kind", "reconstruction or deformation"),
        ("grid_contract", GRID_CONTRACT),
        ("condition_contract", CONDITION_CONTRACT),
    ],
)
def test_another_kind_or_contract_is_refused_with_both_values(field: str, expected: str) -> None:
    with pytest.raises(ModelMismatch) as caught:
        Manifest.from_json(document(**{field: "77"}))
    assert caught.value.expected == expected
    assert caught.value.actual == "77"


def test_a_deformation_network_must_say_its_condition_contract() -> None:
    with pytest.raises(ModelMismatch):
        Manifest.from_json(document(condition_contract=None))


def test_a_reconstruction_network_has_no_condition_contract() -> None:
    assert Manifest.from_json(document(kind="reconstruction", condition_contract=None)).condition_contract is None


def test_a_manifest_of_one_graph_need_not_say_so() -> None:
    older = {key: value for key, value in document().items() if key not in ("encoder", "note")}
    assert Manifest.from_json(older).graphs == ("model.onnx",)


def test_of_two_graphs_both_must_have_a_digest() -> None:
    both = document(encoder="encoder.onnx", files={"encoder.onnx": "cc", **MANIFEST.files})
    assert Manifest.from_json(both).graphs == ("encoder.onnx", "model.onnx")
    with pytest.raises(ModelMismatch, match=r"encoder\.onnx but has no digest"):
        Manifest.from_json(document(encoder="encoder.onnx"))


def test_the_graph_must_have_a_digest() -> None:
    with pytest.raises(ModelMismatch, match="no digest"):
        Manifest.from_json(document(files={"CARD.md": "bb"}))
