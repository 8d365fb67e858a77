"""The playground in a real browser, on the real service with the models it ships with."""

from __future__ import annotations

import re
from typing import Any

import pytest

from tests.conftest import LiveService
from tests.e2e.playground import Visit, needs_chromium

pytestmark = needs_chromium


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
