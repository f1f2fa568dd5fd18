"""The page of `pixsim explore`: it computes the same as `pixsim run`, for the last settings only; it is
for this user alone, and for no other site; and in headless Chromium, a slider moves and the picture
changes, by hand and by keyboard, at any width, light and dark.
"""

import base64
import contextlib
import http.client
import io
import json
import re
import shlex
import signal
import socket
import stat
import subprocess
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from helpers.browser import AXE, AXE_TAGS, BROWSER, MIN_TEXT_PX, Tab
from helpers.commands import COMMAND, assert_refused, command, output_of
from helpers.processes import HANG_S
from numpy.typing import NDArray
from PIL import Image
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

import pixsim
from pixsim.base.locks import UNFINISHED
from pixsim.explorer import exploring, server
from pixsim.explorer.controls import controls_of, presets_of
from pixsim.explorer.session import MAX_LIGHTS, PageRequest, Session
from pixsim.show.pictures import display_codes
from pixsim.studies.run import run
from pixsim.viewer.setting import Run

SMALL = {
    "resolution": 64,
    "display": {"dots": 32},
    "pixel": {"pitch_um": 42.4},
}  # two pixels a dot; its film is measured
CONTROLLED_FIELDS = {
    "pixel.pitch_um": 40.0,
    "camera.f_number": 5.6,
    "exposure.gain_db": 6.1,
    "scene.parameters.luminance_cd_per_m2": 300.0,
    "motion.image_um_per_s": 500.0,
    "develop.denoise": "nlm",
    "develop.denoise_strength": 1.5,
}


def answers(session: Session, request: PageRequest) -> list[dict]:
    """What is sent for a request."""
    sent: list[dict] = []
    session.send = sent.append
    session.answer(request)
    return sent


def pixels(uri: str) -> NDArray:
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(uri.partition(",")[2]))))


def with_pictures(messages: list[dict]) -> dict:
    """The first message with pictures."""
    return next(message for message in messages if "pictures" in message)


def final(messages: list[dict]) -> list[dict]:
    """The messages whose errors are measured, one for each sensor."""
    return [message for message in messages if message.get("sure")]


def assert_repeats(words: list[object], out: Path, pictures: dict[str, str]) -> None:
    """A command gives the pictures of the page bit for bit, in each of its three channels."""
    output_of("", *words, "--irradiance", "none", "--out", out)
    for name in ("ideal", "image"):
        codes = np.asarray(Image.open(out / f"{name}.png").convert("L"))
        np.testing.assert_array_equal(pixels(pictures[name]), codes)


@pytest.fixture(scope="module")
def answered() -> tuple[Session, list[dict]]:
    session = Session("csf", (), SMALL)
    return session, answers(session, PageRequest(1, ((0, CONTROLLED_FIELDS),)))


def test_first_picture_is_that_of_a_run_bit_for_bit(answered):
    """Its number is that of one sensor. Where the film is fine enough, it is the last one, too."""
    first, last, done = (message for message in answered[1] if "busy" not in message)
    assert (first["sure"], first["unsure"]) == (False, "errors not measured yet")
    assert (last["sure"], done) == (True, {"number": 1, "done": True})
    assert "pictures" not in last, "it was computed again, and is the same"
    assert "± " in last["lines"][0]

    settings = {
        "pixel": {"pitch_um": 40.0},
        "camera": {"f_number": 5.6},
        "exposure": {"gain_db": 6.1},
        "motion": {"image_um_per_s": (500.0, 0.0)},
        "develop": {"denoise": "nlm", "denoise_strength": 1.5},
        "parameters": {"luminance_cd_per_m2": 300.0},
    }
    score = run("csf", **SMALL | settings).score
    np.testing.assert_array_equal(pixels(first["pictures"]["image"]), display_codes(score.image))
    np.testing.assert_array_equal(pixels(first["pictures"]["ideal"]), display_codes(score.ideal))
    assert f"mean ΔE {score.mean_delta_e:.3f} of one sensor" in first["lines"][0]
    assert np.ptp(pixels(first["pictures"]["image"])) > 50, "the chart is seen"


@pytest.mark.parametrize("way", ["command", "settings.toml"])
def test_ways_out_repeat_the_picture_bit_for_bit(way, answered, tmp_path):
    last = final(answered[1])[0]
    (tmp_path / "settings.toml").write_text(last["settings"])
    words = ["run", "--config", tmp_path / "settings.toml"]
    if way == "command":
        words = shlex.split(last["command"])[1:]
    assert_repeats(words, tmp_path / "out", with_pictures(answered[1])["pictures"])


def test_light_in_memory_stays_as_it_is_and_repeats_from_its_file(here):
    light = pixsim.render(pixsim.load_scene("csf", resolution=64), pixsim.Camera())
    header = dict(light.header)
    session = Session(light, (), {name: SMALL[name] for name in ("pixel", "display")})
    paths = {control.path for control in session.controls}
    assert not {"lens.file", "scene.parameters.luminance_cd_per_m2"} & paths

    sent = answers(session, PageRequest(1, ((0, {"exposure.gain_db": 3.0}),)))
    assert light.header == header
    last = final(sent)[0]
    pixsim.write_exr("light.exr", light)
    Path("settings.toml").write_text(last["settings"])
    assert_repeats(shlex.split(last["command"])[1:], Path("out"), with_pictures(sent)["pictures"])


def test_cached_light_and_ideal_change_no_bit(answered):
    """Whatever was computed before: other pixels, other light, two sensors, a metric."""
    session, sent = answered
    fresh = with_pictures(sent)["pictures"]
    for values in (
        {"pixel.pitch_um": 50.0},
        {**CONTROLLED_FIELDS, "camera.f_number": 2.8, "exposure.gain_db": 0.0},
    ):
        answers(
            session, PageRequest(2, ((0, values), (0, {"pixel.read_noise_e": 30.0})), ("acutance",))
        )
        assert len(session._lights) <= MAX_LIGHTS
    again = answers(session, PageRequest(3, ((0, CONTROLLED_FIELDS),)))
    assert with_pictures(again)["pictures"] == fresh


def test_two_sensors_share_scene_camera_and_display():
    both = ({"camera.f_number": 8.0, "pixel.pitch_um": 50.0}, {"camera.f_number": 2.0})
    request = PageRequest(1, tuple((0, values) for values in both))
    shared = [
        (message["sensor"], *map(message["values"].get, ("camera.f_number", "pixel.pitch_um")))
        for message in final(answers(Session("csf", (), SMALL), request))
    ]
    assert shared == [(0, 8.0, 50.0), (1, 8.0, 42.4)]


def test_only_the_last_settings_count():
    """Other settings come while the first ones are computed: nothing more is said of these, and the
    curve of them ends.
    """
    session, sent = Session("csf", (), SMALL), []

    def send(message: dict) -> None:
        sent.append(message)
        if message["number"] == 1 and "point" in message:
            for number, pitch_um in ((2, 60.0), (3, 50.0)):
                session.ask(PageRequest(number, ((0, {"pixel.pitch_um": pitch_um}),)))
        if message.get("done"):
            session.end()

    session.send = send
    session.ask(PageRequest(1, ((0, {}),), (), True))
    session.serve()
    assert [message["number"] for message in sent if message.get("done")] == [3]
    assert sum("point" in message for message in sent) == 1
    numbers = [message["number"] for message in sent]
    assert numbers == [1] * numbers.count(1) + [3] * numbers.count(3)


def test_curve_has_the_intervals_of_runs_and_ends_where_pixels_are_impossible():
    small = {**SMALL, "camera": {"die_mm": 0.5}}
    session = Session("csf", (), small | {"pixel": {"pitch_um": 6.0}})
    sent = answers(session, PageRequest(1, ((0, {}),), (), True))
    points = [message["point"] for message in sent if "point" in message]
    assert [point[0] for point in points][:2] == [5.62, 6.81], "the nearest first"
    assert min(point[0] for point in points) > 5.135, "below, the transistors fill the pixel"
    size, mean, half = points[0]
    result = run("csf", repeats=4, **small | {"pixel": {"pitch_um": size}})
    low, high = result.interval_delta_e
    assert (mean, half) == pytest.approx((result.mean_delta_e, (high - low) / 2), rel=1e-12)


# --- controls
# ---------------------------------------------------------------------------------------------------------------------


def test_controls_have_what_their_fields_declare():
    """Of a pair of numbers, the first is turned."""
    controls = {control.path: control for control in controls_of((), ())}
    declared = Run.model_json_schema()["$defs"]["Exposure"]["properties"]["max_gain_db"]
    gain, motion = controls["exposure.gain_db"], controls["motion.image_um_per_s"]
    assert (gain.minimum, gain.maximum, gain.unit) == (0, declared["maximum"], "dB")
    assert (gain.choices, gain.page_value("auto")) == ((), None)
    assert (motion.unit, motion.pair, controls["pixel.pitch_um"].unit) == ("µm/s", True, "µm")
    assert (motion.value(3), motion.page_value((3.0, 0.0))) == ([3.0, 0.0], 3.0)
    assert all(control.help for control in controls.values())


@pytest.mark.parametrize(
    ("scene", "path"),
    [("still_life", "scene.parameters.lux"), ("flat", "scene.parameters.luminance_cd_per_m2")],
)
def test_controls_of_a_scene_follow_its_parameters(scene, path):
    assert path in {control.path for control in Session(scene, (), SMALL).controls}


@pytest.mark.parametrize(
    ("values", "word"),
    [
        ({"pixel.technology": "/etc/passwd"}, "a control of this page"),
        ({"pixel.quantum_efficiency": "/etc/passwd"}, "a control of this page"),
        ({"lens.file": "/etc/passwd"}, "thin lens, cooke_triplet"),
        ({"pixel.pitch_um": "/etc/passwd"}, "a number"),
        ({"pixel.pitch_um": True}, "a number"),
        ({"pixel.pitch_um": -1}, "pixel.pitch_um"),
        ({"pixel.pitch_um": 0.01}, "above 5.135 µm"),
    ],
)
def test_page_names_no_files_and_no_impossible_values(values, word):
    with pytest.raises(pixsim.PixsimError, match=word):
        Session("csf", (), SMALL).answer(PageRequest(1, ((0, values),)))


def test_presets_are_the_users_files_technologies_and_cameras(tmp_path):
    """Of several files with a pixel each is one, beside the files without. Those of pixsim have the
    user's display, and no pixel of the user's.
    """
    one, two, view = files = [tmp_path / f"{name}.toml" for name in ("one", "two", "view")]
    for path, table in zip(files, ("pixel", "pixel", "display"), strict=True):
        path.write_text(f"[{table}]\nbits = 10", encoding="utf-8")
    options = {"pixel": {"bits": 12}, "display": {"dots": 64}}
    scene = {"file": "csf"}
    assert presets_of([view, one], options, scene)[0][1:3] == ("as given", (view, one))
    presets = presets_of([one, view, two], options, scene)
    assert [preset[:3] for preset in presets[:2]] == [
        ("files", "one.toml", (one, view)),
        ("files", "two.toml", (view, two)),
    ]
    by_name = {preset.name: preset for preset in presets}
    tables = {"pixel": {"technology": "4t-bsi"}, "display": {"dots": 64}, "scene": scene}
    assert by_name["4t-bsi"][2:] == ((), tables)
    assert by_name["imx477"].tables["pixel"]["full_well_e"] == 8180
    assert "Nikon D5100" in by_name


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
def page_of(session: Session) -> Iterator:
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


def connect_to(port: int, host: str, path: str = "/") -> http.client.HTTPConnection:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=HANG_S)
    connection.request("GET", path, headers={"Host": f"{host}:{port}"})
    return connection


def socket_of(port: int, origin: str | None, host: str | None = None):
    """A WebSocket as a page of an origin opens it, by a name of this machine."""
    connection = socket.create_connection(("127.0.0.1", port))
    return connect(
        f"ws://{host or '127.0.0.1'}:{port}/socket",
        sock=connection,
        origin=origin,
        open_timeout=HANG_S,
    )  # type: ignore[arg-type]


@contextlib.contextmanager
def opened_page(page) -> Iterator:
    """The WebSocket of the page itself, after its greeting."""
    with socket_of(page.port, f"http://127.0.0.1:{page.port}") as opened:
        opened.send(json.dumps({"token": page.token}))
        assert json.loads(opened.recv(timeout=HANG_S))["hello"]["title"] == "csf"
        yield opened


@pytest.fixture(scope="module")
def page() -> Iterator:
    with page_of(Session("csf", (), SMALL)) as served_page:
        yield served_page


def test_file_that_leads_to_the_page_is_private(page):
    assert stat.S_IMODE(page.file.stat().st_mode) == 0o600
    assert len(page.token) >= 32


@pytest.mark.parametrize(
    ("path", "host", "status"),
    [
        ("/", "127.0.0.1", 200),
        ("/", "localhost", 200),
        ("/", "pixsim.example", 403),
        ("/../pyproject.toml", "127.0.0.1", 404),
        ("/etc/passwd", "127.0.0.1", 404),
        ("/settings.toml", "127.0.0.1", 404),
    ],
)
def test_nothing_but_the_page_is_served_and_under_its_own_names(path, host, status, page):
    """Another name that leads to 127.0.0.1 is how a foreign site would read the page."""
    answer = connect_to(page.port, host, path).getresponse()
    assert answer.status == status
    if status == 200:
        assert "default-src 'none'" in answer.headers["Content-Security-Policy"]
        assert answer.headers["Set-Cookie"] is None
        assert page.token not in answer.read().decode()


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
        messages: list[dict] = [{}]
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
        assert "not a request" in json.loads(opened.recv(timeout=HANG_S))["error"]


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


@pytest.mark.slow
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
    assert_refused(*command("explore csf"), ["pip install 'pixsim[explore]'"])


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


# a browser; test_wrong_token_is_refused has the token
@pytest.mark.slow
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
    assert tab.value(f"parseFloat({SLIDER}.getAttribute('aria-valuetext'))") > 42.4
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
    violations: list = tab.value(
        "axe.run(document, {resultTypes: ['violations'], runOnly:"
        f" {json.dumps(AXE_TAGS)}}}).then(found => found.violations.flatMap(each =>"
        " each.nodes.map(node => [each.id, node.target.join(' '), node.failureSummary])))"
    )
    assert violations == []
