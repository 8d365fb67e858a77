"""The Open Inference Protocol, asked by its standard client, unchanged, over both of its wires."""

from __future__ import annotations

import json
import queue
from collections.abc import Iterator
from typing import Any

import httpx
import numpy as np
import pytest

from service.inference.registry import Models
from tests.conftest import LiveService
from tests.service.box_scene import BoxScene, grid

by_grpc = pytest.importorskip("tritonclient.grpc", reason="needs tritonclient[grpc,http]")
by_http = pytest.importorskip("tritonclient.http", reason="needs tritonclient[grpc,http]")
InferenceServerException = by_grpc.InferenceServerException

SCENE = BoxScene()
RNG = np.random.default_rng(3)
VIEW = (RNG.random((1, 2, 64, 64, 64)) < 0.02).astype(np.float32)
REST = np.zeros((1, 1, 64, 64, 64), np.float32)
REST[:, :, 20:44, 20:44, :30] = 1.0
PUSH = np.array([[0.5, 0.32, 0.3, 0.0, 1.0, 0.0, -2.0, 0.3, 0.1]], np.float32).repeat(2, axis=0)


@pytest.fixture(scope="module", params=["grpc", "http"])
def triton(request: pytest.FixtureRequest, live_service: LiveService) -> Iterator[tuple[Any, Any]]:
    """The client library and a client of it."""
    library = {"grpc": by_grpc, "http": by_http}[request.param]
    address = live_service.grpc if library is by_grpc else live_service.url.removeprefix("http://")
    client = library.InferenceServerClient(address)
    yield library, client
    client.close()


def inputs(library: Any, binary: bool = True, **arrays: np.ndarray) -> list[Any]:
    made = []
    for name, array in arrays.items():
        datatype = {"f": "FP32", "d": "FP64", "B": "UINT8", "?": "BOOL"}[array.dtype.char]
        one = library.InferInput(name, list(array.shape), datatype)
        if library is by_http:
            one.set_data_from_numpy(array, binary_data=binary)
        else:
            one.set_data_from_numpy(array)
        made.append(one)
    return made


def refused(call: Any, *arguments: Any, **options: Any) -> str:
    with pytest.raises(InferenceServerException) as caught:
        call(*arguments, **options)
    return str(caught.value)


def as_dict(found: Any) -> Any:
    from google.protobuf.json_format import MessageToDict

    return found if isinstance(found, dict) else MessageToDict(found, preserving_proto_field_name=True)


def push(latent: int) -> dict[str, np.ndarray]:
    prior = np.full((2, 3, 16, 16, 16), 0.01, np.float32)
    return {"rest": REST, "condition": PUSH, "noise": np.zeros((2, latent), np.float32), "prior": prior}


@pytest.fixture(scope="module")
def latent(models: Models) -> int:
    return int(models.deformation.manifest.inputs[2].shape[1])


def test_server_and_models_are_live_and_ready(triton, models):
    _, client = triton
    assert client.is_server_live()
    assert client.is_server_ready()
    for name in ("reconstruction", "deformation", "physnet"):
        assert client.is_model_ready(name)
    version = models.deformation.manifest.version
    assert client.is_model_ready("deformation", version)
    assert not client.is_model_ready("deformation", "77")
    assert not client.is_model_ready("gpt")


def test_metadata_is_that_of_the_manifests(triton, models):
    _, client = triton
    server = as_dict(client.get_server_metadata())
    assert server["name"] == "physnet"
    assert "binary_tensor_data" in server["extensions"]
    for manifest in models.manifests:
        found = as_dict(client.get_model_metadata(manifest.kind))
        assert found["versions"] == [manifest.version]
        for side in ("inputs", "outputs"):
            specs = getattr(manifest, side)
            assert [tensor["name"] for tensor in found[side]] == [spec.name for spec in specs]
            for tensor, spec in zip(found[side], specs, strict=True):
                dims = [-1 if isinstance(size, str) else size for size in spec.shape]
                assert [int(size) for size in tensor["shape"]] == dims
                assert tensor["datatype"] == "FP32"


def test_configuration_names_the_graph_and_its_tensors(triton):
    _, client = triton
    found = as_dict(client.get_model_config("deformation"))
    found = found.get("config", found)
    assert (found["name"], found["backend"]) == ("deformation", "onnxruntime")
    assert found["default_model_filename"].endswith(".onnx")
    assert [tensor["name"] for tensor in found["input"]] == ["rest", "condition", "noise", "prior"]
    assert {tensor["data_type"] for tensor in found["input"]} == {"TYPE_FP32"}
    assert [int(size) for size in found["input"][1]["dims"]] == [-1, 9]


def test_a_network_gives_what_its_graph_gives(triton, models, latent):
    library, client = triton
    seen = client.infer("reconstruction", inputs(library, view=VIEW), request_id="42")
    (expected,) = models.graphs[0].run({"view": VIEW}).values()
    # Another process with another number of threads sums in another order.
    np.testing.assert_allclose(seen.as_numpy("probability"), expected, atol=1e-5)
    response = as_dict(seen.get_response())
    assert (response["id"], response["model_version"]) == ("42", models.reconstruction.manifest.version)
    moved = client.infer("deformation", inputs(library, **push(latent)), outputs=None)
    (expected,) = models.graphs[1].run(push(latent)).values()
    assert moved.as_numpy("correction").shape == (2, 3, 16, 16, 16)
    np.testing.assert_allclose(moved.as_numpy("correction"), expected, atol=1e-5)


def test_json_and_binary_tensors_are_the_same(live_service, latent):
    with by_http.InferenceServerClient(live_service.url.removeprefix("http://")) as client:
        raw = client.infer("deformation", inputs(by_http, **push(latent)),
                           outputs=[by_http.InferRequestedOutput("correction", binary_data=True)])  # fmt: skip
        as_json = client.infer("deformation", inputs(by_http, binary=False, **push(latent)),
                               outputs=[by_http.InferRequestedOutput("correction", binary_data=False)])  # fmt: skip
    np.testing.assert_array_equal(as_json.as_numpy("correction"), raw.as_numpy("correction"))


def test_typed_contents_and_raw_ones_are_the_same(live_service, latent):
    """The client writes raw contents only; others write the typed ones."""
    import grpc
    from tritonclient.grpc import service_pb2, service_pb2_grpc

    request = service_pb2.ModelInferRequest(model_name="deformation")
    for name, array in push(latent).items():
        one = request.inputs.add(name=name, datatype="FP32", shape=array.shape)
        one.contents.fp32_contents.extend(array.ravel())
    with grpc.insecure_channel(live_service.grpc, [("grpc.max_receive_message_length", -1)]) as channel:
        typed = service_pb2_grpc.GRPCInferenceServiceStub(channel).ModelInfer(request, timeout=30)
    client = by_grpc.InferenceServerClient(live_service.grpc)
    raw = client.infer("deformation", inputs(by_grpc, **push(latent))).as_numpy("correction")
    client.close()
    np.testing.assert_array_equal(np.frombuffer(typed.raw_output_contents[0], "<f4").reshape(raw.shape), raw)


def cascade() -> dict[str, np.ndarray]:
    load = SCENE.request()["loads"][0]
    camera = SCENE.camera
    return {
        "depth_m": SCENE.render()[0].astype(np.float32),
        "intrinsics_px": np.array([camera[name] for name in ("fx", "fy", "cx", "cy")]),
        "material": np.array([1e5, 0.45]),
        "contact_m": np.array([load["contact_m"]] * 2),
        "force_n": np.array([load["force_n"], np.zeros(3)]),
    }


def test_the_cascade_gives_what_our_own_api_gives(triton, live_service):
    library, client = triton
    found = client.infer("physnet", inputs(library, **cascade()))
    load = SCENE.request()["loads"][0]
    body = SCENE.request(
        depth={"encoding": "32FC1", "data": by_base64(cascade()["depth_m"])},
        loads=[load, load | {"force_n": [0.0, 0.0, 0.0]}],
    )
    reply = httpx.post(f"{live_service.url}/v1/deform", json=body, timeout=30).json()
    np.testing.assert_array_equal(found.as_numpy("reconstruction"), grid(reply["reconstruction"]))
    for index, load in enumerate(reply["loads"]):
        np.testing.assert_array_equal(found.as_numpy("deformed")[index], grid(load["deformed"]))
        assert found.as_numpy("max_displacement_m")[index] == load["max_displacement_m"]
    assert found.as_numpy("voxel_size_m")[0] == reply["grid"]["voxel_size_m"]
    np.testing.assert_array_equal(found.as_numpy("camera_from_grid"), reply["grid"]["camera_from_grid"])
    assert found.as_numpy("flags").shape == (2,)
    one = client.infer("physnet", inputs(library, **cascade()), outputs=[library.InferRequestedOutput("load_number")])
    assert one.as_numpy("deformed") is None
    assert one.as_numpy("load_number")[0] == reply["loads"][0]["load_number"]


def by_base64(array: np.ndarray) -> str:
    from tests.service.box_scene import b64

    return b64(array.tobytes())


def test_an_unknown_model_or_version(triton):
    library, client = triton
    view = inputs(library, view=VIEW)
    for call, arguments in (
        (client.infer, ("gpt", view)),
        (client.get_model_metadata, ("gpt",)),
        (client.get_model_config, ("gpt",)),
        (client.get_inference_statistics, ("gpt",)),
    ):
        assert "no model `gpt`" in refused(call, *arguments)
    assert "no version 77" in refused(client.infer, "reconstruction", view, model_version="77")


def test_a_wrong_tensor_is_told(triton, latent):
    library, client = triton

    def asked(name: str = "deformation", **changes: Any) -> str:
        arrays = {key: value for key, value in (push(latent) | changes).items() if value is not None}
        return refused(client.infer, name, inputs(library, **arrays))

    assert "`rest` has another shape" in asked(rest=REST[..., :63].copy())
    assert "`noise` has another shape" in asked(noise=np.zeros((3, latent), np.float32))
    assert "`condition` is of datatype FP32" in asked(condition=PUSH.astype(np.float64))
    assert "`noise` is missing" in asked(noise=None)
    assert "no input `mass`" in asked(mass=PUSH)
    many = {name: array.repeat(150, axis=0) for name, array in push(latent).items() if name != "rest"}
    assert "this service takes" in asked(**many)
    wrong = library.InferRequestedOutput("stress")
    assert "no output `stress`" in refused(
        client.infer, "deformation", inputs(library, **push(latent)), outputs=[wrong]
    )
    assert client.infer("deformation", inputs(library, **push(latent))).as_numpy("correction") is not None


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"material": np.array([0.0, 0.3])}, "Young"),
        ({"force_n": np.full((2, 3), np.nan)}, "finite"),
        ({"contact_m": np.full((2, 3), 9.0)}, "contact"),
        ({"depth_m": np.zeros((240, 320), np.float32)}, "no valid reading"),
    ],
)
def test_errors_of_the_cascade_are_those_of_our_own_api(triton, changes, words):
    library, client = triton
    assert words in refused(client.infer, "physnet", inputs(library, **(cascade() | changes)))


def test_statistics_count_what_was_asked(triton, latent):
    library, client = triton

    def counted() -> dict[str, Any]:
        return as_dict(client.get_inference_statistics("deformation"))["model_stats"][0]

    before = counted()
    client.infer("deformation", inputs(library, **push(latent)))
    refused(client.infer, "deformation", inputs(library, rest=REST))
    after = counted()
    assert int(after["inference_count"]) == int(before["inference_count"]) + 1
    for outcome in ("success", "fail"):
        then, now = (int(found["inference_stats"][outcome].get("count", 0)) for found in (before, after))
        assert now == then + 1
    assert int(after["inference_stats"]["compute_infer"]["ns"]) > int(before["inference_stats"]["compute_infer"]["ns"])
    everything = as_dict(client.get_inference_statistics())["model_stats"]
    assert {model["name"] for model in everything} == {"reconstruction", "deformation", "physnet"}


def test_a_stream_answers_in_order_and_outlives_an_error(live_service, latent):
    answers: queue.Queue[tuple[Any, Any]] = queue.Queue()
    client = by_grpc.InferenceServerClient(live_service.grpc)
    client.start_stream(callback=lambda result, error: answers.put((result, error)))
    good = inputs(by_grpc, **push(latent))
    client.async_stream_infer("deformation", good, request_id="1")
    client.async_stream_infer("gpt", good, request_id="2")
    client.async_stream_infer("deformation", good, request_id="3")
    found = [answers.get(timeout=30) for _ in range(3)]
    client.stop_stream()
    client.close()
    assert [error is None for _, error in found] == [True, False, True]
    assert "no model `gpt`" in str(found[1][1])
    for (result, _), number in zip(found[::2], "13", strict=True):
        assert result.get_response().id == number
        assert result.get_response().parameters["triton_final_response"].bool_param
        assert result.as_numpy("correction").shape == (2, 3, 16, 16, 16)


def test_a_call_of_the_published_interface_that_is_not_served(live_service):
    client = by_grpc.InferenceServerClient(live_service.grpc)
    assert "UNIMPLEMENTED" in refused(client.load_model, "deformation")
    client.close()


@pytest.mark.parametrize(
    ("headers", "content", "field"),
    [
        ({}, b"{", None),
        ({}, b'{"inputs": [{"name": "view"}]}', "inputs[0].datatype"),
        ({"Inference-Header-Content-Length": "99"}, b"{}", "Inference-Header-Content-Length"),
        ({"Inference-Header-Content-Length": "-1"}, b"{}", "Inference-Header-Content-Length"),
    ],
)
def test_a_body_that_is_none_is_refused_with_the_protocols_error(live_service, headers, content, field):
    reply = httpx.post(f"{live_service.url}/v2/models/reconstruction/infer", content=content, headers=headers)
    document = reply.json()
    assert reply.status_code == 400
    assert document["error"] == document["detail"]
    assert (document["code"], document.get("field")) == ("invalid_request", field)


def test_binary_data_that_is_cut_short_is_refused(live_service):
    header = json.dumps(
        {"inputs": [{"name": "view", "datatype": "FP32", "shape": [1, 2, 64, 64, 64],
                     "parameters": {"binary_data_size": VIEW.nbytes}}]}
    ).encode()  # fmt: skip
    headers = {"Inference-Header-Content-Length": str(len(header))}
    url = f"{live_service.url}/v2/models/reconstruction/infer"
    for body in (VIEW.tobytes()[:-4], VIEW.tobytes() + b"more"):
        assert httpx.post(url, content=header + body, headers=headers, timeout=10).status_code == 400
    assert httpx.post(url, content=header + VIEW.tobytes(), headers=headers, timeout=10).status_code == 200


def test_every_message_is_the_published_one():
    """Each field that we define has the name, number and type it has in NVIDIA's published client."""
    from google.protobuf.descriptor_pb2 import FileDescriptorProto
    from tritonclient.grpc import model_config_pb2, service_pb2

    from service.api import oip_messages
    from tests.contract.test_proto import walk

    published: dict[str, Any] = {}
    for module in (service_pb2, model_config_pb2):
        published |= dict(walk(FileDescriptorProto.FromString(module.DESCRIPTOR.serialized_pb)))
    ours = dict(walk(FileDescriptorProto.FromString(oip_messages.FILE_BYTES)))
    assert len(ours) > 100
    for path, promise in ours.items():
        assert published[path] == promise, path
