"""The playground in a real browser, on the real service with the models it ships with."""

from __future__ import annotations

import io
import re
import shutil
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pygltflib
import pytest

from tests.conftest import ROOT, LiveService

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed: pip install physnet[test]")
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine: apt-get install chromium")

# The machine may have no GPU, and may be busy.
FLAGS = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox", "--disable-dev-shm-usage"]
PATIENCE_MS = 60_000
MUG = ROOT / "examples" / "frames" / "mug"


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield browser
        browser.close()


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


def test_the_empty_page_offers_samples_and_asks_nobody_else(visit: Visit):
    page = visit.open().page
    assert "depth camera" in page.inner_text("#empty")
    page.wait_for_selector("#link[data-state=open]")
    # The thumbnails are drawn from the frames themselves.
    visit.until("""[...document.querySelectorAll('#gallery canvas')].every(canvas =>
        canvas.getContext('2d').getImageData(0, 100, 160, 1).data.some(value => value > 0))""")
    assert page.locator("#gallery button").all_inner_texts() == ["Mug", "Bowl", "Sugar box"]
    assert page.locator("#save button:enabled").count() == 0
    assert page.locator("#material option").count() > 30
    assert {re.match(r"\w+://[^/]+", url)[0] for url in visit.requests if not url.startswith("data:")} == {visit.url}
    page.locator("#gallery button").nth(1).click()
    visit.wait_for_answer()
    assert page.is_hidden("#empty")
    assert visit.peak_mm() > 0.0
    assert len(visit.sockets) == 1


def test_sliders_change_the_answer_over_the_one_connection(mug: Visit):
    page = mug.page
    before = mug.answers()
    page.locator("#magnitude").fill("480")
    mug.wait_for_answer(before)
    page.wait_for_timeout(300)
    gentle, before = mug.peak_mm(), mug.answers()
    page.evaluate("""async () => {
        const slider = document.querySelector('#magnitude');
        for (let at = 490; at <= 700; at += 10) {
            slider.value = at;
            slider.dispatchEvent(new Event('input', {bubbles: true}));
            await new Promise(next => setTimeout(next, 30));
        }
    }""")
    mug.wait_for_answer(before + 2)
    mug.until(f"parseFloat(document.querySelector('#peak').textContent) > {3 * gentle}")
    assert "deform" in page.inner_text("#timing-text")
    assert re.fullmatch(r"\d+ /s", page.inner_text("#rate"))
    assert len(mug.sockets) == 1
    # A stiffer material gives less.
    softer = mug.peak_mm()
    page.select_option("#material", "steel")
    mug.until(f"parseFloat(document.querySelector('#peak').textContent) < {0.1 * softer}")
    page.select_option("#material", "dragon_skin_10")


def test_materials_are_found_by_typing_and_taken_by_keyboard_or_click(mug: Visit):
    page = mug.page
    search, listed = page.locator("#material-search"), page.locator("#material")
    everything, before = listed.locator("option").count(), page.locator("#material").input_value()
    assert re.fullmatch(r"Search \d+ materials", search.get_attribute("placeholder") or "")
    search.fill("ecoflex 30")
    assert listed.locator("option").all_inner_texts()[0].startswith("Ecoflex 00 30 ")
    assert 1 < int(listed.get_attribute("size") or 0) <= 7
    answers = mug.answers()
    search.press("Enter")
    mug.wait_for_answer(answers)
    assert (listed.input_value(), search.input_value()) == ("ecoflex_00_30", "")
    assert listed.locator("option").count() == everything
    assert page.inner_text("#material-about").startswith("Soft silicone of soft robots")
    # Words of the category and the description count; the arrow goes into the list, Escape leaves all as it was.
    search.fill("wood")
    search.press("ArrowDown")
    listed.press("ArrowDown")
    listed.press("Escape")
    assert listed.input_value() == "ecoflex_00_30"
    search.fill("no such thing")
    assert listed.locator("option").all_inner_texts() == ["No material is called that"]
    search.press("Escape")
    search.fill(before.replace("_", " "))
    answers = mug.answers()
    listed.locator("option").first.click()
    mug.wait_for_answer(answers)
    assert listed.input_value() == before


def test_a_click_sets_the_contact_and_a_drag_the_force(mug: Visit):
    page = mug.page
    page.locator("#depth-stage").scroll_into_view_if_needed()
    box = page.locator("#depth-stage").bounding_box()
    zoom = box["width"] / 640
    at = (box["x"] + 330 * zoom, box["y"] + 260 * zoom)
    before = mug.answers()
    page.mouse.click(*at)
    mug.wait_for_answer(before)
    u, v = map(int, re.search(r"pixel (\d+), (\d+)", page.inner_text("#contact")).groups())
    assert (u, v) == (pytest.approx(330, abs=2), pytest.approx(260, abs=2))
    before = mug.answers()
    page.mouse.move(*at)
    page.mouse.down()
    page.mouse.move(at[0] + 30, at[1] + 2, steps=4)
    page.mouse.move(at[0] + 120, at[1], steps=4)
    page.mouse.up()
    mug.wait_for_answer(before)
    # A long drag to the right pushes to the right, in the image.
    assert page.input_value("#turn") == "0"
    assert page.get_attribute("#tilt", "aria-valuetext") == "0°"
    page.click("#inwards")
    assert int(page.get_attribute("#tilt", "aria-valuetext").rstrip("°")) > 20


def test_the_view_shows_layers_colours_and_a_cut(mug: Visit):
    page = mug.page

    def picture() -> bytes:
        drawn = int(page.get_attribute("#view", "data-drawn") or 0)
        page.wait_for_timeout(400)
        mug.until(f"Number(document.querySelector('#view').dataset.drawn) >= {drawn}")
        return page.locator("#view").screenshot()

    pictures = [picture()]
    page.uncheck("#layers [value=observed]")
    page.uncheck("#layers [value=reconstructed]")
    pictures.append(picture())
    page.check("#colouring [value=uncertainty]")
    assert "lie off by" in page.inner_text("#legend")
    pictures.append(picture())
    page.check("#cut [value='0']")
    page.locator("#cut-at").fill("55")
    pictures.append(picture())
    assert len(set(pictures)) == 4
    page.check("#colouring [value=displacement]")
    page.check("#cut [value='']")
    assert re.search(r"0\s.*mm", page.inner_text("#legend"), re.S)
    page.check("#layers [value=observed]")
    page.check("#layers [value=reconstructed]")


def test_the_result_is_saved_as_three_kinds_of_files(mug: Visit):
    def saved(kind: str) -> bytes:
        with mug.page.expect_download() as download:
            mug.page.click(f"#save [data-kind={kind}]")
        assert download.value.suggested_filename == f"physnet-mug.{kind}"
        return Path(download.value.path()).read_bytes()

    archive = np.load(io.BytesIO(saved("npz")))
    assert archive["deformed"].shape == (1, 64, 64, 64)
    assert archive["deformed"].sum() > 1000
    filled = np.argwhere(archive["reconstruction"]) * archive["voxel_size_m"]
    extent_m = float(filled.max(0)[2] - filled.min(0)[2])

    head, _, body = saved("ply").partition(b"end_header\n")
    vertices, faces = (int(re.search(rf"element {what} (\d+)".encode(), head)[1]) for what in ("vertex", "face"))
    assert len(body) == 35 * vertices + 13 * faces
    record = np.dtype([("place", "<f4", 3), ("normal", "<f4", 3), ("colour", "u1", 3), ("known", "<f4", 2)])
    points = np.frombuffer(body, record, vertices)
    # In the camera's frame: the mug stands between 0.4 and 0.6 m away.
    assert 0.35 < points["place"][:, 2].min() < points["place"][:, 2].max() < 0.7
    triangles = np.frombuffer(body, np.dtype([("n", "u1"), ("at", "<i4", 3)]), faces, 35 * vertices)["at"]
    edges = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    assert (np.unique(edges, axis=0, return_counts=True)[1] % 2 == 0).all(), "the surface is not closed"
    a, b, c = (points["place"][triangles[:, corner]].astype(float) for corner in range(3))
    volume_m3 = float((a * np.cross(b, c)).sum() / 6.0)
    assert volume_m3 == pytest.approx(archive["deformed"].sum() * float(archive["voxel_size_m"]) ** 3, rel=0.2)
    np.testing.assert_allclose(np.linalg.norm(points["normal"], axis=1), 1.0, atol=1e-3)
    assert re.findall(rb"property float (displacement|uncertainty)", head) == [b"displacement", b"uncertainty"]
    displacement_m = points["known"][:, 0]
    assert 1e3 * displacement_m.max() == pytest.approx(mug.peak_mm(), rel=0.1)
    assert re.findall(rb"property uchar (\w+)", head) == [b"red", b"green", b"blue"]
    # What has moved least has the first colour of the scale.
    assert points["colour"][displacement_m.argmin()].tolist() == [0xB4, 0xBD, 0xC5]

    scene = pygltflib.GLTF2.load_from_bytes(saved("glb"))
    assert [node.name for node in scene.nodes] == ["reconstruction", "deformed"]
    # The archive is asked for anew, at a contact that may have moved since the body on the page was found.
    assert scene.scenes[0].extras["voxel_size_m"] == pytest.approx(float(archive["voxel_size_m"]), rel=0.01)
    rest, deformed = ([scene.accessors[n] for n in (mesh.primitives[0].attributes.POSITION, mesh.primitives[0].indices)]
                      for mesh in scene.meshes)  # fmt: skip
    assert rest[0].max[1] - rest[0].min[1] == pytest.approx(extent_m, abs=3 * float(archive["voxel_size_m"]))
    assert (deformed[0].count, deformed[1].count) == (vertices, 3 * faces)
    moved = scene.accessors[scene.meshes[1].primitives[0].attributes._DISPLACEMENT]
    view = scene.bufferViews[moved.bufferView]
    read = np.frombuffer(scene.binary_blob(), "<f4", moved.count, view.byteOffset)
    np.testing.assert_array_equal(read, displacement_m)


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

    def do(self, kind: str) -> None:
        drag = {"type": kind, "x": 300, "y": 300, "data": self._data}
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


def test_the_keyboard_does_it_all(mug: Visit):
    page = mug.page
    page.focus("#depth-stage")
    before, said = mug.answers(), page.inner_text("#contact")
    page.keyboard.press("ArrowLeft")
    page.keyboard.press("Shift+ArrowDown")
    mug.wait_for_answer(before)
    assert page.inner_text("#contact") != said
    page.focus("#magnitude")
    before, force = mug.answers(), mug.force_n()
    page.keyboard.press("ArrowUp")
    mug.wait_for_answer(before)
    assert mug.force_n() != force
    page.locator("#force-sliders .typed").first.fill("12")
    page.keyboard.press("Enter")
    assert mug.force_n() == "12.0 N"
    page.focus("#view")
    outline = page.evaluate("getComputedStyle(document.activeElement).outlineStyle")
    assert outline == "solid"
    drawn = int(page.get_attribute("#view", "data-drawn"))
    page.keyboard.press("ArrowRight")
    mug.until(f"Number(document.querySelector('#view').dataset.drawn) > {drawn}")
    # Everything that is operated has a name.
    nameless = page.evaluate("""[...document.querySelectorAll('button, input, select, [tabindex]')].filter(element =>
        !element.getAttribute('aria-label') && !element.textContent.trim() && !element.labels?.length)
        .map(element => element.outerHTML)""")
    assert nameless == []


def test_light_and_dark(mug: Visit):
    page = mug.page
    colour = "getComputedStyle(document.body).backgroundColor"
    light = page.evaluate(colour)
    page.click("#theme")
    dark = page.evaluate(colour)
    assert sum(map(int, re.findall(r"\d+", light))) > 600 > 150 > sum(map(int, re.findall(r"\d+", dark)))
    page.click("#theme")
    assert page.evaluate(colour) == light


def test_it_fits_a_phone(browser: Any, live_service: LiveService):
    visit = Visit(browser, live_service.url, 360, 740, is_mobile=True, has_touch=True)
    page = visit.open("sugar_box").page
    assert page.evaluate("document.documentElement.scrollWidth") == 360
    page.locator("#modulus").scroll_into_view_if_needed()
    # The view stays in sight of the slider.
    view, slider = (page.locator(name).bounding_box() for name in ("#view", "#modulus"))
    assert view["y"] >= -1
    assert slider["y"] >= view["y"] + view["height"] - 1
    before = visit.answers()
    page.tap("#modulus", position={"x": 40, "y": 15})
    visit.wait_for_answer(before)
    visit.close()
