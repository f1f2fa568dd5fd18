"""No setting does nothing in silence: it changes the result, or a message names it."""

from __future__ import annotations

import math
import re
import warnings
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from helpers.sheets import sheet
from helpers.tiny import tiny

import pixsim
from pixsim.base.layers import nested
from pixsim.base.toml import packaged
from pixsim.light.spectral import SpectralImage
from pixsim.measure.datasheet import UNUSED_SETTINGS, datasheet_settings
from pixsim.optics.camera import Camera, CameraOptions
from pixsim.optics.camera_lens import camera_with_lens
from pixsim.optics.lens_options import ANY_LENS_FIELDS, LensOptions
from pixsim.scene.scene import Scene
from pixsim.sensor.colour_options import ColourOptions
from pixsim.sensor.correction_options import Correction
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.motion_options import Motion
from pixsim.sensor.pixel_options import NUMBERS, DarkCurrent, Pixel
from pixsim.sensor.stack_options import StackOptions
from pixsim.studies import sensors
from pixsim.studies.design import Case, cases_of, metrics_of, study_pitches_um, with_range_ends
from pixsim.studies.files import load_study
from pixsim.studies.prepare import cases_to_try, loaded_scene, prepare, settings_of_technology
from pixsim.studies.run import prepare as prepare_run
from pixsim.studies.settings import Study
from pixsim.verification.ladder import NOT_TAKEN
from pixsim.viewer.develop_options import Develop
from pixsim.viewer.display_options import Display
from pixsim.viewer.imaging import Imaging
from pixsim.viewer.merging import merge
from pixsim.viewer.metric_options import METRIC_OPTIONS, MetricOptions
from pixsim.viewer.setting import Run
from pixsim.viewer.settings_file import run_settings
from pixsim.viewer.without_effect import ROWS, Default, UserSettings, effect_notes, record_with

NOTHING = "nothing here"
SIDE, SAMPLE_UM, WIDTH_NM = 24, 4.0, 40.0
DIE_MM = 1e-3 * SIDE * SAMPLE_UM


def picture(wavelength_nm: np.ndarray) -> SpectralImage:
    """Coloured detail, as bright as a sunlit scene: exposures are short, so that no limit of time
    decides.
    """
    rng = np.random.default_rng(5)
    grey, is_blue = 0.1 + 0.9 * rng.random((SIDE, SIDE)), rng.random((SIDE, SIDE)) < 0.5
    spectra, pictures = (
        3e-2 * np.stack([600 / wavelength_nm, wavelength_nm / 600]),
        grey * np.stack([is_blue, ~is_blue]),
    )
    return SpectralImage(
        wavelength_nm,
        WIDTH_NM,
        SAMPLE_UM,
        factors=(spectra, pictures),
        header={"luminance_cd_per_m2": 1.5e5},
    )


LIGHT = picture(np.arange(420.0, 820.0, WIDTH_NM))
BEHIND_LENS = picture(
    np.array([450.0, 550.0, 650.0])
)  # few bands: the lens's blur is traced for each
BASE: dict[str, Any] = {
    "camera": {"die_mm": DIE_MM, "focal_length_mm": 0.12},
    "display": {"dots": SIDE},
}
BASE["exposure"] = {"max_integration_s": 10.0}
RANGE_NM = np.arange(400.0, 701.0, 20.0)


def bells(height: float) -> dict[str, list[list[float]]]:
    """Responses of three channels."""
    peaks = {"R": 600.0, "G": 540.0, "B": 460.0}
    curves = {
        name: 0.01 + height * np.exp(-(((RANGE_NM - peak) / 50) ** 2))
        for name, peak in peaks.items()
    }
    return {name: np.stack([RANGE_NM, curve], axis=1).tolist() for name, curve in curves.items()}


SHEET = {
    "pitch_um": 5.0,
    "full_well_e": 8000,
    "read_noise_e": 3.0,
    "dark_current_e_per_s": 2e7,
    "quantum_efficiency": 0.6,
}
SHEET |= {"prnu": 0.01, "dsnu": 0.3, "bits": 12, "black_level_dn": 60}
AT_20_C = {name: value for name, value in SHEET.items() if name != "dark_current_e_per_s"}
AT_20_C |= {"dark_current": {"e_per_s": 2e7, "at_c": 20.0}}
# Shifted nowhere and high, so that the corners have a few per cent less charge: some codes differ
# where that is corrected.
STACK = {"height_um": 7.5, "index": 1.5, "microlens": "square", "shift": "none"}
COLOUR = {"quantum_efficiencies": bells(0.5)}
QUICK_FIT = {
    "develop": {"matrix": "least_squares"}
}  # of the colour matrix: the default one takes a quarter of a second


FAINT = SHEET | {
    "dark_current_e_per_s": 5.0
}  # so that dark charge does not hide what else there is


def of(technology: str, **pixel: Any) -> dict[str, Any]:
    return {"pixel": {"technology": technology, "black_level_dn": 60, **pixel}}


def coloured(colour: dict[str, Any], **pixel: Any) -> dict[str, Any]:
    return {"pixel": {**SHEET, **pixel, "colour": colour}, **QUICK_FIT}


CONFIGURATIONS: dict[str, dict[str, Any]] = {
    "3T": of("0.35um"),
    "3T, stack": of(
        "0.35um",
        stack={"height_um": 6.0, "index": 1.5, "depletion_um": 1.0, "diffusion_length_um": 10.0},
    ),
    "4T": of("4t-bsi", pitch_um=2.0, dark_current_e_per_s=1e7),
    "data sheet": {"pixel": SHEET},
    "data sheet, stack": {"pixel": {**SHEET, "stack": STACK}},
    "colour by sensitivities": coloured(
        {"sensitivities": "Nikon_D5100", "peak_quantum_efficiency": 0.5}
    ),
    "colour by quantum efficiencies": coloured(COLOUR),
    "colour by transmittances": of("0.35um", colour={"transmittances": bells(0.8)}) | QUICK_FIT,
    "one dot a pixel": {"pixel": SHEET, "display": {"raster": "one_to_one"}},
}
# Without and with a stack, in colour, and with dots of pixels. The others are other ways to state
# such pixels: only what states them is moved there.
WHOLE = ("3T", "4T", "colour by quantum efficiencies", "one dot a pixel")
SLOW: dict[str, dict[str, Any]] = {  # the same rules with other values of what they look at
    "3T, forward bias": of("0.35um", well_limit="diode", conversion="junction"),
    "3T, capacitance of the paper": of("0.35um", capacitance="paper"),
    "3T, numbers of its own": of("0.35um", **AT_20_C, fill_factor=0.5, reset_noise_factor=0.0),
    "4T, stack off": of("4t-bsi", pitch_um=2.0, stack={"enabled": False}),
    "4T, front-lit, colour": (
        of("4t-fsi", pitch_um=2.0, dark_current_e_per_s=1e7, colour=COLOUR) | QUICK_FIT
    ),
    "data sheet, no dark current": {"pixel": {**SHEET, "dark_current_e_per_s": 0.0}},
    "data sheet, dark current at 20 °C": {"pixel": AT_20_C},
    "data sheet, opening": {
        "pixel": {**SHEET, "stack": {**STACK, "microlens": "none"}, "fill_factor": 0.5}
    },
    "stacked channels": coloured({**COLOUR, "pattern": "stacked"}),
    "binning": coloured({**COLOUR, "pattern": "quad_rggb", "binning": True}, pitch_um=4.0),
    "colour, one dot a pixel": coloured(COLOUR) | {"display": {"raster": "one_to_one"}},
    "manual exposure": of("0.35um") | {"exposure": {"integration_s": 2e-4}},
    "flat frames": (
        of("4t-bsi", pitch_um=2.0, dark_current_e_per_s=1e6)
        | {"correction": {"flat_frames": 2, "dark_frames": 2}}
    ),
    # At 25° the shading, 2e-4, is below the steps of the display.
    "chief rays": (
        of("4t-bsi", pitch_um=2.0, dark_current_e_per_s=1e7)
        | {"camera": {"chief_ray_angle": [[0, 0], [0.07, 35]]}}
    ),
    "real lens": of("0.35um") | {"lens": {"file": "phone", "focal_length_mm": 1.0}},
}

# Every setting of a frame, moved; a tuple has alternatives, of which one is another value in any
# configuration.
MOVES: dict[str, Any] = {
    "camera.focal_length_mm": 0.15, "camera.f_number": 2.8, "camera.die_mm": 0.08, "camera.die_height_mm": (0.08, 0.2),
    "camera.object_distance_m": 0.02, "camera.transmittance": 0.5,
    "camera.chief_ray_angle": ([[0, 0], [0.07, 15]], [[0, 0, 1], [0.07, 15, 0.5]]),
    "lens.file": "singlet", "lens.focal_length_mm": 1.5, "lens.refocus": "paraxial", "lens.focus_nm": 850.0,
    "lens.ideal": "undistorted",
    "lens.configuration": 2, "lens.semi_diameters": "clip", "lens.vignetting_factors": ("use", "ignore"),
    "lens.glass_catalogues": "no.agf", "lens.unknown_glass": "model",
    "lens.veiling_glare": 0.2, "lens.veiling_glare_outside": 3.0, "lens.relative_illumination": [[0, 1], [0.07, 0.5]],
    "pixel.capacitance": ("paper", "mosis"), "pixel.well_limit": ("diode", "swing"), "pixel.conversion": ("junction", "linear"),
    "pixel.response": "literal", "pixel.quantum_efficiency": 0.3, "pixel.quantum_efficiency_includes": ("photodiode", "microlens"),
    "pixel.quantum_efficiency_nm": 450.0, "pixel.quantum_efficiency_depth_um": 3.0,
    "pixel.quantum_efficiency_f_number": 2.0, "pixel.quantum_efficiency_pitch_um": 3.0, "pixel.infrared_cut_nm": (650.0, 2000.0),
    "pixel.fill_factor_law": "inset", "pixel.fill_factor": 0.45,
    "pixel.full_well_e": 5000.0, "pixel.saturation_capacity_e": 5000.0, "pixel.gain_e_per_dn": 3.0, "pixel.dn_per_e": 0.4,
    "pixel.adc_full_scale_e": 6000.0, "pixel.dark_current_e_per_s": 5e7, "pixel.dark_current": {"e_per_s": 5e7, "at_c": 20.0},
    "pixel.dark_current.e_per_s": 4e6, "pixel.dark_current.at_c": 0.0, "pixel.dark_current.doubling_k": 5.0,
    "pixel.data_sheet_pitch_um": 6.0, "pixel.read_noise_e": 60.0, "pixel.read_noise_after_gain_e": 60.0,
    "pixel.temporal_dark_noise_e": 60.0, "pixel.reset_noise_factor": 2.0, "pixel.prnu": 0.05, "pixel.prnu_percent": 5.0,
    "pixel.prnu_um": 0.1, "pixel.dsnu": 1.0, "pixel.hot_pixel_fraction": 0.05, "pixel.hot_pixel_median": 900.0,
    "pixel.hot_pixel_spread": 1.5, "pixel.dsnu_e": 50.0, "pixel.offset_fpn": 0.01, "pixel.a_vt_mv_um": 5.0,
    "pixel.follower_area_um2": 1.0, "pixel.column_fpn": 0.01, "pixel.bits": 8, "pixel.black_level_dn": 20.0,
    "pixel.temperature_k": 340.0,
    "pixel.technology": ("0.18um", "4t-fsi", "4t-bsi"), "pixel.pitch_um": 5.8,
    "pixel.registration": [0.25, 0.75], "pixel.stack": {"height_um": 6.5, "index": 1.5},
    "pixel.stack.enabled": (False, True), "pixel.stack.height_um": 7.0, "pixel.stack.index": 1.9,
    "pixel.stack.microlens": ("none", "square"), "pixel.stack.shift": ("none", "optimal"), "pixel.stack.shift_um": [0.5, 0.0],
    "pixel.stack.refraction": "paraxial", "pixel.stack.depletion_um": 2.0, "pixel.stack.diffusion_length_um": 20.0,
    "pixel.stack.crosstalk": 0.2,
    "pixel.colour": {"quantum_efficiencies": bells(0.4)}, "pixel.colour.pattern": ("bggr", "quad_rggb", "rggb"),
    "pixel.colour.matrix": (["RGRG", "GBGB"], ["RRGG", "RRGG", "GGBB", "GGBB", "GGBB", "GGBB", "RRGG", "RRGG"]),
    "pixel.colour.binning": (True, False), "pixel.colour.sensitivities": "Canon_EOS_5D_Mark_II",
    "pixel.colour.quantum_efficiencies": bells(0.45), "pixel.colour.transmittances": bells(0.45),
    "pixel.colour.peak_quantum_efficiency": 0.2,
    "exposure.integration_s": 1e-4, "exposure.max_integration_s": 1e-6, "exposure.well_target": 0.5, "exposure.gain_db": 6.0,
    "exposure.frames": 3, "exposure.frame_time": "each", "exposure.shutter": "rolling", "exposure.line_time_us": 5.0,
    "exposure.flicker_hz": 120.0, "exposure.flicker_depth": 0.4, "exposure.flicker_phase_deg": 70.0,
    "motion.velocity_mm_per_s": [9.0, 0.0], "motion.image_um_per_s": [1.0, 0.5], "motion.pixels_per_s": [0.0, 1.0],
    "motion.distance_m": 0.02, "motion.margin_um": 9.0,
    "correction.dark_frames": 3, "correction.flat_frames": 3, "correction.flat_level": 0.3, "correction.column_clamp": 3,
    "correction.defects": True,
    "develop.denoise": ("wiener_bound", "wavelet"), "develop.denoise_strength": 0.5, "develop.remosaic": True,
    "develop.white_balance": [1.3, 1.0, 2.0], "develop.demosaic": ("malvar2004", "interpolate"),
    "develop.matrix": ("least_squares", "noise_aware"), "develop.sharpen_amount": 2.0, "develop.sharpen_radius_px": 0.7,
    "develop.sharpen_radius_cy_per_deg": 5.0, "develop.tone_curve": ("srgb", [[0, 0], [0.3, 0.6], [1, 1]]),
    "develop.tone_gamma": 3.0, "develop.tone_white": 2.0,
    "display.raster": ("one_to_one", "fixed_size"), "display.dots": 20, "display.samples_per_deg": 40.0,
    "display.interpolation": "cubic", "display.gamma": 1.8, "display.bits": 5, "display.white_cd_per_m2": 1.2e5,
    "display.white_w_per_m2_sr": 300.0, "display.white": "diffuser", "display.diffuser_reflectance": 0.5,
    "display.shading_correction": False, "display.filters": "zhang1996", "display.delta_e": "2000", "display.adaptation": "none",
}  # fmt: skip
# Without which a setting is refused, or has nothing to act on.
AT_20 = {"e_per_s": 1e6, "at_c": 20.0}
FLICKERS = {"flicker_hz": 50.0, "flicker_depth": 0.9, "flicker_phase_deg": 0.0}
HOT = {"hot_pixel_fraction": 0.05, "hot_pixel_median": 90.0}
# numbers that need no value of their own here; a plausible one may be lost beside others
MOVES |= {
    f"pixel.{name}": (number.example, 100 * number.example)
    for name, number in NUMBERS.items()
    if f"pixel.{name}" not in MOVES
}
BESIDE: dict[str, dict[str, Any]] = {
    "lens.veiling_glare_outside": {"lens": {"veiling_glare": 0.2}},
    "pixel.quantum_efficiency_depth_um": {"pixel": {"quantum_efficiency_nm": 525.0}},
    "pixel.hot_pixel_fraction": {"pixel": {"hot_pixel_median": 90.0}},
    "pixel.hot_pixel_median": {"pixel": HOT},
    "pixel.hot_pixel_spread": {"pixel": HOT},
    "pixel.a_vt_mv_um": {"pixel": {"follower_area_um2": 0.5}},
    "pixel.follower_area_um2": {"pixel": {"a_vt_mv_um": 4.0}},
    **{
        f"pixel.dark_current.{name}": {"pixel": {"dark_current": AT_20}}
        for name in DarkCurrent.model_fields
    },
    "pixel.colour": QUICK_FIT,
    "exposure.shutter": {
        "exposure": {"line_time_us": 1e5},
        "motion": {"image_um_per_s": [1.0, 0.5]},
    },
    "exposure.line_time_us": {
        "exposure": {"shutter": "rolling", "line_time_us": 1e5},
        "motion": {"image_um_per_s": [1.0, 0.5]},
    },
    "exposure.flicker_hz": {"exposure": FLICKERS},
    "exposure.flicker_depth": {"exposure": FLICKERS},
    "exposure.flicker_phase_deg": {"exposure": FLICKERS},
    "motion.distance_m": {"motion": {"velocity_mm_per_s": [0.1, 0.0]}},
    "motion.margin_um": {"motion": {"image_um_per_s": [1.0, 0.5]}},
    "exposure.frame_time": {"exposure": {"frames": 3, "integration_s": 1e-4}},
    "develop.denoise_strength": {"develop": {"denoise": "wavelet"}},
    **{
        f"develop.sharpen_radius_{unit}": {"develop": {"sharpen_amount": 2.0}}
        for unit in ("px", "cy_per_deg")
    },
    "develop.tone_gamma": {"develop": {"tone_curve": "gamma"}},
    "develop.tone_white": {"develop": {"tone_curve": "reinhard"}},
    "correction.defects": {"correction": {"dark_frames": 2}, "pixel": HOT},
}
IN_RECORDS = {
    "camera": Camera,
    "lens": LensOptions,
    "pixel": Pixel,
    "pixel.dark_current": DarkCurrent,
    "pixel.stack": StackOptions,
}
IN_RECORDS |= {
    "pixel.colour": ColourOptions,
    "exposure": Exposure,
    "motion": Motion,
    "correction": Correction,
    "develop": Develop,
    "display": Display,
}


class Outcome(NamedTuple):
    """A scored frame, None after an error, and the messages."""

    score: pixsim.FrameScore | None
    messages: frozenset[str]

    def equals(self, other: Outcome) -> bool:
        """Whether both have the same ΔE map, codes and time."""
        ours, theirs = self.score, other.score
        if ours is None or theirs is None:
            return ours is theirs
        pairs = (ours.delta_e, theirs.delta_e), (ours.frame.dn, theirs.frame.dn)
        return ours.frame.integration_s == theirs.frame.integration_s and all(
            map(np.array_equal, *zip(*pairs, strict=True))
        )


def scored(table: dict[str, Any]) -> Outcome:
    """Score a frame of these settings."""
    tables = merge(BASE, table)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            lens = LensOptions(**tables.get("lens", {}))
            camera = camera_with_lens(
                Camera(**tables["camera"]), CameraOptions(**table.get("camera", {})), lens
            )
            light = BEHIND_LENS if lens.file else LIGHT
            records: dict[str, Any] = {
                name: IN_RECORDS[name](**tables.get(name, {}))
                for name in ("exposure", "motion", "display", "correction", "develop")
            }
            score = pixsim.evaluate(light, camera, Pixel(**tables["pixel"]), **records)
        except pixsim.PixsimError as error:
            return Outcome(None, frozenset([str(error)]))
    return Outcome(score, frozenset(str(warning.message) for warning in caught))


def left_out(table: dict[str, Any], path: list[str]) -> dict[str, Any]:
    """Return a table without a setting, and without the tables that are empty then."""
    name, *inner = path
    if inner and (rest := left_out(table[name], inner)):
        return table | {name: rest}
    return {other: value for other, value in table.items() if other != name}


# What a setting without effect may move: 1e-3 of the scatter of a pixel changes a code of some
# pixels, and with it dots.
MAY_MOVE = 0.01  # of the mean ΔE


def acts(reference: dict[str, Any], base: Outcome, name: str, value: Any) -> bool:
    """Whether a setting changes the result, or a message names it: a new one, or one that says that
    it changes nothing.
    """
    table = merge(reference, nested(name.split("."), value))
    outcome = scored(table)
    texts = [text.partition(NOTHING)[0] for text in outcome.messages if NOTHING in text]
    if any(name in re.findall(r"[\w.]+", text) for text in texts):
        without = scored(left_out(table, name.split("."))).score
        if outcome.score is not None and without is not None:
            moved = abs(outcome.score.mean_delta_e - without.mean_delta_e)
            assert moved < MAY_MOVE * without.mean_delta_e, (
                f"{name} = {value!r} is said to change nothing"
            )
        return True
    mentioned = any(
        re.search(rf"\b{name.rpartition('.')[2]}\b", text)
        for text in outcome.messages - base.messages
    )
    return mentioned or (outcome.score is not None and not outcome.equals(base))


# Without it the default die is beyond the table of chief rays, and refused. So it is needed, though
# the picture has its size.
KNOWN_SILENT = {"chief rays": ["camera.die_mm"]}


@pytest.mark.parametrize(
    "configuration",
    [
        *CONFIGURATIONS,
        *(pytest.param(name, marks=pytest.mark.slow) for name in SLOW),
    ],  # slow: other values of the same claim
)
def test_every_setting_acts_or_a_message_names_it(configuration: str) -> None:
    own = (CONFIGURATIONS | SLOW)[configuration]
    base = scored(own)
    assert base.score is not None, base
    silent = []
    for name, values in MOVES.items():
        if configuration not in (*WHOLE, *SLOW) and not name.startswith("pixel."):
            continue
        if name == "lens.file" and "lens" not in own:
            continue  # seconds of tracing; without a file the other fields of [lens] are refused
        beside = BESIDE.get(name, {})
        with_beside = merge(own, beside)
        known = scored(with_beside) if beside else base
        moved = values if isinstance(values, tuple) else (values,)
        # Alone, too: what stands beside it may be impossible in this configuration, and so may it.
        if not any(
            acts(with_beside, known, name, value) or (beside and acts(own, base, name, value))
            for value in moved
        ):
            silent.append(name)
    assert silent == KNOWN_SILENT.get(configuration, [])


def test_every_setting_of_a_frame_is_moved() -> None:
    """But the fields of `Camera` that come from [lens]."""
    fields = {
        f"{table}.{name}" for table, record in IN_RECORDS.items() for name in record.model_fields
    }
    moved = fields - {"camera.lens", *(f"camera.{name}" for name in ANY_LENS_FIELDS.values())}
    assert MOVES.keys() <= moved, "MOVES has settings that no record has"
    assert MOVES.keys() >= moved, "give each new setting a value in MOVES that changes the result"


@cache
def chart() -> Scene:
    return loaded_scene("csf", {}, None, Display())


def given_of(run: Run, **facts: Any) -> UserSettings:
    """Return the given settings of a run of a scene."""
    camera = camera_with_lens(run.camera.over(Camera()), run.camera, run.lens)
    imaging = Imaging.of(run, camera).changed(metrics=metrics_of(run))
    return UserSettings.from_setting(imaging, run, **facts)


def said(command: Run | Study, technology: str = "") -> set[str]:
    """Names of the settings without effect of a run, or of a technology of a study."""
    if isinstance(command, Run):
        return set(given_of(command).without_effect())
    case = Case(command, resolved=(chart(), Camera()))
    at_sizes = settings_of_technology(case, case, technology or command.technologies[0])
    return set.intersection(*(set(settings.without_effect()) for settings in at_sizes))


def study_of(**settings: Any) -> Study:
    return Study.model_validate({"name": "a"} | settings)


SHEET_STUDY = {
    "pixel": {
        **{name: value for name, value in FAINT.items() if name != "pitch_um"},
        "data_sheet_pitch_um": 3.0,
    }
}
SIZES = [6.0, 7.0, 8.0, 9.0, 10.0]


@pytest.mark.parametrize(
    ("settings", "unused"),
    [
        ({"pitch": {"min_fill_factor": 0.1, "max_um": 12.0, "count": 6}}, set()),
        ({"pitch": {"min_fill_factor": 0.1, "min_um": 6.0}}, {"pitch.min_fill_factor"}),
        (
            {
                "pitch": {
                    "values_um": SIZES,
                    "min_fill_factor": 0.1,
                    "min_um": 6.0,
                    "max_um": 9.0,
                    "count": 6,
                }
            },
            {"pitch.min_fill_factor", "pitch.min_um", "pitch.max_um", "pitch.count"},
        ),
        ({"pitch": {"own_um": 3.0}}, {"pitch.own_um"}),
        (
            SHEET_STUDY | {"pitch": {"min_fill_factor": 0.1, "own_um": 4.0}},
            {"pitch.min_fill_factor"},
        ),
        (
            {"max_repeats": 16, "max_evaluations": 5000, "refine": False},
            {"max_repeats", "max_evaluations"},
        ),
        ({"max_repeats": 16, "max_evaluations": 5000}, set()),
        ({"refine": False, "target_ci_um": 0.1}, {"refine"}),
        ({"max_repeats": 16, "max_evaluations": 5000, "target_ci_um": 0.1}, set()),
        (
            {"tolerance_delta_e": 0.01, "repeats": 4, "max_repeats": 16, "render_noise": 0.1},
            {"render_noise"},
        ),
        (
            {
                "repeats": 4,
                "render_noise": 0.1,
                "tolerance_e": 1e-4,
                "max_seconds": 60.0,
                "window_mm": 1.0,
            },
            set(),
        ),
        ({"metrics": ["npwe"], "metric": {"detectability": {"without": {"contrast": 0.5}}}}, set()),
        ({"metrics": ["npwe"], "metric": {"detectability": {"registrations": 4}}}, set()),
        (
            {"metrics": ["information"], "metric": {"detectability": {"registrations": 4}}},
            {"metric.detectability.registrations"},
        ),
        (
            {
                "metrics": ["detectability"],
                "metric": {"detectability": {"registrations": 4}},
                "display": {"raster": "one_to_one"},
            },
            {"metric.detectability.registrations"},
        ),
        (
            {"pixel": {"fill_factor": 0.4, "fill_factor_law": "inset"}},
            set(),
        ),  # the sizes begin where the law says
        (
            {"pixel": {"fill_factor": 0.4, "fill_factor_law": "inset"}, "pitch": {"min_um": 6.0}},
            {"pixel.fill_factor_law"},
        ),
    ],
)
def test_settings_of_a_study_without_effect(settings: dict[str, Any], unused: set[str]) -> None:
    """And those of its range of sizes that have one move the sizes."""
    study = study_of(**settings)
    assert said(study) == unused
    own = {
        name: value
        for name, value in settings.get("pitch", {}).items()
        if f"pitch.{name}" not in unused
    }
    sizes = study_pitches_um(study, study.technologies[0]).tolist()
    for name in own:
        left = settings | {"pitch": {other: value for other, value in own.items() if other != name}}
        assert study_pitches_um(study_of(**left), study.technologies[0]).tolist() != sizes, name
    kept = study_of(**settings | {"pitch": own})
    assert study_pitches_um(kept, kept.technologies[0]).tolist() == sizes


def test_a_value_that_holds_anyway_is_not_named() -> None:
    """A default, that of the technology, 0 of what is not there, and what settings.toml states of
    them; true notes come again.
    """
    assert not said(Run(pixel=Pixel(dark_current_e_per_s=0.0, dsnu=0.0, hot_pixel_fraction=0.0)))
    assert said(Run(pixel=Pixel(dark_current_e_per_s=0.0, dsnu=0.2))) == {"pixel.dsnu"}
    assert not said(
        Run(
            pixel=Pixel(**FAINT, reset_noise_factor=0.0, response="scaled"),
            display=Display(adaptation="bradford"),
        )
    )
    for run in (
        Run(pixel=Pixel(**FAINT)),
        Run(pixel=Pixel(**FAINT, response="literal"), display=Display(adaptation="none")),
    ):
        repeated = Run.model_validate(run.model_dump(mode="json", exclude_none=True))
        assert said(repeated) == said(run)
    assert said(run) == {"pixel.response", "display.adaptation"}


def test_what_is_resolved_is_a_thousandth_of_the_scatter() -> None:
    """An offset pattern adds its square to the variance of each pixel: the darkest one resolves
    1e-3 of its scatter.
    """
    run = Run(pixel=Pixel(**FAINT))
    base = given_of(run).base
    assert base is not None
    scatter_e = math.sqrt(float(base.variance_e2(base.frame.mean_e).min()))
    for part, names in ((0.9, {"pixel.dsnu_e"}), (1.1, set())):
        assert said(Run(pixel=Pixel(**FAINT, dsnu_e=part * 1e-3 * scatter_e))) == names


def test_a_small_light_fills_no_pixel_and_shows_all_parts_of_the_field() -> None:
    """With a stated time, and with an automatic one, which stays below the longest one and whole
    periods of lamps.
    """
    for exposure in (
        Exposure(integration_s=0.01),
        Exposure(),
        Exposure(flicker_hz=100.0, flicker_depth=0.02),
    ):
        base = given_of(Run(pixel=Pixel(**FAINT), exposure=exposure)).base
        assert base is not None
        frame, camera = base.frame, base.imaging.camera
        assert frame.dn.shape == (20, 20)
        assert frame.integration_s < exposure.max_integration_s
        assert 0.3 * base.readout.saturation_e < base.mean_e.max() < base.readout.saturation_e
        assert camera.fov_deg == pytest.approx(Camera().fov_deg, rel=1e-9)
        assert camera.die_um == pytest.approx((20 * 5.0, 20 * 5.0), rel=1e-9)


@pytest.mark.parametrize("name", packaged("data/studies"))
def test_packaged_studies_state_nothing_in_vain(name: str) -> None:
    cases = cases_of(with_range_ends(load_study(name)))
    cases = tuple(cases[number] for number in cases_to_try(cases))
    for technology in cases[0].settings.technologies:
        names = None
        for case in cases:
            if technology in case.settings.technologies and names != set():
                found = said(case.settings, technology)
                names = found if names is None else names & found
        assert not names, technology


def test_cases_of_many_axes_are_tried_one_axis_at_a_time() -> None:
    """All values of every axis are among them, and the last case."""
    values = [
        {"name": name, "set": name, "values": [2.0, 3.0, 4.0]}
        for name in ("camera.f_number", "exposure.gain_db")
    ]
    cases = cases_of(study_of(axis=values))
    tried = [cases[number].at for number in cases_to_try(cases)]
    assert len(tried) == 1 + 2 + 2 + 1
    assert all({at[axis["name"]] for at in tried} == {2.0, 3.0, 4.0} for axis in values)
    assert tried[-1] == cases[-1].at


def test_notes_name_the_sensors_unless_all_have_them() -> None:
    matrix = {"develop": Develop(matrix="least_squares")}
    grey, colour = (
        given_of(Run(**matrix)),
        given_of(Run(pixel=Pixel(**SHEET, colour=ColourOptions(**COLOUR)), **matrix)),
    )
    note = "develop.matrix changes nothing here"
    of_sheet = "b: pixel.quantum_efficiency, pixel.black_level_dn change nothing here"
    assert effect_notes({"a": [grey], "b": [grey]}) == [note]
    assert effect_notes({"a": [grey], "b": [colour]}) == [f"a: {note}", of_sheet]
    assert effect_notes({"a": [grey, colour]}) == [], "it has one in one of two cases"


def test_every_command_says_so(tmp_path: Path) -> None:
    """A study, a run of a scene and of a picture, and a comparison, before anything is rendered;
    `evaluate` above.
    """
    with pytest.warns(UserWarning, match=r"^display\.adaptation changes nothing here"):
        prepare(tiny(display={"adaptation": "none"}))
    axis = [{"name": "raster", "set": "display.raster", "values": ["one_to_one", "fixed_size"]}]
    with pytest.warns(UserWarning, match=r"^exposure\.well_target changes nothing here") as caught:
        prepare(tiny(axis=axis, exposure={"well_target": 0.5, "integration_s": 0.01}))
    assert not [warning for warning in caught if "display" in str(warning.message)], (
        "one of its cases uses the dots"
    )
    with pytest.warns(UserWarning, match=r"^correction\.flat_level changes nothing here"):
        prepare_run("csf", Run(correction=Correction(flat_level=0.3)))
    pixsim.write_npz(tmp_path / "light.npz", LIGHT)
    asked = Run(
        camera=CameraOptions(die_mm=DIE_MM),
        display=Display(dots=SIDE),
        render_noise=0.1,
        max_seconds=9.0,
        tolerance_e=1e-4,
    )
    with pytest.warns(
        UserWarning, match=r"^tolerance_e, render_noise, max_seconds change nothing here"
    ):
        prepare_run(str(tmp_path / "light.npz"), asked)
    files = [
        sheet(tmp_path / f"{name}.toml", more=f"f_number = {stop}\n")
        for name, stop in (("a", 4.0), ("b", 5.6))
    ]
    with pytest.warns(UserWarning, match=r"^b: camera\.f_number changes nothing here"):
        sensors.prepare(files, match="view", repeats=2)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        sensors.prepare(files, match="own", repeats=2, options={"camera": {"transmittance": 0.5}})


def test_settings_of_metrics_in_calls_with_records_say_so() -> None:
    """Of one sensor and of many; what is among the metrics is used, but for the scene without the
    target: its light is given.
    """
    light, pixel = picture(np.arange(405.0, 700.0, 10.0)), Pixel(pitch_um=20.0)
    metric = MetricOptions(
        information={"contrast": 0.3},
        snr10_lx={"snr": 5.0},
        detectability={"without": {"contrast": 0.5}, "registrations": 4},
    )
    asked: dict[str, Any] = {"camera": Camera(), "display": Display(dots=32), "metric": metric}
    named = "metric.detectability.without, metric.snr10_lx.snr change nothing here"
    judged = {"metrics": ["detectability", "information"], "without": light}
    for call in (
        partial(pixsim.evaluate, light, pixel=pixel),
        partial(pixsim.sweep, light, [pixel], jobs=1),
    ):
        with warnings.catch_warnings(record=True) as notes:
            warnings.simplefilter("always")
            call(**asked, **judged)
        assert [str(note.message) for note in notes if "metric." in str(note.message)] == [named]
        with pytest.warns(
            UserWarning, match=r"metric\.information\.contrast.* change nothing here"
        ):
            call(**asked)


def test_settings_of_lenses_in_calls_with_records_say_so() -> None:
    light, pixel = picture(np.arange(405.0, 700.0, 10.0)), Pixel(pitch_um=20.0)
    camera = camera_with_lens(Camera(), CameraOptions(), LensOptions(veiling_glare_outside=0.5))
    for call in (
        partial(pixsim.evaluate, light, pixel=pixel),
        partial(pixsim.sweep, light, [pixel], jobs=1),
    ):
        with pytest.warns(UserWarning, match=r"lens\.veiling_glare_outside changes nothing here"):
            call(camera=camera, display=Display(dots=32))


ELSEWHERE = """
[develop]
denoise = "wavelet"
[motion]
image_um_per_s = [9.0, 0.0]
[lens]
veiling_glare = 0.1
[exposure]
flicker_hz = 100
flicker_depth = 0.5
gain_db = 6
[pixel]
registration = [0.5, 0.5]
"""


def test_commands_say_which_tables_they_do_not_take(tmp_path: Path) -> None:
    path = tmp_path / "sensor.toml"
    path.write_text(ELSEWHERE, encoding="utf-8")
    words = (
        "lens.veiling_glare, pixel.registration, exposure.flicker_hz, exposure.flicker_depth,"
        " motion.image_um_per_s"
    )
    with pytest.warns(
        UserWarning, match=f"^{re.escape(words)}, develop.denoise change nothing here"
    ):
        assert datasheet_settings(None, [path], None, None, None).exposure.gain_db == 6.0
    still = "exposure.flicker_hz, exposure.flicker_depth, motion.image_um_per_s change nothing here"
    run = run_settings([path], {"pixel": {"pitch_um": 20.0}})
    assert effect_notes({"": [given_of(run, not_taken=NOT_TAKEN)]}) == [still]
    with warnings.catch_warnings():  # a camera's own lens stands in its file for other commands
        warnings.simplefilter("error")
        datasheet_settings("imx363", [], None, None, None)
        datasheet_settings(
            "4t-bsi", [], {"pitch_um": 2.0}, {"integration_s": 0.01, "gain_db": 6.0}, 3
        )


def test_rows_name_settings_that_exist() -> None:
    known = {
        *MOVES,
        *Run.model_fields,
        *Study.model_fields,
        *(f"camera.{name}" for name in CameraOptions.model_fields),
    }
    known |= {
        f"metric.{name}.{field}"
        for name, options in METRIC_OPTIONS
        for field in type(options).model_fields
    }
    assert not {name for row in ROWS for name in row.settings} - known
    assert not {*UNUSED_SETTINGS, *NOT_TAKEN} - known


def test_record_without_a_setting_of_a_file_is_the_same() -> None:
    """As where a condition or a sensor's own file states the pixel, and the study does not."""
    run = Run(seed=3)
    assert record_with(run, ["pixel", "prnu"], Default) == run
