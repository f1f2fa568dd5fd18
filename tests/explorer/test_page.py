"""The page: for this user alone, and for no other site; in headless Chromium, a slider moves and
the picture changes, by hand and by keyboard, at any width, light and dark.
"""

import contextlib
import http.client
import json
import re
import signal
import socket
import stat
import subprocess
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from helpers.browser import AXE, AXE_TAGS, BROWSER, MIN_TEXT_PX, Tab
from helpers.commands import COMMAND, command
from helpers.processes import HANG_S
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from pixsim.base.locks import UNFINISHED
from pixsim.explorer import exploring, server
from pixsim.explorer.session import Session

SMALL = {"resolution": 64, "display": {"dots": 32}, "pixel": {"pitch_um": 42.4}}
OPTIONS = "--resolution 64 --display.dots 32 --pixel.pitch-um 42.4 --no-browser"


REQUEST = '{"number": %s, "sensors": [{"preset": %s, "set": {%s}}], "metrics": [], "curve": false}'
BAD_REQUESTS = [
    '{"number": 1}',
    "no JSON",
    "[" * 20_000,
    REQUEST % ("1e999", 0, ""),
    REQUEST % (1, "-1e999", ""),
    REQUEST % (1, 10**400, ""),
    REQUEST % (1, "1" * 5000, ""),
    REQUEST % (1, 0, '"no.control": 1e999'),
]


def address_in(file: Path) -> tuple[int, str]:
    """The port and the token of the file that leads to a page."""
    (address,) = set(re.findall(r"http://127\.0\.0\.1:(\d+)/#([\w-]+)", file.read_text()))
    return int(address[0]), address[1]


@contextlib.contextmanager
def page_of(session: Session) -> Iterator[Any]:
    """A session that is served, and computed in a thread."""
    with server.served(session) as file:
        port, token = address_in(file)
        thread = threading.Thread(target=session.serve)
        thread.start()
        connect_to(port, "127.0.0.1").close()  # it listens before the file names it
        try:
            yield SimpleNamespace(file=file, port=port, token=token, thread=thread)
        finally:
            session.end()
            thread.join(HANG_S)


def connect_to(port: int, host: str) -> http.client.HTTPConnection:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=HANG_S)
    connection.request("GET", "/", headers={"Host": f"{host}:{port}"})
    return connection


def socket_of(port: int, origin: str | None, host: str | None = None) -> Any:
    """A WebSocket as a page of an origin opens it, by a name of this machine."""
    connection = socket.create_connection(("127.0.0.1", port))
    return connect(
        f"ws://{host or '127.0.0.1'}:{port}/socket",
        sock=connection,
        origin=origin,
        open_timeout=HANG_S,
    )  # type: ignore[arg-type]


@contextlib.contextmanager
def opened_page(page: Any) -> Iterator[Any]:
    """The WebSocket of the page itself, after its greeting."""
    with socket_of(page.port, f"http://127.0.0.1:{page.port}") as opened:
        opened.send(json.dumps({"token": page.token}))
        assert json.loads(opened.recv(timeout=HANG_S))["hello"]["title"] == "csf"
        yield opened


@pytest.fixture(scope="module")
def page() -> Iterator[Any]:
    with page_of(Session("csf", (), SMALL)) as served_page:
        yield served_page


def test_file_that_leads_to_the_page_is_private(page):
    assert stat.S_IMODE(page.file.stat().st_mode) == 0o600
    assert len(page.token) >= 32


@pytest.mark.parametrize(
    ("host", "status"), [("127.0.0.1", 200), ("localhost", 200), ("pixsim.example", 403)]
)
def test_page_is_served_under_its_own_names_only(host, status, page):
    """Another name that leads to 127.0.0.1 is how a foreign site would read the page."""
    answer = connect_to(page.port, host).getresponse()
    assert answer.status == status
    if status == 200:
        assert "default-src 'none'" in answer.headers["Content-Security-Policy"]
        assert answer.headers["Set-Cookie"] is None
        assert page.token not in answer.read().decode()


@pytest.mark.parametrize("path", ["/../pyproject.toml", "/etc/passwd", "/settings.toml"])
def test_nothing_but_the_page_is_served(path, page):
    connection = http.client.HTTPConnection("127.0.0.1", page.port, timeout=HANG_S)
    connection.request("GET", path)
    assert connection.getresponse().status == 404


@pytest.mark.parametrize(
    ("origin", "host"),
    [
        ("http://pixsim.example", None),
        ("null", None),
        (None, None),
        ("http://127.0.0.1:1", None),
        ("http://pixsim.example:{port}", "pixsim.example"),
    ],
)
def test_foreign_origin_and_host_are_refused(origin, host, page):
    with pytest.raises(InvalidStatus) as refused:
        socket_of(page.port, origin and origin.format(port=page.port), host)
    assert refused.value.response.status_code == 403


@pytest.mark.parametrize(
    "first",
    ['{"token": "wrong"}', '{"token": ""}', "[]", "no JSON", '{"number": 1, "sensors": []}'],
)
def test_wrong_token_is_refused(first, page):
    with socket_of(page.port, f"http://127.0.0.1:{page.port}") as opened:
        opened.send(first)
        with pytest.raises(ConnectionClosed):
            opened.recv(timeout=HANG_S)


def test_token_opens_the_page_and_a_bad_request_does_not_close_it(page):
    with opened_page(page) as opened:
        for bad in BAD_REQUESTS:
            opened.send(bad)
            assert "page: got" in json.loads(opened.recv(timeout=HANG_S))["error"], bad[:80]
        opened.send(REQUEST % (2, 0, ""))
        messages: list[dict[str, Any]] = [{}]
        while not messages[-1].get("done"):
            messages.append(json.loads(opened.recv(timeout=HANG_S)))
        assert [message["sure"] for message in messages if "sure" in message] == [False, True]


def test_silent_connections_are_few_and_end(monkeypatch):
    """Any user of the machine can connect; the open page stays served."""
    monkeypatch.setattr(server, "_TIMEOUT_S", 0.2)
    with page_of(Session("csf", (), SMALL)) as page, opened_page(page) as opened:
        silent = [socket.create_connection(("127.0.0.1", page.port)) for _ in range(200)]
        for connection in silent:
            connection.settimeout(HANG_S)
            with contextlib.suppress(ConnectionError):  # it is one too many
                connection.sendall(b"GET / HTTP/1.1\r\n")
                assert connection.recv(1) == b""
        opened.send("{}")
        assert "no request" in json.loads(opened.recv(timeout=HANG_S))["error"]


def test_file_of_a_killed_server_goes_at_the_next_start(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    left = tmp_path / f"{UNFINISHED}0123abcd"
    left.mkdir()
    (left / "pixsim-explore.html").write_text("token")
    with page_of(Session("csf", (), SMALL)) as page:
        assert not left.exists()
        assert page.file.parent.parent == tmp_path
    assert list(tmp_path.iterdir()) == []


def test_closed_page_ends_the_session(monkeypatch):
    monkeypatch.setattr(server, "RELOAD_S", 0.05)
    with page_of(Session("csf", (), SMALL)) as page:
        with opened_page(page):
            assert page.thread.is_alive()
        page.thread.join(HANG_S)
        assert not page.thread.is_alive()
    assert not page.file.exists()


# --- the command
# ------------------------------------------------------------------------------------------------------------------


def test_command_prints_the_file_and_ends_by_an_interruption():
    running = subprocess.Popen(
        [COMMAND, "explore", "csf", *OPTIONS.split()],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    file = Path(running.stdout.readline().strip().removeprefix("page: "))
    port, token = address_in(file)
    with subprocess.Popen(["ps", "-eo", "args"], stdout=subprocess.PIPE, text=True) as listed:
        assert token not in listed.communicate()[0]
    assert port > 0
    running.send_signal(signal.SIGINT)
    _, err = running.communicate(timeout=HANG_S)
    assert (running.returncode, err) == (130, "pixsim: interrupted\n")
    assert not file.exists()


def test_browser_gets_the_file_and_no_token(monkeypatch):
    """All users of a machine see the arguments of a process."""
    session = Session("csf", (), SMALL)
    opened: list[tuple[str, str]] = []

    def open_browser(uri: str) -> bool:
        opened.append((uri, address_in(Path(uri.removeprefix("file://")))[1]))
        session.end()
        return True

    monkeypatch.setattr(server.webbrowser, "open", open_browser)
    server.explore_until_closed(session)
    ((uri, token),) = opened
    assert token not in uri


def test_command_says_what_to_install(monkeypatch):
    monkeypatch.setattr(exploring, "find_spec", lambda name: None)
    code, out, err = command("explore csf")
    assert (code, out) == (2, "")
    assert "pip install 'pixsim[explore]'" in err


# --- in a browser
# ------------------------------------------------------------------------------------------------------------------

STATE = "document.getElementById('state').textContent"
UNDER = "document.getElementById('under').src"
SLIDER = "document.querySelector('#controls input[type=range]')"  # of the pixel size, the first
NUMBER = "document.querySelector('#controls input[type=number]')"


@pytest.fixture(scope="module")
def tab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Tab]:
    if BROWSER is None:
        pytest.skip("neither chromium nor google-chrome is on PATH")
    with page_of(Session("csf", (), SMALL)) as page:
        tab = Tab(tmp_path_factory.mktemp("browser"))
        with contextlib.closing(tab):
            tab.call("Page.navigate", url=page.file.as_uri())
            done(tab)
            yield tab


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
    assert tab.value("[location.hash, document.cookie]") == ["", ""]


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
    tab.value(f"""
        document.getElementById('two').click();
        document.querySelector('#metrics [value=acutance]').click();
        document.querySelector('[name=which][value="1"]').click();
        document.getElementById('curve').click();
        {NUMBER}.value = '60';
        {NUMBER}.dispatchEvent(new Event('change'))
    """)
    tab.wait(lambda: tab.value("document.querySelectorAll('svg g.b line').length") > 2)
    done(tab)
    answers = tab.value(
        "[...document.querySelectorAll('#answers > div')].map(each => each.textContent)"
    )
    assert all(size in text for size, text in zip(("of 42.4 µm", "of 60 µm"), answers, strict=True))
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
    needed, available, natural, actual, smallest_px = tab.value("""(() => {
        const root = document.documentElement, under = document.getElementById('under');
        const texts = [...document.querySelectorAll('body *')].filter(
            each => each.checkVisibility() && each.innerText);
        const sizes = texts.map(each => parseFloat(getComputedStyle(each).fontSize));
        return [root.scrollWidth, root.clientWidth, under.naturalWidth, under.clientWidth,
            Math.min(...sizes)];
    })()""")
    assert needed <= available
    assert natural == actual, "zoom 1:1"
    assert smallest_px >= MIN_TEXT_PX
    if not tab.value("typeof axe === 'object'"):
        tab.value(f"{Path(AXE).read_text(encoding='utf-8')}; 1")
    violations: list[Any] = tab.value(
        "axe.run(document, {resultTypes: ['violations'], runOnly:"
        f" {json.dumps(AXE_TAGS)}}}).then(found => found.violations.flatMap(each =>"
        " each.nodes.map(node => [each.id, node.target.join(' '), node.failureSummary])))"
    )
    assert violations == []
