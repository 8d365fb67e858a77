"""`inference.GRPCInferenceService`: the Open Inference Protocol over gRPC."""

from __future__ import annotations

import time
from collections.abc import AsyncIterator
from typing import Any

from service.api import oip_messages
from service.api.context import log_error
from service.api.oip_messages import SERVICE, message
from service.api.oip_models import Inference, Model, Models
from service.api.oip_tensors import Given, Tensor, to_bytes
from service.api.problem import problem_document
from service.api.rpc_call import Calls, Context
from service.core.errors import InvalidRequest
from service.settings import Settings

SERVER_NAME = "physnet"
EXTENSIONS = ("binary_tensor_data", "model_configuration", "statistics")

CONTENTS = {"BOOL": "bool_contents", "UINT8": "uint_contents", "FP32": "fp32_contents", "FP64": "fp64_contents"}
"""Field of each datatype in `InferTensorContents`; half precision goes raw only."""


class InferenceService:
    """The servicer. Methods of the published interface that it lacks are answered UNIMPLEMENTED."""

    def __init__(self, models: Models, settings: Settings, calls: Calls, version: str) -> None:
        self._models = models
        self._settings = settings
        self._calls = calls
        self._version = version

    async def ServerLive(self, request: Any, context: Context) -> Any:  # noqa: N802
        return message("ServerLiveResponse", live=True)

    async def ServerReady(self, request: Any, context: Context) -> Any:  # noqa: N802
        return message("ServerReadyResponse", ready=self._models.ready)

    async def ModelReady(self, request: Any, context: Context) -> Any:  # noqa: N802
        known = self._models.all().get(request.name) if self._models.ready else None
        ready = known is not None and request.version in ("", known.version)
        return message("ModelReadyResponse", ready=ready)

    async def ServerMetadata(self, request: Any, context: Context) -> Any:  # noqa: N802
        return message("ServerMetadataResponse", name=SERVER_NAME, version=self._version, extensions=EXTENSIONS)

    async def ModelMetadata(self, request: Any, context: Context) -> Any:  # noqa: N802
        async with self._call(context, "ModelMetadata"):
            model = self._models.find(request.name, request.version)
            return message(
                "ModelMetadataResponse", name=model.name, versions=[model.version], platform=model.platform,
                inputs=[_metadata(tensor) for tensor in model.inputs],
                outputs=[_metadata(tensor) for tensor in model.outputs],
            )  # fmt: skip

    async def ModelConfig(self, request: Any, context: Context) -> Any:  # noqa: N802
        async with self._call(context, "ModelConfig"):
            model = self._models.find(request.name, request.version)
            return message("ModelConfigResponse", config=config_message(model))

    async def ModelStatistics(self, request: Any, context: Context) -> Any:  # noqa: N802
        async with self._call(context, "ModelStatistics"):
            if request.name:
                models = [self._models.find(request.name, request.version)]
            else:
                models = list(self._models.all().values())
            return message("ModelStatisticsResponse", model_stats=[statistics_message(model) for model in models])

    async def ModelInfer(self, request: Any, context: Context) -> Any:  # noqa: N802
        async with self._call(context, "ModelInfer") as call:
            return await self._infer(request, call.deadline)

    async def ModelStreamInfer(self, requests: AsyncIterator[Any], context: Context) -> None:  # noqa: N802
        """Every request is answered in its turn; what is wrong with one is its answer, and the stream goes on."""
        async with self._call(context, "ModelStreamInfer") as call:
            async for request in requests:
                try:
                    answer = await self._infer(request, time.monotonic() + self._settings.request_deadline_s)
                    # How clients of models with any number of answers know the last one.
                    answer.parameters["triton_final_response"].bool_param = True
                    response = message("ModelStreamInferResponse", infer_response=answer)
                except Exception as error:
                    log_error(error, call.request_id)
                    detail = problem_document(error, call.request_id)["detail"]
                    named = message("ModelInferResponse", model_name=request.model_name, id=request.id)
                    response = message("ModelStreamInferResponse", error_message=detail, infer_response=named)
                await context.write(response)

    def _call(self, context: Context, method: str) -> Any:
        return self._calls.call(context, f"/{SERVICE}/{method}")

    async def _infer(self, request: Any, deadline: float) -> Any:
        wanted = [output.name for output in request.outputs]
        found = await self._models.infer(
            request.model_name, request.model_version, _given(request), wanted, deadline
        )
        return _response(found, request.id)


def _given(request: Any) -> list[Given]:
    raw = request.raw_input_contents
    if raw and len(raw) != len(request.inputs):
        raise InvalidRequest(
            "Raw contents must be there for all inputs or for none.",
            field="raw_input_contents", expected=len(request.inputs), actual=len(raw),
        )  # fmt: skip
    given = []
    for index, one in enumerate(request.inputs):
        if raw:
            data = raw[index]
        else:
            field = CONTENTS.get(one.datatype)
            data = list(getattr(one.contents, field)) if field else b""
        given.append(Given(one.name, one.datatype, list(one.shape), data))
    return given


def _response(found: Inference, request_id: str) -> Any:
    response = message(
        "ModelInferResponse", model_name=found.model.name, model_version=found.model.version, id=request_id
    )
    for tensor, array in found.outputs:
        response.outputs.add(name=tensor.name, datatype=tensor.datatype, shape=array.shape)
        response.raw_output_contents.append(to_bytes(array, tensor.datatype))
    return response


def _metadata(tensor: Tensor) -> dict[str, Any]:
    return {"name": tensor.name, "datatype": tensor.datatype, "shape": tensor.dims}


def config_message(model: Model) -> Any:
    """`ModelConfig` of a model."""
    types = oip_messages.DESCRIPTION.file.enum_types_by_name["DataType"].values_by_name

    def tensor(one: Tensor) -> dict[str, Any]:
        name = "TYPE_STRING" if one.datatype == "BYTES" else f"TYPE_{one.datatype}"
        return {"name": one.name, "data_type": types[name].number, "dims": one.dims}

    return message(
        "ModelConfig", name=model.name, platform=model.platform, backend=model.platform.partition("_")[0],
        max_batch_size=0, default_model_filename=model.filename,
        input=[{**tensor(one), "optional": one.optional} for one in model.inputs],
        output=[tensor(one) for one in model.outputs],
    )  # fmt: skip


def statistics_message(model: Model) -> Any:
    """`ModelStatistics` of a model."""
    counted = model.statistics

    def duration(count: int, ns: int) -> dict[str, int]:
        return {"count": count, "ns": ns}

    return message(
        "ModelStatistics", name=model.name, version=model.version, last_inference=counted.last_ms,
        inference_count=counted.success, execution_count=counted.success,
        inference_stats={
            "success": duration(counted.success, counted.success_ns),
            "fail": duration(counted.fail, counted.fail_ns),
            "queue": duration(counted.success, counted.queue_ns),
            "compute_infer": duration(counted.success, counted.infer_ns),
        },
    )  # fmt: skip
