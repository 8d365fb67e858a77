"""A service on real sockets around a predictor without networks, and a client of every kind for it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from service.client import ContactOffBody
from tests.service.client.kinds import KINDS, url
from tests.service.fakes import FakePredictor, Running, running


def react(request: Any) -> None:
    if request.material.young_modulus_pa == 404.0:
        raise ContactOffBody("Too far.", field="loads[0].contact_m", expected=0.02, actual=0.5)
    if request.material.young_modulus_pa == 666.0:
        raise RuntimeError("a bug")


@pytest.fixture(scope="module")
def service() -> Iterator[Running]:
    with running(FakePredictor(react), max_loads=4) as service:
        yield service


@pytest.fixture(params=KINDS)
def client(request: pytest.FixtureRequest, service: Running) -> Iterator[Any]:
    with KINDS[request.param](url(service, request.param), timeout_s=10.0) as client:
        yield client
