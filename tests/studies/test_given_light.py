"""A study of light that is given, rendered or of another program, in place of a scene."""

import numpy as np
import pytest
from helpers.tiny import COARSE, rows

import pixsim
from pixsim import Camera, PixsimError, SpectralImage, study
from pixsim.report.axes import axes_page
from pixsim.show.render import html
from pixsim.studies.regret import condition_regrets

SMALL = """name = "small"
repeats = 2
pitch.values_um = [20, 28, 40, 56, 80]
display.dots = 48
"""
SCENE = (
    f'resolution = {COARSE}\nscene = {{file = "csf", parameters = {{luminance_cd_per_m2 ='
    " 100.0}}\n"
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("given")
    (path / "small.toml").write_text(SMALL)
    (path / "scene.toml").write_text(SMALL + SCENE)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PIXSIM_CACHE_DIR", str(path / "cache"))
        yield path


def other_light(seed=1):
    """Of another program, 2.7 mm wide, without a camera or a white in its header."""
    data = 1e-3 * (1 + np.random.default_rng(seed).random((64, 64, 3)))
    return SpectralImage(
        [450.0, 550.0, 620.0],
        30.0,
        2700 / 64,
        data=data.astype(np.float32),
        header={"source": "other.exr"},
    )


def rows_in(folder):
    return [
        {name: value for name, value in row.items() if name not in ("key", "check")}
        for row in rows(folder)
    ]


def test_the_light_of_a_study_gives_its_rows_again_bit_for_bit(folder):
    """Only the keys differ, and the film's error is not known."""
    rendered = study(folder / "scene.toml", folder / "rendered", jobs=1)
    given = study(folder / "small.toml", folder / "given", light=rendered.irradiance, jobs=1)
    assert rows_in(folder / "given") == rows_in(folder / "rendered")
    assert given.camera == rendered.camera
    assert given.film is None
    assert rendered.as_dict()["film"]["resolution"] == rendered.irradiance.shape[1] == COARSE


def test_light_of_another_program_has_a_curve_a_page_and_settings(folder):
    """Rows of one light are not taken for those of another, whose header says the same."""
    own = {
        "camera": Camera(die_mm=2.7, f_number=5.6),
        "display": {"white_cd_per_m2": 5000.0},
        "jobs": 1,
    }
    first = study(folder / "small.toml", folder / "other", light=other_light(), **own)
    assert first.camera.f_number == 5.6
    assert first.curves[0].optimum.mean_delta_e > 0
    page = pixsim.write_report(first, folder / "page").read_text()
    assert "read from other.exr. Study seed 0" in page
    again = study(folder / "page" / "settings.toml", folder / "again", light=other_light(), jobs=1)
    assert rows_in(folder / "again") == rows_in(folder / "other")
    assert np.array_equal(again.curves[0].delta_e, first.curves[0].delta_e)
    second = study(folder / "small.toml", folder / "other", light=other_light(2), **own)
    assert not np.array_equal(second.curves[0].delta_e, first.curves[0].delta_e)
    with pytest.raises(PixsimError, match=r"scene\.file: got light that was given in Python"):
        study(folder / "page" / "settings.toml", folder / "without")


def test_a_target_in_given_light_is_judged_as_in_the_light_of_its_scene(folder, tmp_path):
    """Its rows, bit for bit; those of another light without the target, whose header says the same,
    are others.
    """
    metrics = {"metrics": ["detectability", "npwe"], "jobs": 1}
    target = {"size_um": 300.0, "contrast": 0.1, "luminance_cd_per_m2": 100.0}
    rendered = study(
        folder / "small.toml",
        tmp_path / "rendered",
        scene="target",
        parameters=target,
        resolution=COARSE,
        **metrics,
    )
    own = {"light": rendered.irradiance} | metrics
    given = study(
        folder / "small.toml", tmp_path / "given", without=rendered.light.background, **own
    )
    assert rows_in(tmp_path / "given") == rows_in(tmp_path / "rendered")
    assert "light=…, without=…), of the light of digest" in given.settings_toml
    curve = given.curves[0]
    least = curve.as_dict()["metrics"]["least_detectability"]
    assert least == curve.statistics["least_detectability"].min(axis=1).tolist(), (
        "the worst, not the mean of the worst"
    )
    dark = rendered.light.background
    study(
        folder / "small.toml",
        tmp_path / "given",
        without=dark.with_planes(1.02 * dark.planes),
        **own,
    )
    assert rows_in(tmp_path / "given") != rows_in(tmp_path / "rendered")


def test_a_file_of_light_may_be_that_without_the_target(folder, tmp_path):
    """In the settings of a run and of a study, beside light of a file."""
    light, without = tmp_path / "with.npz", tmp_path / "without.npz"
    y, x = np.mgrid[:64, :64] - 31.5
    for path, contrast in ((light, 0.1), (without, 0.0)):
        data = 1e-3 * (1 + contrast * (np.hypot(y, x) < 8.0))[..., None]
        image = SpectralImage(
            [550.0], 30.0, 2700 / 64, data=data.astype(np.float32), header={"source": path.name}
        )
        pixsim.write_npz(path, image)
    judged = {"metrics": ["detectability"], "display": {"white_cd_per_m2": 5000.0, "dots": 48}}
    found = pixsim.run(
        light, metric={"detectability": {"without": str(without)}}, **judged
    ).statistics[0]["detectability"]
    own = {"display": pixsim.Display(**judged["display"]), "metrics": ["detectability"]}
    images = [pixsim.read_irradiance(path) for path in (light, without)]
    wanted = pixsim.evaluate(
        images[0], Camera(die_mm=2.7), pixsim.Pixel(), without=images[1], **own
    )
    assert found == wanted.metrics["detectability"] > 1
    with pytest.raises(PixsimError, match=r"without=…\): picture: got 'none\.npz'"):
        pixsim.run(light, metric={"detectability": {"without": "none.npz"}}, **judged)


def test_axes_and_conditions_vary_the_sensor_in_a_given_light(folder):
    axis = [{"name": "noise", "set": "pixel.row_noise_e", "values": [0.0, 20000.0]}]
    condition = [
        {"name": "long", "set": {"exposure": {"max_integration_s": 0.1}}},
        {"name": "short", "set": {"exposure": {"max_integration_s": 1e-3}}},
    ]
    more = {"axis": axis, "condition": condition, "display": {"white_cd_per_m2": 5000.0}, "jobs": 1}
    result = study(folder / "small.toml", folder / "axes", light=other_light(), **more)
    means = {
        (float(curve.at["noise"]), curve.condition): curve.mean().mean() for curve in result.curves
    }
    assert means[0.0, "long"] < means[20000.0, "long"]
    assert means[0.0, "long"] < means[0.0, "short"]
    page = html(axes_page(result, condition_regrets(result.study, result.curves), []))
    assert "read from other.exr" in page


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"scene": "csf"}, "scene: got a value beside light; allowed: one of the two"),
        ({"parameters": {"resolution": 64}}, "parameters: got a value beside light"),
        (
            {"axis": [{"name": "f", "set": "camera.f_number", "values": [2.0, 4.0]}]},
            "axis: got camera.f_number in a study whose",
        ),
        (
            {"condition": [{"name": "a", "set": {"scene": {"file": "csf"}}}]},
            "axis: got scene.file in a study whose light is given",
        ),
        ({"window_mm": 1.0}, "window_mm: got a value in a study whose light is given"),
        (
            {"tolerance_delta_e": 0.1},
            "tolerance_delta_e: got a value in a study whose light is given",
        ),
        ({"variant": "scalar_spectral"}, "variant: got a value in a study whose light is given"),
        ({"camera": {"die_mm": 5.0}}, "pitch of 'the light that is given': got"),
        (
            {"metrics": ["delta_e", "detectability"]},
            "'detectability'; allowed: light of the scene without its target",
        ),
        (
            {"metrics": ["niirs"]},
            r"'niirs'; allowed: the distance of the ground: .*object_distance_m.*ground_distance_m",
        ),
    ],
)
def test_what_given_light_does_not_have_says_so(folder, more, message):
    with pytest.raises(PixsimError, match=message):
        study(folder / "small.toml", folder / "refused", light=other_light(), **more)


def test_a_picture_in_place_of_a_scene_says_how_to_give_it(folder):
    with pytest.raises(
        PixsimError,
        match=r"'mine.exr', a picture; allowed: a Mitsuba scene. In Python: .*read_irradiance",
    ):
        study(folder / "small.toml", folder / "refused", scene="mine.exr")
