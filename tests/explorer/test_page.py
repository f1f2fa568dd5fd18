"""The page in headless Chromium: a slider moves and the picture changes, by hand and by keyboard,
at any width, light and dark.
"""

import json
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from helpers.browser import AXE, AXE_TAGS, MIN_TEXT_PX, Tab, needs_browser
from helpers.processes import HANG_S

from pixsim.explorer import server
from pixsim.explorer.session import Session

pytestmark = needs_browser

SMALL = {"resolution": 64, "display": {"dots": 32}, "pixel": {"pitch_um": 42.4}}
STATE = "document.getElementById('state').textContent"
UNDER = "document.getElementById('under').src"
SLIDER = "document.querySelector('#controls input[type=range]')"  # of the pixel size, the first
NUMBER = "document.querySelector('#controls input[type=number]')"


@pytest.fixture(scope="module")
def tab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Tab]:
    session = Session("csf", (), SMALL)
    with server.served(session) as file:
        thread = threading.Thread(target=session.serve)
        thread.start()
        tab = Tab(tmp_path_factory.mktemp("browser"))
        try:
            tab.call("Page.navigate", url=file.as_uri())
            done(tab)
            yield tab
        finally:
            tab.close()
            session.end()
            thread.join(HANG_S)


def done(tab: Tab) -> None:
    tab.wait(lambda: tab.value(f"document.getElementById('state') && {STATE}") == "done")


def changed(tab: Tab, script: str, before: str) -> str:
    """The right picture after a script, once its errors are known; it differs from the one
    before.
    """
    tab.value(script)
    tab.wait(lambda: tab.value(UNDER) != before)
    done(tab)
    return tab.value(UNDER)


def test_token_leaves_the_address(tab):
    assert tab.value("location.hash") == ""
    assert tab.value("document.cookie") == ""


def test_slider_moves_and_picture_changes_and_reset_brings_it_back(tab):
    first = tab.value(UNDER)
    moved = changed(tab, f"{SLIDER}.value = 800; {SLIDER}.dispatchEvent(new Event('input'))", first)
    assert float(tab.value(f"{NUMBER}.value")) > 42.4
    assert "--pixel.pitch-um=" in tab.value("document.getElementById('command').textContent")
    assert changed(tab, "document.querySelector('#controls button').click()", moved) == first
    assert float(tab.value(f"{NUMBER}.value")) == 42.4


def test_keyboard_moves_a_slider_and_the_wipe(tab):
    first = tab.value(UNDER)
    tab.value(f"{SLIDER}.focus()")
    for _ in range(40):
        tab.press("ArrowRight")
    tab.wait(lambda: tab.value(UNDER) != first)
    done(tab)
    spoken = tab.value(f"{SLIDER}.getAttribute('aria-valuetext')")
    assert float(spoken.removesuffix(" µm")) > 42.4
    tab.press("Tab")
    assert tab.value(f"document.activeElement === {NUMBER}")
    tab.press("Tab")
    tab.value("document.activeElement.click(); document.getElementById('wipe').focus()")
    tab.wait(lambda: tab.value(UNDER) == first)
    tab.press("ArrowLeft")
    assert tab.value("document.getElementById('over').style.clipPath") == "inset(0px 51% 0px 0px)"
    done(tab)


def test_two_sensors_curve_and_metric(tab):
    tab.value(
        "document.getElementById('two').click(); document.querySelector('#metrics"
        " [value=acutance]').click()"
    )
    tab.value(
        "document.querySelector('[name=which][value=\"1\"]').click();"
        " document.getElementById('curve').click()"
    )
    tab.value(f"{NUMBER}.value = '60'; {NUMBER}.dispatchEvent(new Event('change'))")
    tab.wait(lambda: tab.value("document.querySelectorAll('svg g.b line').length") > 2)
    done(tab)
    answers = tab.value(
        "[...document.querySelectorAll('#answers > div')].map(each => each.textContent)"
    )
    assert len(answers) == 2
    assert "of 42.4 µm" in answers[0]
    assert "of 60 µm" in answers[1]
    assert all("acutance" in answer and "±" in answer for answer in answers)
    assert tab.value("document.getElementById('under').alt").startswith(
        "sensor's picture, sensor B"
    )
    assert tab.value("document.querySelector('svg').getAttribute('aria-label')").count("±") > 4


@pytest.mark.parametrize(("width", "scheme"), [(400, "light"), (1280, "dark")])
def test_page_fits_and_axe_finds_nothing(width, scheme, tab):
    """After the test above, with all parts of the page in use."""
    size = {"width": width, "height": 1000, "deviceScaleFactor": 1, "mobile": False}
    tab.call("Emulation.setDeviceMetricsOverride", **size)
    media = [{"name": "prefers-color-scheme", "value": scheme}]
    tab.call("Emulation.setEmulatedMedia", features=media)
    whole = "document.getElementById('whole')"
    tab.value(f"{whole}.checked || {whole}.click()")
    root = "document.documentElement"
    needed, available = tab.value(f"[{root}.scrollWidth, {root}.clientWidth]")
    assert needed <= available
    under = "document.getElementById('under')"
    natural, actual = tab.value(f"[{under}.naturalWidth, {under}.clientWidth]")
    assert natural == actual, "zoom 1:1"
    texts = (
        "[...document.querySelectorAll('body *')].filter(each => each.checkVisibility() &&"
        " each.innerText)"
    )
    size_px = f"Math.min(...{texts}.map(each => parseFloat(getComputedStyle(each).fontSize)))"
    assert tab.value(size_px) >= MIN_TEXT_PX
    if not tab.value("typeof axe === 'object'"):
        tab.value(f"{Path(AXE).read_text(encoding='utf-8')}; 1")
    violations: list[Any] = tab.value(
        "axe.run(document, {resultTypes: ['violations'], runOnly:"
        f" {json.dumps(AXE_TAGS)}}}).then(found => found.violations.flatMap(each =>"
        " each.nodes.map(node => [each.id, node.target.join(' '), node.failureSummary])))"
    )
    assert violations == []
