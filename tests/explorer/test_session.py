"""What the page computes: the same as `pixsim run`, for the last settings only."""

import base64
import io
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.commands import command
from numpy.typing import NDArray
from PIL import Image

import pixsim
from pixsim.base.errors import PixsimError
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
    "scene.luminance_cd_per_m2": 300.0,
    "motion.image_um_per_s": 500.0,
    "develop.denoise": "nlm",
    "develop.denoise_strength": 1.5,
}


def answers(session: Session, request: PageRequest) -> list[dict[str, Any]]:
    """What is sent for a request."""
    sent: list[dict[str, Any]] = []
    session.send = sent.append
    session.answer(request)
    return sent


def pixels(uri: str) -> NDArray[Any]:
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(uri.partition(",")[2]))))


def with_pictures(messages: list[dict[str, Any]]) -> dict[str, Any]:
    """The first message with pictures."""
    return next(message for message in messages if "pictures" in message)


def final(messages: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The messages whose errors are measured, one for each sensor."""
    return [message for message in messages if message.get("sure")]


def assert_repeats(words: list[object], out: Path, pictures: dict[str, str]) -> None:
    """A command gives the pictures of the page bit for bit, in each of its three channels."""
    code, _, err = command("", *words, "--irradiance", "none", "--out", out)
    assert code == 0, err
    for name in ("ideal", "image"):
        codes = np.asarray(Image.open(out / f"{name}.png").convert("L"))
        np.testing.assert_array_equal(pixels(pictures[name]), codes)


@pytest.fixture(scope="module")
def answered() -> tuple[Session, list[dict[str, Any]]]:
    session = Session("csf", (), SMALL)
    return session, answers(session, PageRequest(1, ((0, CONTROLLED_FIELDS),)))


def test_first_picture_is_the_last_where_the_film_is_fine_enough(answered):
    first, last, done = (message for message in answered[1] if "busy" not in message)
    assert (first["sure"], last["sure"], done) == (False, True, {"number": 1, "done": True})
    assert "pictures" in first
    assert "pictures" not in last, "it was computed again, and is the same"
    assert first["unsure"] == "errors not measured yet"
    assert "± " in last["lines"][0]


def test_first_picture_is_that_of_a_run_bit_for_bit(answered):
    """Its number is that of one sensor."""
    first = with_pictures(answered[1])
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
    words = ["run", "csf", "--config", tmp_path / "settings.toml"]
    if way == "command":
        words = shlex.split(last["command"])[1:]
    assert_repeats(words, tmp_path / "out", with_pictures(answered[1])["pictures"])


def test_light_in_memory_stays_as_it_is_and_repeats_from_its_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    light = pixsim.render(pixsim.load_scene("csf", resolution=64), pixsim.Camera())
    header = dict(light.header)
    session = Session(light, (), {"pixel": {"pitch_um": 42.4}, "display": {"dots": 32}})
    paths = {control.path for control in session.controls}
    assert not {"lens.file", "scene.luminance_cd_per_m2"} & paths

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
        {**CONTROLLED_FIELDS, "camera.f_number": 2.8},
        {**CONTROLLED_FIELDS, "exposure.gain_db": 0.0},
    ):
        answers(
            session, PageRequest(2, ((0, values), (0, {"pixel.read_noise_e": 30.0})), ("acutance",))
        )
        assert len(session._lights) <= MAX_LIGHTS
    again = answers(session, PageRequest(3, ((0, CONTROLLED_FIELDS),)))
    assert with_pictures(again)["pictures"] == fresh


def test_two_sensors_share_scene_camera_and_display():
    session = Session("csf", (), SMALL)
    both = ({"camera.f_number": 8.0, "pixel.pitch_um": 50.0}, {"camera.f_number": 2.0})
    last = final(answers(session, PageRequest(1, tuple((0, values) for values in both))))
    names = "camera.f_number", "pixel.pitch_um"
    shared = [(message["sensor"], *map(message["values"].get, names)) for message in last]
    assert shared == [(0, 8.0, 50.0), (1, 8.0, 42.4)]


def test_only_the_last_settings_count():
    """Other settings come while the first ones are computed: nothing more is said of these, and the
    curve of them ends.
    """
    session, sent = Session("csf", (), SMALL), list[dict[str, Any]]()

    def send(message: dict[str, Any]) -> None:
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
    assert numbers == sorted(numbers)
    assert set(numbers) == {1, 3}


def test_curve_has_the_intervals_of_runs_and_ends_where_pixels_are_impossible():
    session = Session("csf", (), {**SMALL, "pixel": {"pitch_um": 6.0}, "camera": {"die_mm": 0.5}})
    points = [
        message["point"]
        for message in answers(session, PageRequest(1, ((0, {}),), (), True))
        if "point" in message
    ]
    assert [point[0] for point in points][:2] == [5.62, 6.81], "the nearest first"
    assert min(point[0] for point in points) > 5.135, "below, the transistors fill the pixel"
    size, mean, half = points[0]
    result = run(
        "csf", repeats=4, **{**SMALL, "pixel": {"pitch_um": size}, "camera": {"die_mm": 0.5}}
    )
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
    assert (motion.unit, motion.pair) == ("µm/s", True)
    assert (motion.value(3), motion.page_value((3.0, 0.0))) == ([3.0, 0.0], 3.0)
    assert controls["pixel.pitch_um"].unit == "µm"
    assert all(control.help for control in controls.values())


@pytest.mark.parametrize(
    ("scene", "path"), [("still_life", "scene.lux"), ("flat", "scene.luminance_cd_per_m2")]
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
    ],
)
def test_page_names_no_files_and_no_impossible_values(values, word):
    with pytest.raises(PixsimError, match=word):
        Session("csf", (), SMALL).answer(PageRequest(1, ((0, values),)))


def test_presets_are_the_users_files_technologies_and_cameras(tmp_path):
    """Those of pixsim have the user's display, and no pixel of the user's."""
    files = [tmp_path / "one.toml", tmp_path / "two.toml"]
    presets = presets_of(files, {"pixel": {"bits": 12}, "display": {"dots": 64}})
    assert presets[0].config == tuple(files)
    by_name = {preset.name: preset for preset in presets}
    assert by_name["one.toml"].group == by_name["two.toml"].group == "files"
    tables = {"pixel": {"technology": "4t-bsi"}, "display": {"dots": 64}}
    assert by_name["4t-bsi"][2:] == ((), tables)
    assert by_name["imx477"].tables["pixel"]["full_well_e"] == 8180
    assert "Nikon D5100" in by_name
