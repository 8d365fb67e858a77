"""The one way to an answer: not before the models are there, and not after the service was told to stop."""

from __future__ import annotations

import asyncio
import time

import numpy as np
import pytest

from service.api.handler import Handler
from service.core.errors import Overloaded
from service.core.materials import Material
from service.core.messages import DeformRequest, KnownShape
from service.scheduler import Scheduler
from tests.service.fakes import FakePredictor, fake_manifest

REQUEST = DeformRequest(KnownShape(b"", 1.0, np.eye(4)), Material(1.0, 0.3), ())


def test_it_answers_only_between_opening_and_closing():
    async def main() -> None:
        handler = Handler()
        assert not handler.ready
        assert handler.manifests == ()
        with pytest.raises(Overloaded, match="being loaded"):
            await handler.deform(REQUEST, time.monotonic() + 5)
        handler.open(Scheduler(FakePredictor(), queue_size=1), [fake_manifest()])
        assert handler.ready
        assert [manifest.name for manifest in handler.manifests] == ["fake"]
        assert (await handler.deform(REQUEST, time.monotonic() + 5)).result.model_name == "fake"
        await handler.close(1.0)
        # A load balancer must send no more here.
        assert not handler.ready
        with pytest.raises(Overloaded, match="shutting down"):
            await handler.deform(REQUEST, time.monotonic() + 5)

    asyncio.run(main())


def test_closing_before_opening_is_no_error():
    asyncio.run(Handler().close(1.0))
