"""The client of every kind, called alike, and a question for it."""

from __future__ import annotations

import asyncio
from typing import Any

import numpy as np

from service.client import AsyncPhysNetClient, Camera, PhysNetClient, Push, Result, Retry
from tests.service.box_scene import BoxScene
from tests.service.fakes import Running, fake_result

SCENE = BoxScene(width=64, height=48, focal_px=60.0)
CAMERA = Camera.from_json(SCENE.camera)
PUSH = Push(contact_m=SCENE.in_camera(SCENE.front_m()), force_n=SCENE.direction((0.0, 4.0, 0.0)))
SOFT = (1e5, 0.45)
ONCE = Retry(attempts=1)


class Blocking:
    """An asynchronous client, called as the blocking one is: so that one test holds both to the same."""

    def __init__(self, url: str, **options: Any) -> None:
        self._loop = asyncio.new_event_loop()
        self._client = self._loop.run_until_complete(self._make(url, **options))

    async def _make(self, url: str, **options: Any) -> AsyncPhysNetClient:
        return AsyncPhysNetClient(url, **options)

    def __getattr__(self, name: str) -> Any:
        method = getattr(self._client, name)
        return lambda *arguments, **named: self._loop.run_until_complete(method(*arguments, **named))

    def __enter__(self) -> Blocking:
        return self

    def __exit__(self, *_: object) -> None:
        self._loop.run_until_complete(self._client.close())
        self._loop.close()


KINDS = {"http": PhysNetClient, "grpc": PhysNetClient, "http async": Blocking, "grpc async": Blocking}


def url(service: Running, kind: str) -> str:
    return f"grpc://{service.grpc}" if kind.startswith("grpc") else service.url


def check(result: Result, asked: Any) -> None:
    """The reply is the predictor's, bit for bit as far as the wire carries it."""
    want = fake_result(asked)
    assert result.model == ("fake", "9.9.9")
    assert result.grid.pitch_m == want.grid.pitch_m
    np.testing.assert_array_equal(result.grid.camera_from_grid, want.grid.camera_from_grid)
    np.testing.assert_array_equal(result.reconstruction, want.reconstruction)
    assert result.flags == want.flags
    assert result.timing_ms["deform"] == 2.0
    assert len(result) == len(want.loads)
    for got, load in zip(result, want.loads, strict=True):
        np.testing.assert_array_equal(got.deformed, load.deformed)
        np.testing.assert_array_equal(got.displacement_m, load.displacement_m.astype(np.float16))
        assert (got.max_displacement_m, got.load_number) == (load.max_displacement_m, load.load_number)
        assert got.flags == {"contact_snapped"}
