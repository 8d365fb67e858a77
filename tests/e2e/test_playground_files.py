"""Frames of one's own in the playground: chosen, dropped onto the page, and refused in words."""

from __future__ import annotations

import re
from pathlib import Path

import cv2
import numpy as np

from tests.conftest import ROOT
from tests.e2e.playground import Visit, needs_chromium

pytestmark = needs_chromium

MUG = ROOT / "examples" / "frames" / "mug"


def test_errors_are_said_in_words_and_settled_by_the_next_answer(mug: Visit, tmp_path: Path):
    page = mug.page
    notice = page.locator("#notice")
    (tmp_path / "notes.txt").write_text("no image")
    page.set_input_files("#file", tmp_path / "notes.txt")
    notice.wait_for()
    assert "notes.txt is neither a PNG nor a NumPy file" in notice.inner_text()
    cv2.imwrite(str(tmp_path / "grey.png"), np.full((48, 64), 7, np.uint8))
    page.set_input_files("#file", tmp_path / "grey.png")
    mug.until("document.querySelector('#notice').textContent.includes('8 bits')")
    page.click("#notice [aria-label=Dismiss]")
    assert notice.is_hidden()
    # The service's own words: a wall has no object on it.
    np.save(tmp_path / "wall.npy", np.full((48, 64), 0.7, np.float32))
    page.set_input_files("#file", tmp_path / "wall.npy")
    notice.wait_for()
    assert page.locator("#notice strong").inner_text() not in ("", "That did not work.")
    assert len(page.locator("#notice span").inner_text()) > 15
    assert "assumed" in page.inner_text("#camera summary")
    before = mug.answers()
    page.click("#tabs [data-sample=mug]")
    mug.wait_for_answer(before)
    assert notice.is_hidden()


def test_an_own_frame_with_its_intrinsics_gives_the_sample_s_answer(visit: Visit, tmp_path: Path):
    depth = cv2.imread(str(MUG / "depth.png"), cv2.IMREAD_UNCHANGED)
    np.save(tmp_path / "own.npy", depth.astype(np.float32) / 1000)
    page = visit.open().page
    page.wait_for_selector("#link[data-state=open]")
    page.set_input_files("#file", [tmp_path / "own.npy", MUG / "intrinsics.json"])
    visit.wait_for_answer()
    assert "616.4" in page.inner_text("#camera summary")
    assert re.search(r"Object 0\.4\d to 0\.5\d m", page.inner_text("#depth-range"))


class Hand:
    """Drags files in from outside the browser, as a person does from a folder's window."""

    def __init__(self, visit: Visit, *files: Path) -> None:
        self._devtools = visit.context.new_cdp_session(visit.page)
        self._data = {"items": [], "files": [str(path) for path in files], "dragOperationsMask": 1}

    def do(self, kind: str, x: int = 300, y: int = 300) -> None:
        drag = {"type": kind, "x": x, "y": y, "data": self._data}
        self._devtools.send("Input.dispatchDragEvent", drag)

    def drop(self) -> None:
        for kind in ("dragEnter", "dragOver", "drop"):
            self.do(kind)


def test_files_are_dropped_onto_the_page(visit: Visit, tmp_path: Path):
    page = visit.open().page
    page.wait_for_selector("#link[data-state=open]")
    notice, camera, sign = page.locator("#notice"), page.locator("#camera summary"), page.locator("#drop")
    # What is no depth image: said in words, and the page is still there.
    (tmp_path / "notes.txt").write_text("no image")
    hand = Hand(visit, tmp_path / "notes.txt")
    hand.do("dragEnter")
    sign.wait_for()
    assert sign.inner_text() == "Drop the depth image"
    hand.do("dragOver")
    hand.do("drop")
    notice.wait_for()
    assert "notes.txt is neither a PNG nor a NumPy file" in notice.inner_text()
    assert sign.is_hidden() and visit.answers() == 0
    # An array alone: the camera is assumed, and that is said.
    depth_mm = cv2.imread(str(MUG / "depth.png"), cv2.IMREAD_UNCHANGED)
    np.save(tmp_path / "own.npy", depth_mm.astype(np.float32) / 1000)
    Hand(visit, tmp_path / "own.npy").drop()
    visit.wait_for_answer()
    assert notice.is_hidden() and visit.peak_mm() > 0.0
    assert "assumed" in camera.inner_text()
    assert page.locator("#camera input").evaluate_all("all => all.map(one => Number(one.value))") == [
        0.96 * 640, 0.96 * 640, 319.5, 239.5
    ]  # fmt: skip
    # Its intrinsics after it.
    before = visit.answers()
    Hand(visit, MUG / "intrinsics.json").drop()
    visit.wait_for_answer(before)
    assert "616.4" in camera.inner_text() and "assumed" not in camera.inner_text()
    # Intrinsics that are none leave those that were.
    (tmp_path / "half.json").write_text('{"fx": 600}')
    Hand(visit, tmp_path / "half.json").drop()
    notice.wait_for()
    assert "fx, fy, cx and cy" in notice.inner_text()
    assert "616.4" in camera.inner_text()
    # A PNG and its intrinsics at once.
    before = visit.answers()
    Hand(visit, MUG / "depth.png", MUG / "intrinsics.json").drop()
    visit.wait_for_answer(before)
    assert notice.is_hidden()
    assert "616.4" in camera.inner_text() and "assumed" not in camera.inner_text()
    assert re.search(r"Object 0\.4\d to 0\.5\d m", page.inner_text("#depth-range"))
    assert page.url.rstrip("/") == visit.url


def test_the_sign_stays_over_the_page_and_goes_with_a_drag_that_leaves_it(visit: Visit):
    page = visit.open().page
    page.wait_for_selector("#link[data-state=open]")
    sign = page.locator("#drop")
    assert sign.is_hidden()
    hand = Hand(visit, MUG / "depth.png")
    hand.do("dragEnter")
    sign.wait_for()
    # From element to element of the page: each is left for the next.
    page.evaluate("""() => {
        window.left = 0;
        addEventListener('dragleave', event => window.left += event.relatedTarget !== null);
    }""")
    for x, y in ((20, 20), (300, 300), (900, 580)):
        hand.do("dragOver", x, y)
    visit.until("window.left >= 2")
    assert sign.is_visible()
    hand.do("dragOver", -10, -10)
    sign.wait_for(state="hidden")
    # Nothing was taken.
    assert visit.answers() == 0 and page.is_visible("#empty")
