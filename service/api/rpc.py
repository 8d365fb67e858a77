"""`physnet.v1.DeformationService`: reads, translates, asks the handler, and translates back."""

from __future__ import annotations

import time
from collections.abc import AsyncIterator, Mapping
from functools import partial

from service.api import convert, rpc_convert
from service.api.generated import deformation_pb2 as pb
from service.api.handler import Handler
from service.api.rpc_call import Calls, Context
from service.api.rpc_stream import FrameStream
from service.core.errors import InvalidRequest, Overloaded, UnknownModel
from service.core.materials import search_materials
from service.core.messages import DeformRequest, DeformResult
from service.scheduler import Answer
from service.settings import Settings

SERVICE = "physnet.v1.DeformationService"


class DeformationService:
    """The servicer; one for the life of the server, before and after the models are loaded."""

    def __init__(self, handler: Handler, settings: Settings, calls: Calls) -> None:
        self._handler = handler
        self._settings = settings
        self._calls = calls

    async def Deform(self, request: pb.DeformRequest, context: Context) -> pb.DeformResponse:  # noqa: N802
        """One frame in, shapes out."""
        received = time.perf_counter()
        async with self._calls.call(context, f"/{SERVICE}/Deform") as call:
            question = self._question(request)
            parsed = time.perf_counter()
            response = pb.DeformResponse()
            fill = partial(self._fill, response, question, call.request_id, received, parsed)
            timing_ms = (await self._handler.deform(question, call.deadline, fill)).result
            self._handler.answered(timing_ms, call.span)
            return response

    async def DeformStream(  # noqa: N802
        self, frames: AsyncIterator[pb.DeformStreamRequest], context: Context
    ) -> None:
        """Frames in as they come, answers out; the newest frame wins."""
        async with self._calls.call(context, f"/{SERVICE}/DeformStream") as call:
            stream = FrameStream(
                self._handler, self._settings, self._question, self._fill, context.write, call
            )
            await stream.run(frames)

    async def ListMaterials(  # noqa: N802
        self, request: pb.ListMaterialsRequest, context: Context
    ) -> pb.ListMaterialsResponse:
        """Named materials."""
        async with self._calls.call(context, f"/{SERVICE}/ListMaterials"):
            if len(request.query) > 100:
                raise InvalidRequest("The query is too long.", field="query", expected="at most 100 characters")
            return rpc_convert.list_materials(search_materials(request.query))

    async def GetModel(self, request: pb.GetModelRequest, context: Context) -> pb.GetModelResponse:  # noqa: N802
        """The models that answer."""
        async with self._calls.call(context, f"/{SERVICE}/GetModel"):
            if not self._handler.ready:
                raise Overloaded("The models are still being loaded; try again in a second.", retry_after_s=1.0)
            manifests = self._handler.manifests
            names = [manifest.name for manifest in manifests]
            if request.name and request.name not in names:
                raise UnknownModel("No model has that name.", field="name", expected=names, actual=request.name[:80])
            return rpc_convert.get_model(m for m in manifests if request.name in ("", m.name))

    def _question(self, request: pb.DeformRequest) -> DeformRequest:
        max_loads = self._settings.max_loads
        body = rpc_convert.parse_request(request, max_loads)
        convert.check_load_count(len(request.loads), max_loads)
        return convert.deform_request(body, max_loads)

    def _fill(
        self,
        response: pb.DeformResponse,
        question: DeformRequest,
        request_id: str,
        received: float,
        parsed: float,
        answer: Answer[DeformResult],
    ) -> Mapping[str, float]:
        """Fill an answer in where it stands, in the thread of its worker; returns its timings."""
        began = time.perf_counter()
        rpc_convert.fill_response(response, answer.result, question.outputs, request_id)
        now = time.perf_counter()
        timing_ms: Mapping[str, float] = {
            "parse": 1e3 * (parsed - received),
            "queue": 1e3 * answer.queued_s,
            **{stage: ms for stage, ms in answer.result.timing_ms.items() if stage != "total"},
            "encode": 1e3 * (now - began),
            "total": 1e3 * (now - received),
        }
        response.timing_ms.update(timing_ms)
        return timing_ms
