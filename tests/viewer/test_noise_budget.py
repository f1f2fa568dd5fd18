"""Noise budgets: variances add up to the measured one, parts of ΔE to the whole, and what is not
there takes off nothing.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.chains import imaging_chain

import pixsim
from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera
from pixsim.report.noise_budget import budget_columns, budget_table
from pixsim.report.run import run_document, run_page
from pixsim.sensor import noise
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.motion_options import Motion
from pixsim.sensor.noise import SOURCES, NoiseSource, without_source
from pixsim.sensor.pixel import derive
from pixsim.sensor.pixel_options import Pixel
from pixsim.sensor.reading import Readout
from pixsim.sensor.readout import frame_variance_dn2, sample_sensor
from pixsim.show.render import text
from pixsim.studies.merit import noise_budgets
from pixsim.viewer.develop_options import Develop
from pixsim.viewer.display_options import Display
from pixsim.viewer.noise_budget import (
    APERTURE,
    DARK,
    LENS,
    MOTION,
    REDUCTION,
    ROUNDING,
    SAMPLING,
    SHOT,
    VEIL,
    NoiseBudget,
    finer_adc,
    noise_budget,
    noiseless_frame,
    without_denoising,
)

SIDE, SAMPLE_UM = 256, 2.0
NM = [450.0, 550.0, 620.0]
CAMERA = Camera(die_mm=SIDE * SAMPLE_UM / 1e3)
DISPLAY = Display(dots=64, bits=16, white_cd_per_m2=2e3)
# As large each as others: rounding by 10 bits is 4 e-.
ALL = {
    **{
        "technology": "4t-bsi",
        "pitch_um": 2.0,
        "bits": 10,
        "full_well_e": 14_000.0,
        "black_level_dn": 200,
        "quantum_efficiency": 0.5,
    },
    **{
        "read_noise_e": 12.0,
        "row_noise_e": 9.0,
        "dark_current_e_per_s": 9e3,
        "prnu": 0.004,
        "dsnu": 0.15,
    },
    **{"offset_fpn": 8e-4, "column_fpn": 6e-4, "stack": {"enabled": False}},
}
QUIET = dict.fromkeys(
    (
        "prnu",
        "dsnu",
        "read_noise_e",
        "row_noise_e",
        "dark_current_e_per_s",
        "offset_fpn",
        "column_fpn",
    ),
    0,
)


def light(**header: Any) -> SpectralImage:
    """Waves of detail, from half to all of white."""
    y, x = np.mgrid[:SIDE, :SIDE]
    picture = 0.75 + 0.25 * np.sin(x / 5 + y / 9)
    return SpectralImage([550.0], 10.0, SAMPLE_UM, data=0.006 * picture[..., None], header=header)


def budget(
    image: SpectralImage, camera: Camera = CAMERA, display: Display = DISPLAY, **pixel: Any
) -> NoiseBudget:
    chain = imaging_chain(
        image, camera, Pixel(**ALL | pixel), Exposure(integration_s=0.02, gain_db=0.0), display
    )
    found = noise_budget(chain, image, "budget", 1)
    assert sum(found.delta_e.values()) + found.remainder_delta_e == pytest.approx(
        found.mean_delta_e, abs=1e-12
    )
    return found


def test_variances_add_up_to_that_of_frames() -> None:
    """All sources at once, of like size, within 2 %: half a standard error of 256 columns and rows,
    12 sensors of them.
    """
    chain = imaging_chain(light(), CAMERA, Pixel(**ALL), Exposure(integration_s=0.02), DISPLAY)
    frames = [chain.capture("frames", number) for number in range(12)]
    assert max(frame.saturated_fraction for frame in frames) == 0
    assert min(frame.dn.min() for frame in frames) > 0
    off = [
        (frame.dn - frame.black_level_dn) / frame.dn_per_e - frame.mean_dark_e - frame.mean_e
        for frame in frames
    ]
    found = budget(light())
    assert {*found.electrons_e} == {
        ROUNDING,
        DARK,
        SHOT,
        *(source.name for source in SOURCES if source.name != "reset noise"),
    }
    assert found.total_e**2 == pytest.approx(np.mean(np.square(off)), rel=0.02)
    assert found.total_e**2 == pytest.approx(
        sum(e**2 for e in found.electrons_e.values()), rel=1e-12
    )
    readout, (first, *_) = chain.readout, frames
    closed = frame_variance_dn2(first.mean_e, 0.02, readout) / readout.dn_per_e**2
    assert found.total_e**2 == pytest.approx(float(closed.mean()), rel=1e-12)
    largest = max(found.electrons_e.values())
    assert all(e > 0.05 * largest for e in found.electrons_e.values()), found.electrons_e
    assert found.measured_e == pytest.approx(found.total_e, rel=0.05)


def test_causes_that_are_not_there_take_off_nothing() -> None:
    quiet = budget(light(diffraction=False), **QUIET)
    assert [*quiet.electrons_e] == [ROUNDING, SHOT]
    assert quiet.delta_e[LENS] == pytest.approx(0, abs=1e-9)
    assert VEIL not in quiet.delta_e
    assert quiet.remainder_delta_e == pytest.approx(0, abs=1e-9)
    assert quiet.delta_e[SAMPLING] > 0.01
    blurred, veiled = (
        budget(light(), camera, **QUIET)
        for camera in (CAMERA, CAMERA.model_copy(update={"veiling_glare": 0.05}))
    )
    assert blurred.delta_e[LENS] > 0.01
    assert veiled.delta_e[VEIL] > 0.1
    assert {name: veiled.delta_e[name] for name in (LENS, SAMPLING, APERTURE)} == {
        name: pytest.approx(blurred.delta_e[name], abs=1e-5) for name in (LENS, SAMPLING, APERTURE)
    }
    fine = budget(light(), display=DISPLAY.model_copy(update={"raster": "one_to_one"}), **QUIET)
    assert SAMPLING not in fine.delta_e
    assert fine.remainder_delta_e == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize("pattern", [None, "rggb"])
def test_blur_of_noise_reduction_is_its_own_and_not_that_of_the_lens(pattern: str | None) -> None:
    """Mosaic, colour and blur are those without it, and its line is what it does to the expected
    frame. To rounding.
    """
    filters = {"pattern": pattern, "sensitivities": "Sony_ILCE-7M4", "peak_quantum_efficiency": 0.5}
    image = SpectralImage(NM, 60.0, SAMPLE_UM, data=light().data * np.array([0.3, 0.4, 0.3]))
    found = []
    for denoise in ("none", "wiener_bound"):
        develop, pixel = (
            Develop(denoise=denoise),
            Pixel(**ALL | ({"colour": filters} if pattern else {})),
        )
        chain = imaging_chain(
            image, CAMERA, pixel, Exposure(integration_s=5e-5), DISPLAY, develop=develop
        )
        found.append(noise_budget(chain, image, "budget"))
    plain, reduced = found
    still = noiseless_frame(chain, 5e-5)
    blur = (
        chain.development.score(still).mean_delta_e
        - without_denoising(chain).development.score(still).mean_delta_e
    )
    assert REDUCTION not in plain.delta_e
    assert reduced.delta_e[REDUCTION] == pytest.approx(blur, abs=1e-12)
    assert blur > 0.05
    assert sum(reduced.delta_e.values()) + reduced.remainder_delta_e == pytest.approx(
        reduced.mean_delta_e, abs=1e-12
    )
    others = {name: value for name, value in plain.delta_e.items() if name not in plain.electrons_e}
    assert {name: reduced.delta_e[name] for name in others} == pytest.approx(others, abs=1e-9)
    assert reduced.remainder_delta_e == pytest.approx(plain.remainder_delta_e, abs=1e-9)


def test_motion_takes_off_what_it_adds() -> None:
    """Without noise, motion takes off what a moving picture has more than a still one, scored on
    the same part.
    """
    found = []
    for speed in (400.0, 0.0):
        motion = Motion(image_um_per_s=(speed, 0.0), margin_um=20.0)
        settings = {"motion": motion, "border_um": 40.0}
        chain = imaging_chain(
            light(), CAMERA, Pixel(**ALL | QUIET), Exposure(integration_s=0.02), DISPLAY, **settings
        )
        found.append(noise_budget(chain, light(), "budget"))
    moving, still = found
    assert MOTION not in still.delta_e
    assert moving.delta_e[MOTION] > 0.05
    less = {
        name: moving.delta_e[name] - still.delta_e.get(name, 0.0)
        for name in moving.delta_e
        if name not in moving.electrons_e
    }
    assert less == {
        name: pytest.approx(moving.delta_e[MOTION] if name == MOTION else 0.0, abs=1e-4)
        for name in less
    }


@pytest.mark.parametrize("source", [source.name for source in SOURCES])
def test_a_source_that_is_off_is_drawn_no_more(source: str) -> None:
    readout = Readout.of(derive(Pixel(**ALL, hot_pixel_fraction=0.01, hot_pixel_median=30.0)))
    without = without_source(readout, source)
    (removed,) = (each for each in SOURCES if each.name == source)
    whole, left = (
        float(frame_variance_dn2(5000.0, 0.02, p)) / readout.dn_per_e**2 for p in (readout, without)
    )
    charge = {"": 1.0, "light": 5000.0, "dark": 180.0}[removed.grows_with]
    assert whole - left == pytest.approx(
        (removed.deviation(readout) * charge) ** 2, rel=1e-9, abs=1e-9
    )
    maps = {
        "PRNU": "gain",
        "DSNU": "dark_gain",
        "column FPN": "column_offset_e",
        "offset FPN": "offset_e",
    }
    drawn = [sample_sensor(p, (8, 8), np.random.default_rng(0)) for p in (readout, without)]
    for name, drawn_map in maps.items():
        assert getattr(drawn[0], drawn_map) is not None
        assert (getattr(drawn[1], drawn_map) is None) == (name == source)


def test_a_new_source_has_its_line(monkeypatch: pytest.MonkeyPatch) -> None:
    new = NoiseSource("a new source", lambda _: 30.0, is_temporal=True)
    monkeypatch.setattr(noise, "SOURCES", (*SOURCES, new))
    found = budget(light(), **QUIET)
    assert found.electrons_e["a new source"] == pytest.approx(30, rel=1e-12)
    assert found.delta_e["a new source"] > 0


def test_finer_adc_has_the_same_range() -> None:
    readout = Readout.of(derive(Pixel(**ALL))).at(Exposure(gain_db=12.0))
    finer = finer_adc(readout)
    assert finer.adc_range_e == pytest.approx(readout.adc_range_e, rel=2**-9)
    assert finer.dn_per_e / readout.dn_per_e == pytest.approx(256, rel=1e-12)
    assert finer.adc.black_level_dn / finer.dn_per_e == pytest.approx(
        readout.adc.black_level_dn / readout.dn_per_e, rel=1e-12
    )
    assert finer_adc(replace(readout, adc=replace(readout.adc, bits=24))).adc.bits == 31


def test_run_tells_its_budget_where_it_is_asked() -> None:
    settings: dict[str, Any] = {
        "pixel": {"pitch_um": 21.2},
        "resolution": 64,
        "display": {"dots": 32},
    }
    plain, asked = pixsim.run("csf", **settings), pixsim.run("csf", **settings, noise_budget=True)
    assert plain.noise_budget is None
    assert "noise_budget" not in plain.as_dict()
    assert asked.mean_delta_e == plain.mean_delta_e
    found = asked.as_dict()["noise_budget"]
    assert found["mean_delta_e"] == asked.mean_delta_e
    assert [*found["delta_e"]][:2] == [ROUNDING, "column FPN"]
    assert "shot noise of light" in text(run_document(asked))
    page = run_page(asked)
    assert [section.id for section in page.sections].count("causes") == 1


def test_study_tells_the_budget_of_each_best_size(tmp_path: Path) -> None:
    table: dict[str, Any] = {
        "technologies": ["0.35um"],
        "repeats": 2,
        "resolution": 64,
        "display": {"dots": 32},
    }
    table |= {
        "name": "a",
        "pitch": {"values_um": [13.0, 16.0, 19.0, 22.0, 26.0]},
        "noise_budget": True,
    }
    result = pixsim.study(pixsim.Study(**table), tmp_path, jobs=1)
    (label, found), *others = noise_budgets(result).items()
    curve = result.curves[0]
    best = int(np.argmin(curve.mean()))
    assert not others
    assert label == f"0.35um, {curve.pitch_um[best]:.3g} µm"
    (score,) = result.scores("0.35um", float(curve.pitch_um[best]), 1)
    assert found.mean_delta_e == pytest.approx(
        score.mean_delta_e, rel=1e-5
    )  # studies are in single precision
    columns = budget_columns({label: found})
    for part, delta_e in found.parts.items():
        of_causes = [
            value
            for value, name in zip(columns["delta_e"], columns["part"], strict=True)
            if name == part
        ]
        assert sum(of_causes) == pytest.approx(delta_e, abs=1e-12)
    rows = {row[0]: row[2] for row in budget_table({label: found}).rows}
    sums = {
        "all causes": found.mean_delta_e,
        **{f"{part}, together": found.parts[part] for part in ("noise", "blur")},
    }
    assert {name: rows[name] for name in sums} == {
        name: f"{value:z.3f}" for name, value in sums.items()
    }
