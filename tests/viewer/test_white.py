"""The white of a scene that states none: at most 1 % of the ideal image is beyond it, whatever the
light and the sensor.
"""

from __future__ import annotations

import math
import re
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.chains import imaging
from helpers.commands import command
from helpers.sheets import sheet

import pixsim
from pixsim.base.arrays import Array
from pixsim.base.caller import command_line
from pixsim.light.spectral import SpectralImage
from pixsim.optics import irradiance_factor
from pixsim.optics.camera import Camera
from pixsim.optics.exchange import write_npz
from pixsim.scene.packaged import packaged_scenes
from pixsim.sensor.pixel_options import Pixel
from pixsim.studies.comparison import Comparison
from pixsim.viewer.display import XYZ_FROM_RGB
from pixsim.viewer.display_options import Display
from pixsim.viewer.screen import (
    LightLevel,
    amount_of_white,
    colour_chart_of,
    fraction_beyond_white,
    ideal_on_dots,
    white_header,
)

NM = np.arange(405.0, 900.0, 10.0)
CAMERA, DISPLAY = Camera(focal_length_mm=4.0, die_mm=0.32), Display(dots=64)
LIGHTS = {
    "daylight": pixsim.spectral.d65(NM),
    "2856 K": NM**-5.0 / np.expm1(1.4388e7 / NM / 2856),
    "LED of 850 nm and some daylight": (
        30 * np.exp(-(((NM - 850) / 20) ** 2)) + pixsim.spectral.d65(NM) / 100
    ),
}
PIXELS = {
    "paper": Pixel(pitch_um=8.0),
    "silicon": Pixel(technology="4t-bsi", pitch_um=5.0),
    "infrared cut": Pixel(technology="4t-bsi", pitch_um=5.0, infrared_cut_nm=650.0),
    "colour": Pixel.model_validate(
        {
            "technology": "4t-bsi",
            "pitch_um": 5.0,
            "infrared_cut_nm": 650.0,
            "colour": {
                "pattern": "rggb",
                "sensitivities": "Nikon_D700",
                "peak_quantum_efficiency": 0.5,
            },
        }
    ),
}


def picture(spectrum: Array, relative: Array | None = None) -> SpectralImage:
    """A ramp with noise, as data: nothing states its white."""
    ramp = (
        np.linspace(0.02, 1.0, 64) * np.random.default_rng(1).uniform(0.9, 1.1, (64, 64))
        if relative is None
        else relative
    )
    return SpectralImage(
        NM,
        10.0,
        5.0,
        data=1e-3 * ramp[:, :, None] * spectrum / spectrum.max(),
        header={"diffraction": False},
    )


@pytest.mark.parametrize("light", LIGHTS)
@pytest.mark.parametrize("sensor", PIXELS)
def test_at_most_one_per_cent_of_the_ideal_image_is_beyond_an_unstated_white(
    light: str, sensor: str
) -> None:
    """And more than that is beyond the next smaller number of two digits."""
    image, asked = picture(LIGHTS[light]), imaging(CAMERA, PIXELS[sensor], display=DISPLAY)
    with pytest.warns(UserWarning, match="does not define its white"):
        white = white_header([(asked, image)])["luminance_cd_per_m2"]
    unit = 10.0 ** (math.floor(math.log10(white)) - 1)
    shares = []
    for cd_per_m2 in (white, white - unit):
        seen = asked.changed(display=DISPLAY.model_copy(update={"white_cd_per_m2": cd_per_m2}))
        shares.append(
            fraction_beyond_white(ideal_on_dots(seen, image, colour_chart_of(seen, image))[1])
        )
    assert shares[0] <= 0.01 < shares[1]


@pytest.mark.parametrize("sensor", PIXELS)
def test_even_picture_is_scored_by_its_noise(sensor: str) -> None:
    """All of it was beyond white, 100 % of both pictures clipped, and ΔE 0."""
    image = picture(LIGHTS["daylight" if sensor == "colour" else "2856 K"], np.ones((64, 64)))
    with pytest.warns(UserWarning, match="does not define its white"):
        score = pixsim.evaluate(image, CAMERA, PIXELS[sensor], display=DISPLAY)
    shown = score.ideal if score.ideal.ndim == 2 else score.ideal @ (XYZ_FROM_RGB[1] / 100)
    assert 0.89 < shown.min() <= shown.max() <= 1.0  # rounded up to two digits
    assert score.mean_delta_e > 0.01


def test_run_and_evaluate_take_one_white_and_speak_to_their_caller(tmp_path: Path) -> None:
    image, path = picture(LIGHTS["2856 K"]), tmp_path / "light.npz"
    write_npz(path, image)
    camera = (
        "--camera.focal-length-mm 4 --camera.die-mm 0.32 --display.dots 64 --pixel.technology"
        " 4t-bsi --pixel.pitch-um 5"
    )
    code, out, err = command(f"run {path} {camera} --seed 3 --json --out {tmp_path / 'out'}")
    assert code == 0, err
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        score = pixsim.evaluate(
            pixsim.read_irradiance(path, CAMERA), CAMERA, PIXELS["silicon"], display=DISPLAY, seed=3
        )
    assert f'"mean_delta_e": {score.mean_delta_e!r}' in out
    (said,) = (str(one.message) for one in caught)
    before, _, value = said.partition("; set Display(white_cd_per_m2=")
    assert f"{before}; set --display.white-cd-per-m2 {value.replace(')', '')}" in err


def test_refusal_of_a_dark_picture_speaks_to_its_caller() -> None:
    image = picture(LIGHTS["daylight"], np.zeros((64, 64)))
    seen = [(imaging(CAMERA, PIXELS["silicon"], display=DISPLAY), image)]
    with pytest.raises(
        pixsim.PixsimError, match=r"too dark to estimate it.*Set Display\(white_cd_per_m2=…\)\."
    ):
        white_header(seen)
    with (
        command_line(),
        pytest.raises(pixsim.PixsimError, match=r"Set --display\.white-cd-per-m2\."),
    ):
        white_header(seen)


def test_sensors_share_the_largest_of_their_whites() -> None:
    seen = [
        (imaging(CAMERA, pixel, display=DISPLAY), picture(LIGHTS["2856 K"]))
        for pixel in PIXELS.values()
    ]
    with pytest.warns(UserWarning, match="the largest of these sensors'"):
        white = white_header(seen)
    with pytest.warns(UserWarning, match="in the sensor's response, rounded up"):
        each = [white_header([one])["luminance_cd_per_m2"] for one in seen]
    assert white["luminance_cd_per_m2"] == max(each) > 1.2 * min(each)


@pytest.mark.slow  # the test above has the claim
def test_sensors_of_a_comparison_share_one_white(tmp_path: Path) -> None:
    """The largest of theirs, whichever comes first: the ideal image of neither is clipped."""
    text = (packaged_scenes()["macbeth"]).read_text(encoding="utf-8")
    own = tmp_path / "own.xml"
    for name in ("spectra", "charts"):
        if (folder := packaged_scenes()["macbeth"].parent / name).is_dir():
            (tmp_path / name).symlink_to(folder)
    own.write_text(
        "\n".join(line for line in text.splitlines() if "white_cd_per_m2" not in line),
        encoding="utf-8",
    )
    files = [sheet(tmp_path / "plain.toml"), sheet(tmp_path / "cut.toml")]
    Path(files[1]).write_text(
        Path(files[1]).read_text(encoding="utf-8") + "infrared_cut_nm = 600\n", encoding="utf-8"
    )

    def white(order: list[Any]) -> tuple[float, Comparison]:
        with pytest.warns(UserWarning, match="does not define its white"):
            result = pixsim.compare(
                order, own, display={"dots": 32}, resolution=48, render_noise=5.0, repeats=2, jobs=1
            )
        (one,) = {sensor.light.image.header["luminance_cd_per_m2"] for sensor in result.sensors}
        return one, result

    first, result = white(files)
    assert first == white(files[::-1])[0]
    for sensor in result.sensors:
        shown, camera = result.shown, sensor.case.camera
        seen = imaging(
            camera,
            sensor.score.physics.pixel,
            display=shown.display,
            border_um=shown.border_um(camera),
        )
        assert np.mean(amount_of_white(seen, sensor.light.image) > first) <= 0.01


# --- light that nobody sees ---


def infrared(scale: float = 1.0, **header: Any) -> SpectralImage:
    """Detail under light around 940 nm."""
    y, x = np.mgrid[:64, :64]
    picture = 0.5 + 0.4 * np.sin(x / 4) * np.cos(y / 6)
    light = picture[..., None] * np.array([0.5, 1.0, 0.5]) * 0.01 * scale
    return SpectralImage(
        [930.0, 940.0, 950.0], 10.0, 4.0, data=light, header={"diffraction": False, **header}
    )


SEES_INFRARED = Pixel(
    **{
        "technology": "4t-bsi",
        "pitch_um": 4.0,
        "quantum_efficiency": [[400, 0.6], [1000, 0.2]],
        "black_level_dn": 60,
    },
    stack={"enabled": False},
)


def test_white_of_infrared_light_is_a_radiance() -> None:
    """The percentile of the picture, rounded up; E = π L sin²α of a plate of it on the axis;
    nothing depends on its scale.
    """
    camera = Camera(die_mm=0.256)
    display = Display(dots=32)
    with pytest.warns(
        UserWarning, match=r"using ([\d.e+-]+) W m⁻² sr⁻¹, the 99th percentile .*white_w_per_m2_sr="
    ) as caught:
        score = pixsim.evaluate(infrared(), camera, SEES_INFRARED, display=display)
    found = float(re.search(r"using ([\d.e+-]+) W", str(caught[0].message))[1])
    factor = float(irradiance_factor(camera.f_number, 0.0, camera.magnification))
    brightest = float(infrared().data.sum(axis=2).max()) * 10 / factor
    assert 0.85 * brightest < found < 1.1 * brightest
    given = pixsim.evaluate(
        infrared(),
        camera,
        SEES_INFRARED,
        display=display.model_copy(update={"white_w_per_m2_sr": found}),
    )
    assert given.mean_delta_e == score.mean_delta_e
    half = display.model_copy(update={"white_w_per_m2_sr": found / 2})
    np.testing.assert_array_equal(
        pixsim.evaluate(infrared(0.5), camera, SEES_INFRARED, display=half).ideal, score.ideal
    )
    named = pixsim.evaluate(
        infrared(white_w_per_m2_sr=found), camera, SEES_INFRARED, display=display
    )
    assert named.mean_delta_e == score.mean_delta_e


def test_luminance_of_light_that_nobody_sees_is_refused() -> None:
    with pytest.raises(
        pixsim.PixsimError,
        match=r"The white of light that nobody sees is a radiance \(Display\(white_w_per_m2_sr",
    ):
        pixsim.evaluate(
            infrared(),
            Camera(die_mm=0.256),
            SEES_INFRARED,
            display=Display(dots=32, white_cd_per_m2=100.0),
        )
    with pytest.raises(
        pixsim.PixsimError, match="white_cd_per_m2 and white_w_per_m2_sr state the same quantity"
    ):
        Display(dots=32, white_cd_per_m2=100.0, white_w_per_m2_sr=4.0)


@pytest.mark.parametrize("lamp", ["led_850nm", "led_940nm"])
def test_chart_under_an_infrared_lamp_is_scored(lamp: str, tmp_path: Path) -> None:
    """White is the radiance of texel value 1; of a lit scene it is estimated. The packaged lamps
    shine where they say.
    """
    table = np.loadtxt(packaged_scenes()["csf"].parent / f"spectra/{lamp}.spd")
    peak_nm = table[table[:, 1].argmax(), 0]
    assert peak_nm == float(lamp[4:7])
    above = table[table[:, 1] >= table[:, 1].max() / 2, 0]
    assert 25 <= np.ptp(above) <= 45
    assert np.trapezoid(table[:, 1], table[:, 0]) == pytest.approx(5.0, rel=1e-3)
    text = ", ".join(f"{nm:g}:{value:.6g}" for nm, value in table)
    (tmp_path / "lamp.xml").write_text(
        '<scene version="3.0.0"><integrator type="path"/><sensor type="thinlens"><float name="fov"'
        ' value="38"/><float name="aperture_radius" value="0.0005"/><float name="focus_distance"'
        ' value="1"/><transform name="to_world"><lookat origin="0,0,0" target="0,0,1"'
        ' up="0,1,0"/></transform></sensor><shape type="rectangle"><transform'
        ' name="to_world"><scale value="3"/><lookat origin="0,0,1" target="0,0,0"'
        ' up="0,1,0"/></transform><emitter type="area"><spectrum name="radiance"'
        f' value="{text}"/></emitter></shape></scene>',
        encoding="utf-8",
    )
    pixel = {
        "technology": "4t-bsi",
        "pitch_um": 21.2,
        "quantum_efficiency": [[400, 0.6], [1000, 0.2]],
        "black_level_dn": 60,
    }
    result = pixsim.run(tmp_path / "lamp.xml", pixel=pixel, resolution=64, display={"dots": 32})
    assert result.irradiance.header["white_w_per_m2_sr"] == pytest.approx(5.0, rel=1e-3)
    assert "display white is 5 W m⁻² sr⁻¹ in the scene" in str(
        LightLevel.of(result.irradiance, Display(), [0.01])
    )
    white, middle = (
        result.score.ideal.max(),
        result.score.ideal[result.score.ideal.shape[0] // 2].max(),
    )
    assert white == middle == pytest.approx(1.0, abs=0.01)  # on the axis, but for codes
