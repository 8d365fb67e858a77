"""The gRPC wire over a real socket, around a predictor without networks: what surrounds a call."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from typing import Any

import grpc
import httpx
import pytest
from google.protobuf.descriptor_pool import DescriptorPool
from google.rpc import error_details_pb2
from grpc_health.v1 import health_pb2, health_pb2_grpc
from grpc_reflection.v1alpha.proto_reflection_descriptor_database import ProtoReflectionDescriptorDatabase
from grpc_status import rpc_status

from service.api.generated import deformation_pb2 as pb
from service.core.errors import ContactOffBody
from tests.service import rpc_client
from tests.service.box_scene import BoxScene
from tests.service.fakes import FakePredictor, Running, running
from tests.service.waiting import metric, queue_depth, until

SCENE = BoxScene(width=64, height=48, focal_px=60.0)


def react(request: Any) -> None:
    if request.material.young_modulus_pa == 666.0:
        raise RuntimeError("a bug that knows /etc/passwd")
    if request.material.young_modulus_pa == 404.0:
        raise ContactOffBody("Too far.", field="loads[0].contact_m", expected=0.02, actual=0.5)


@pytest.fixture(scope="module")
def service() -> Iterator[Running]:
    with running(FakePredictor(react), max_body_bytes=100_000, max_loads=4) as service:
        yield service


@pytest.fixture(scope="module")
def channel(service: Running) -> Iterator[grpc.Channel]:
    with grpc.insecure_channel(service.grpc, rpc_client.LIMITS) as channel:
        yield channel


@pytest.fixture(scope="module")
def client(channel: grpc.Channel) -> Any:
    return rpc_client.stub(channel)


def question(**changes: Any) -> pb.DeformRequest:
    return rpc_client.message(SCENE.request(**changes))


def material(young_modulus_pa: float) -> pb.DeformRequest:
    return question(material={"young_modulus_pa": young_modulus_pa, "poisson_ratio": 0.3})


def failed(call: Any, *arguments: Any, **options: Any) -> grpc.RpcError:
    with pytest.raises(grpc.RpcError) as caught:
        call(*arguments, **{"timeout": 10} | options)
    return caught.value


def details(error: grpc.RpcError, kind: Any) -> Any:
    found = kind()
    (packed,) = [detail for detail in rpc_status.from_call(error).details if detail.Is(kind.DESCRIPTOR)]
    packed.Unpack(found)
    return found


def counted(service: Running, route: str, code: str) -> float:
    name = f'physnet_requests_total{{code="{code}",route="/physnet.v1.DeformationService/{route}",wire="grpc"}}'
    return metric(service.url, name)


def test_an_answer_is_counted_and_carries_the_callers_id(service, client):
    before = counted(service, "Deform", "ok")
    response, call = client.Deform.with_call(question(), metadata=[("x-request-id", "robot-7/frame:12")])
    assert response.request_id == dict(call.trailing_metadata())["x-request-id"] == "robot-7/frame:12"
    assert response.timing_ms["decode"] == 1.0
    assert counted(service, "Deform", "ok") == before + 1
    other = client.Deform(question(), metadata=[("x-request-id", "a b")])
    assert len(other.request_id) == 32


def test_an_error_carries_the_standard_details(client):
    error = failed(client.Deform, material(404.0), metadata=[("x-request-id", "find-me")])
    assert error.code() == grpc.StatusCode.INVALID_ARGUMENT
    problem = details(error, pb.Problem)
    assert (problem.code, problem.field, problem.request_id) == ("contact_off_body", "loads[0].contact_m", "find-me")
    assert (problem.expected.number_value, problem.actual.number_value) == (0.02, 0.5)
    (violation,) = details(error, error_details_pb2.BadRequest).field_violations
    assert (violation.field, violation.description) == ("loads[0].contact_m", "Too far.")
    info = details(error, error_details_pb2.ErrorInfo)
    assert (info.reason, info.domain) == ("CONTACT_OFF_BODY", "physnet")
    assert dict(info.metadata) == {"expected": "0.02", "actual": "0.5"}
    assert details(error, error_details_pb2.RequestInfo).request_id == "find-me"


def test_a_bug_gives_nothing_away_and_costs_no_other_call(client, caplog):
    error = failed(client.Deform, material(666.0), metadata=[("x-request-id", "bug-1")])
    assert error.code() == grpc.StatusCode.INTERNAL
    assert details(error, pb.Problem).code == "internal"
    assert "passwd" not in str(error) + str(rpc_status.from_call(error))
    assert any("bug-1" in record.message and "passwd" in str(record.exc_info[1]) for record in caplog.records)
    assert client.Deform(question()).loads[0].max_displacement_m == 0.003


def test_a_number_that_no_encoding_has_is_refused_as_an_unknown_name_is(service, client):
    request = question()
    request.depth.encoding = 99
    client.Deform(request)
    assert service.predictor.asked[-1].source.depth.encoding == "99"
    request.depth.encoding = pb.DEPTH_ENCODING_COMPRESSED_DEPTH
    request.depth.ros_format = "32FC1; compressedDepth rvl"
    client.Deform(request)
    assert service.predictor.asked[-1].source.depth.encoding == "32FC1; compressedDepth rvl"


def test_a_pose_of_nine_numbers_is_refused(client):
    request = pb.DeformRequest(
        material=pb.Material(name="silicone"),
        shape=pb.KnownShape(data=bytes(32768), voxel_size_m=0.003, camera_from_grid=[0.0] * 9),
        loads=[pb.Load(force_n=pb.Vector3(z=1.0), contact_m=pb.Vector3())],
    )
    problem = details(failed(client.Deform, request), pb.Problem)
    assert problem.code == "invalid_request"
    assert problem.field.startswith("shape.camera_from_grid")


def test_a_message_beyond_the_limit_is_refused_and_the_channel_lives(client):
    request = question()
    request.depth.data = bytes(200_000)
    error = failed(client.Deform, request)
    assert error.code() == grpc.StatusCode.RESOURCE_EXHAUSTED
    assert "100000" in error.details()
    assert client.Deform(question()).request_id


def test_bytes_that_are_no_message_are_refused_and_the_channel_lives(channel, client):
    raw = channel.unary_unary("/physnet.v1.DeformationService/Deform")
    error = failed(raw, question().SerializeToString()[:-7])
    assert error.code() == grpc.StatusCode.INVALID_ARGUMENT
    assert details(error, pb.Problem).code == "invalid_request"
    stream = channel.stream_stream("/physnet.v1.DeformationService/DeformStream")
    with pytest.raises(grpc.RpcError) as caught:
        next(stream(iter([b"\x12\x7fgarbage"]), timeout=10))
    assert caught.value.code() == grpc.StatusCode.INVALID_ARGUMENT
    assert details(caught.value, pb.Problem).code == "invalid_request"
    assert client.Deform(question()).request_id


def test_an_unknown_method_is_unimplemented(channel):
    error = failed(channel.unary_unary("/physnet.v1.DeformationService/Explode"), b"")
    assert error.code() == grpc.StatusCode.UNIMPLEMENTED


def test_an_unknown_model_is_told_the_known(client):
    error = failed(client.GetModel, pb.GetModelRequest(name="gpt"))
    assert error.code() == grpc.StatusCode.NOT_FOUND
    problem = details(error, pb.Problem)
    assert (problem.code, problem.field) == ("unknown_model", "name")
    assert [value.string_value for value in problem.expected.list_value.values] == ["fake"]


def test_a_deadline_already_past_computes_nothing(service, client):
    asked = len(service.predictor.asked)
    error = failed(client.Deform, question(), timeout=1e-6)
    assert error.code() == grpc.StatusCode.DEADLINE_EXCEEDED
    client.Deform(question())
    assert len(service.predictor.asked) == asked + 1


def test_a_call_cancelled_or_past_its_deadline_frees_its_place():
    gate, entered = threading.Event(), threading.Event()

    def hold(_: Any) -> None:
        entered.set()
        assert gate.wait(10)

    with running(FakePredictor(hold), queue_size=1) as service, grpc.insecure_channel(service.grpc) as channel:
        client = rpc_client.stub(channel)
        first = client.Deform.future(question(), timeout=20)
        assert entered.wait(10)
        cancelled = client.Deform.future(question(), timeout=20)
        assert until(lambda: queue_depth(service.url) == 1)
        refused = failed(client.Deform, question())
        assert refused.code() == grpc.StatusCode.UNAVAILABLE
        problem = details(refused, pb.Problem)
        assert problem.code == "overloaded"
        assert problem.retry_after_s > 0.0
        retry = details(refused, error_details_pb2.RetryInfo).retry_delay
        assert retry.ToNanoseconds() == pytest.approx(problem.retry_after_s * 1e9, abs=1)
        cancelled.cancel()
        assert until(lambda: queue_depth(service.url) == 0), "a cancelled call kept its place in the queue"
        late = client.Deform.future(question(), timeout=2.0)
        assert until(lambda: queue_depth(service.url) == 1)
        assert until(lambda: queue_depth(service.url) == 0), "a call past its deadline kept its place in the queue"
        assert late.code() == grpc.StatusCode.DEADLINE_EXCEEDED
        gate.set()
        assert first.result(timeout=10).request_id
    assert len(service.predictor.asked) == 1


def test_a_token_is_asked_for_where_one_is_set():
    with running(FakePredictor(), token="s3cret") as service, grpc.insecure_channel(service.grpc) as channel:
        client = rpc_client.stub(channel)
        for metadata in ([], [("authorization", "Bearer wrong")], [("authorization", "Basic s3cret")]):
            error = failed(client.Deform, question(), metadata=metadata)
            assert error.code() == grpc.StatusCode.UNAUTHENTICATED
            assert details(error, pb.Problem).code == "unauthenticated"
        stream = client.DeformStream(iter([pb.DeformStreamRequest(request=question())]), timeout=10)
        with pytest.raises(grpc.RpcError) as caught:
            next(stream)
        assert caught.value.code() == grpc.StatusCode.UNAUTHENTICATED
        assert client.Deform(question(), metadata=[("authorization", "Bearer s3cret")]).request_id
        assert httpx.get(f"{service.url}/v2/models/stats").status_code == 401
        assert httpx.get(f"{service.url}/v2/health/live").status_code == 200
        # Probes carry no token.
        health_pb2_grpc.HealthStub(channel).Check(health_pb2.HealthCheckRequest())
    assert len(service.predictor.asked) == 1


def test_it_is_serving_only_once_the_models_are_warm(monkeypatch):
    from service.api import rpc_server

    ports: list[int] = []
    real = rpc_server.GrpcServer.start

    async def start(self: Any) -> int:
        ports.append(await real(self))
        return ports[0]

    monkeypatch.setattr(rpc_server.GrpcServer, "start", start)
    seen: list[Any] = []

    def look() -> None:
        with grpc.insecure_channel(f"127.0.0.1:{ports[0]}") as channel:
            health = health_pb2_grpc.HealthStub(channel)
            for name in ("", "physnet.v1.DeformationService"):
                seen.append(health.Check(health_pb2.HealthCheckRequest(service=name), timeout=10).status)
            client = rpc_client.stub(channel)
            for call, request in ((client.Deform, question()), (client.GetModel, pb.GetModelRequest())):
                seen.append(failed(call, request).code())

    with running(FakePredictor(), look) as service, grpc.insecure_channel(service.grpc) as channel:
        health = health_pb2_grpc.HealthStub(channel)
        serving = health.Check(health_pb2.HealthCheckRequest(service="physnet.v1.DeformationService")).status
        watched = health.Watch(health_pb2.HealthCheckRequest())
        assert next(watched).status == health_pb2.HealthCheckResponse.SERVING
        stopping = threading.Thread(target=service.stop)
        stopping.start()
        assert next(watched).status == health_pb2.HealthCheckResponse.NOT_SERVING
        watched.cancel()
        stopping.join()
    assert seen == [health_pb2.HealthCheckResponse.NOT_SERVING] * 2 + [grpc.StatusCode.UNAVAILABLE] * 2
    assert serving == health_pb2.HealthCheckResponse.SERVING


def test_reflection_tells_of_every_service_and_message(channel):
    database = ProtoReflectionDescriptorDatabase(channel)
    assert {"physnet.v1.DeformationService", "grpc.health.v1.Health"} <= set(database.get_services())
    pool = DescriptorPool(database)
    method = pool.FindServiceByName("physnet.v1.DeformationService").FindMethodByName("Deform")
    assert method.input_type.fields_by_name["loads"].message_type.full_name == "physnet.v1.Load"


def test_a_robot_that_pings_all_the_time_is_not_sent_away(service):
    options = [
        ("grpc.keepalive_time_ms", 100), ("grpc.keepalive_permit_without_calls", 1),
        ("grpc.http2.max_pings_without_data", 0), ("grpc.http2.min_time_between_pings_ms", 100),
    ]  # fmt: skip
    states: list[grpc.ChannelConnectivity] = []
    with grpc.insecure_channel(service.grpc, options) as channel:
        client = rpc_client.stub(channel)
        client.Deform(question())
        channel.subscribe(states.append)
        # Two strikes are gRPC's own limit: within this second it would have been sent GOAWAY.
        time.sleep(1.0)
        client.Deform(question())
        assert grpc.ChannelConnectivity.TRANSIENT_FAILURE not in states
        assert grpc.ChannelConnectivity.IDLE not in states


def test_a_port_that_is_taken_is_an_error_in_one_line(service, capsys, tmp_path):
    from service.__main__ import FAILED, main

    port = service.grpc.rpartition(":")[2]
    assert main(["serve", "--http-port", "0", "--grpc-port", port, "--models", str(tmp_path)]) == FAILED
    assert port in capsys.readouterr().err
