"""Chromium, and visits to the playground of the live service."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from tests.conftest import LiveService
from tests.e2e.playground import CHROMIUM, FLAGS, Visit


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    reason = "playwright is not installed: pip install physnet[test]"
    playwright = pytest.importorskip("playwright.sync_api", reason=reason)
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield browser
        browser.close()


@pytest.fixture
def visit(browser: Any, live_service: LiveService) -> Iterator[Visit]:
    visit = Visit(browser, live_service.url)
    yield visit
    visit.close()


@pytest.fixture(scope="module")
def mug(browser: Any, live_service: LiveService) -> Iterator[Visit]:
    """The mug, opened once for the tests that go on from there."""
    visit = Visit(browser, live_service.url).open("mug")
    yield visit
    visit.close()
