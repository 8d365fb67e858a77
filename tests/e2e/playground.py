"""A visit to the playground in the system's Chromium."""

from __future__ import annotations

import shutil
import time
from typing import Any

import pytest

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
needs_chromium = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine: apt-get install chromium")

# The machine may have no GPU, and may be busy.
FLAGS = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox", "--disable-dev-shm-usage"]
PATIENCE_MS = 60_000


class Visit:
    """A page, and all it asked for and complained about."""

    def __init__(self, browser: Any, url: str, width: int = 920, height: int = 600, **options: Any) -> None:
        self.url = url
        self.context = browser.new_context(viewport={"width": width, "height": height}, **options)
        self.page = self.context.new_page()
        self.page.set_default_timeout(PATIENCE_MS)
        self.requests: list[str] = []
        self.sockets: list[str] = []
        self.complaints: list[str] = []
        self.page.on("request", lambda request: self.requests.append(request.url))
        self.page.on("websocket", lambda socket: self.sockets.append(socket.url))
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("console", lambda said: self.complaints.append(said.text) if said.type == "error" else None)

    def open(self, sample: str = "") -> Visit:
        self.page.goto(f"{self.url}/{sample and f'#{sample}'}")
        if sample:
            self.wait_for_answer()
        return self

    def until(self, expression: str) -> None:
        """Wait for the page to fulfil it. The driver's own way would evaluate in the page, which its policy forbids."""
        deadline = time.monotonic() + PATIENCE_MS / 1e3
        while not self.page.evaluate(expression):
            assert time.monotonic() < deadline, f"never true: {expression}; the page complains of {self.complaints}"
            self.page.wait_for_timeout(50)

    def answers(self) -> int:
        return int(self.page.get_attribute("#view", "data-answers") or 0)

    def wait_for_answer(self, after: int = 0) -> None:
        self.until(f"Number(document.querySelector('#view').dataset.answers ?? 0) > {after}")

    def peak_mm(self) -> float:
        return float(self.page.inner_text("#peak").split()[0])

    def force_n(self) -> str:
        return self.page.input_value("#force-sliders .typed >> nth=0")

    def close(self) -> None:
        self.context.close()
        assert self.complaints == []
