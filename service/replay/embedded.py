"""A predictor of one's own in place of a service: asked by the same rules, answered in the same words."""

from __future__ import annotations

import json
import uuid

from service.api import convert, replies
from service.api.problem import ValidationFailed
from service.app import build_pipeline
from service.client import http_wire
from service.client.frames import BACKLOG, MAX_IN_FLIGHT, FrameBook
from service.client.question import Question
from service.client.result import Result
from service.client.stream import FrameStream, carry_by_calls
from service.scheduler import Predictor
from service.settings import Settings


def answer(predictor: Predictor, question: Question, max_loads: int) -> Result:
    """A predictor's answer to a question as a robot would post it, in the reply that it would get.

    Raises:
        PhysNetError: What is wrong with it.
        ValidationFailed: All that is wrong with its form.
    """
    body = convert.parse_body(json.dumps(http_wire.body(question)).encode())
    request = convert.deform_request(body, max_loads, http_wire.files(question))
    answered = predictor.predict(request)
    document = replies.reply_document(answered, request.outputs, uuid.uuid4().hex)
    return http_wire.result({**document, "timing_ms": answered.timing_ms})


class EmbeddedClient:
    """Answers here.

    Args:
        settings: Models, threads and limits.
        predictor: In place of the pipeline on the settings' models.

    Raises:
        ModelMismatch: A model cannot be used.
    """

    def __init__(self, settings: Settings, predictor: Predictor | None = None) -> None:
        self._settings = settings
        self._predictor = predictor or build_pipeline(settings).predictor

    def ask(self, question: Question) -> Result:
        """The answer to a question.

        Raises:
            PhysNetError: What is wrong with it.
        """
        try:
            return answer(self._predictor, question, self._settings.max_loads)
        except ValidationFailed as failed:
            raise failed.error from None

    def stream(self, *, backlog: int = BACKLOG, with_skipped: bool = False) -> FrameStream:
        """A stream in which the newest frame wins."""
        return FrameStream(carry_by_calls(self.ask), FrameBook(MAX_IN_FLIGHT, backlog, with_skipped))
