"""No setting does nothing in silence: it changes the result, or a message names it."""

import json
import math
import re
import warnings
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from helpers.tiny import tiny

from pixsim import (
    Camera,
    Correction,
    Develop,
    Display,
    Exposure,
    Motion,
    Pixel,
    PixsimError,
    SpectralImage,
    Study,
    evaluate,
    write_npz,
)
from pixsim.base.layers import nested
from pixsim.base.toml import packaged
from pixsim.measure.datasheet import UNUSED_SETTINGS, datasheet_settings
from pixsim.optics.camera import CameraOptions
from pixsim.optics.camera_lens import camera_with_lens
from pixsim.optics.lens_options import ANY_LENS_FIELDS, LensOptions
from pixsim.sensor.colour_options import ColourOptions
from pixsim.sensor.pixel_options import NUMBERS, DarkCurrent
from pixsim.sensor.stack_options import StackOptions
from pixsim.studies.design import Case, cases_of, metrics_of, study_pitches_um, with_range_ends
from pixsim.studies.files import load_study
from pixsim.studies.prepare import cases_to_try, loaded_scene, prepare, settings_of_technology
from pixsim.studies.run import prepare as prepare_run
from pixsim.verification.ladder import NOT_TAKEN
from pixsim.viewer.imaging import Imaging
from pixsim.viewer.merging import merge
from pixsim.viewer.metric_options import METRIC_OPTIONS, MetricOptions
from pixsim.viewer.setting import Run, RunScene
from pixsim.viewer.settings_file import run_settings
from pixsim.viewer.without_effect import (
    ROWS,
    Default,
    UserSettings,
    _changes_frame,
    _changes_metrics,
    _changes_picture,
    effect_notes,
    record_with,
)

NOTHING = "nothing here"
SIDE = 24
SAMPLE_UM = 4.0
DIE_MM = 1e-3 * SIDE * SAMPLE_UM


# Coloured detail, as bright as a sunlit scene, so that no limit of time decides.
LIGHT_NM = np.arange(420.0, 820.0, 40.0)
RNG = np.random.default_rng(5)
GREY = 0.1 + 0.9 * RNG.random((SIDE, SIDE))
IS_BLUE = RNG.random((SIDE, SIDE)) < 0.5
LIGHT = SpectralImage(
    LIGHT_NM,
    40.0,
    SAMPLE_UM,
    factors=(
        3e-2 * np.stack([600 / LIGHT_NM, LIGHT_NM / 600]),
        GREY * np.stack([IS_BLUE, ~IS_BLUE]),
    ),
    header={"luminance_cd_per_m2": 1.5e5},
)
BASE = {
    "camera": {"die_mm": DIE_MM, "focal_length_mm": 0.12},
    "display": {"dots": SIDE},
    "exposure": {"max_integration_s": 10.0},
}
RANGE_NM = np.arange(400.0, 701.0, 20.0)


def bells(height: float) -> dict[str, list[list[float]]]:
    """Return responses of three channels."""
    curves = {
        name: 0.01 + height * np.exp(-(((RANGE_NM - peak) / 50) ** 2))
        for name, peak in {"R": 600.0, "G": 540.0, "B": 460.0}.items()
    }
    return {name: np.stack([RANGE_NM, curve], axis=1).tolist() for name, curve in curves.items()}


SHEET = {
    "pitch_um": 5.0,
    "full_well_e": 8000,
    "read_noise_e": 3.0,
    "dark_current_e_per_s": 2e7,
    "quantum_efficiency": 0.6,
    "prnu": 0.01,
    "dsnu": 0.3,
    "bits": 12,
    "black_level_dn": 60,
}
# Shifted nowhere and high, so that the corners have a few per cent less charge: some codes differ
# where that is corrected.
COLOUR = {"quantum_efficiencies": bells(0.5)}
QUICK_FIT = {"develop": {"matrix": "least_squares"}}  # the default takes a quarter of a second
FAINT = SHEET | {"dark_current_e_per_s": 5.0}  # dark charge does not hide what else there is


def of(technology: str, **pixel) -> dict:
    return {"pixel": {"technology": technology, "black_level_dn": 60, **pixel}}


# Settings, and beginnings of the names of the settings that are moved there. Each setting is moved
# in a configuration where it may act, and in one where it may not.
CONFIGURATIONS: dict[str, tuple[dict, tuple[str, ...]]] = {
    "3T": (of("0.35um"), ("",)),
    "4T": (
        of("4t-bsi", pitch_um=2.0, dark_current_e_per_s=1e7),
        ("pixel.stack", "pixel.quantum", "pixel.technology", "pixel.fill"),
    ),
    "data sheet": ({"pixel": SHEET}, ("pixel.",)),
    "data sheet, stack": (
        {
            "pixel": {
                **SHEET,
                "stack": {"height_um": 7.5, "index": 1.5, "microlens": "square", "shift": "none"},
            }
        },
        ("pixel.stack", "lens."),
    ),
    "colour": (
        {"pixel": {**SHEET, "colour": COLOUR}, **QUICK_FIT},
        ("pixel.colour", "develop.", "display.adaptation"),
    ),
    "one dot a pixel": (
        {"pixel": SHEET, "display": {"raster": "one_to_one"}},
        ("display.", "motion.", "pixel.registration"),
    ),
}

# Every setting of a frame, moved; a tuple has alternatives, of which one is another value in any
# configuration.
MOVES = {
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
    "pixel.temperature_k": 340.0, "pixel.readout": {"kind": "staggered", "ratio": 16.0},
    "pixel.companding": [[0, 0], [50, 50], [4096, 100]],
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
    "exposure.max_gain_db": 3.0,
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
FLICKERS = {"flicker_hz": 50.0, "flicker_depth": 0.9, "flicker_phase_deg": 0.0}
HOT = {"hot_pixel_fraction": 0.05, "hot_pixel_median": 90.0}
# numbers that need no value of their own here; a plausible one may be lost beside others
MOVES |= {
    f"pixel.{name}": (number.example, 100 * number.example)
    for name, number in NUMBERS.items()
    if f"pixel.{name}" not in MOVES
}
BESIDE: dict[str, dict] = {
    "lens.veiling_glare_outside": {"lens": {"veiling_glare": 0.2}},
    "pixel.quantum_efficiency_depth_um": {"pixel": {"quantum_efficiency_nm": 525.0}},
    "pixel.hot_pixel_fraction": {"pixel": {"hot_pixel_median": 90.0}},
    "pixel.hot_pixel_median": {"pixel": HOT},
    "pixel.hot_pixel_spread": {"pixel": HOT},
    "pixel.a_vt_mv_um": {"pixel": {"follower_area_um2": 0.5}},
    "pixel.follower_area_um2": {"pixel": {"a_vt_mv_um": 4.0}},
    **{
        f"pixel.dark_current.{name}": {"pixel": {"dark_current": {"e_per_s": 1e6, "at_c": 20.0}}}
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
    "exposure.max_gain_db": {"exposure": {"gain_db": "auto", "integration_s": 1e-6}},
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
    "pixel.colour": ColourOptions,
    "exposure": Exposure,
    "motion": Motion,
    "correction": Correction,
    "develop": Develop,
    "display": Display,
}
MAX_CHANGE = 0.01  # of the mean ΔE, by a setting without effect: codes of some pixels


def scored(table: dict) -> tuple[object, frozenset[str]]:
    """Return the score of a frame of settings, None after an error, and the messages."""
    return scored_text(json.dumps(table))


@cache
def scored_text(text: str) -> tuple[object, frozenset[str]]:
    table = json.loads(text)
    tables = merge(BASE, table)
    with warnings.catch_warnings(record=True) as notes:
        warnings.simplefilter("always")
        try:
            camera = camera_with_lens(
                Camera(**tables["camera"]),
                CameraOptions(**table.get("camera", {})),
                LensOptions(**tables.get("lens", {})),
            )
            records: dict = {
                name: IN_RECORDS[name](**tables.get(name, {}))
                for name in ("exposure", "motion", "display", "correction", "develop")
            }
            score = evaluate(LIGHT, camera, Pixel(**tables["pixel"]), **records)
        except PixsimError as error:
            return None, frozenset([str(error)])
    return score, frozenset(str(note.message) for note in notes)


def left_out(table: dict, path: list[str]) -> dict:
    """Return a table without a setting, and without the tables that are empty then."""
    name, *inner = path
    table_inside = left_out(table[name], inner) if inner else {}
    return {other: value for other, value in table.items() if other != name} | (
        {name: table_inside} if table_inside else {}
    )


def acts(reference: dict, name: str, value) -> bool:
    """Return whether a setting changes the result, or a new message names it."""
    base, base_messages = scored(reference)
    table = merge(reference, nested(name.split("."), value))
    score, messages = scored(table)
    if any(
        name in re.findall(r"[\w.]+", text.partition(NOTHING)[0])
        for text in messages
        if NOTHING in text
    ):
        without, _ = scored(left_out(table, name.split(".")))
        if score is not None and without is not None:
            expected = pytest.approx(without.mean_delta_e, rel=MAX_CHANGE)
            assert score.mean_delta_e == expected, f"{name} is said to change nothing"
        return True
    word = rf"\b{name.rpartition('.')[2]}\b"
    if any(re.search(word, text) for text in messages - base_messages):
        return True
    return score is not None and (
        base is None
        or score.frame.integration_s != base.frame.integration_s
        or not np.array_equal(score.delta_e, base.delta_e)
        or not np.array_equal(score.frame.estimate_e, base.frame.estimate_e)
    )


@pytest.mark.parametrize(
    "configuration",
    # A 3T pixel has most settings; the others are more values.
    [
        name if name == "3T" else pytest.param(name, marks=pytest.mark.slow)
        for name in CONFIGURATIONS
    ],
)
def test_every_setting_acts_or_a_message_names_it(configuration: str) -> None:
    """With what stands beside it, or alone: either may be impossible in a configuration."""
    reference, beginnings = CONFIGURATIONS[configuration]
    silent = []
    for name, values in MOVES.items():
        if name == "lens.file" or not name.startswith(beginnings):
            continue  # a lens takes seconds of tracing
        beside = BESIDE.get(name, {})
        references = [merge(reference, beside), reference] if beside else [reference]
        alternatives = values if isinstance(values, tuple) else (values,)
        if not any(acts(table, name, value) for value in alternatives for table in references):
            silent.append(name)
    assert silent == []


def test_every_setting_of_a_frame_is_moved() -> None:
    """But the fields of `Camera` that come from [lens]."""
    fields = {
        f"{table}.{name}" for table, record in IN_RECORDS.items() for name in record.model_fields
    }
    assert MOVES.keys() == fields - {
        "camera.lens",
        *(f"camera.{name}" for name in ANY_LENS_FIELDS.values()),
    }, "give each setting another value in MOVES"


def settings_of(run: Run, **facts) -> UserSettings:
    imaging = Imaging.of(
        run, camera_with_lens(run.camera.over(Camera()), run.camera, run.lens)
    ).changed(metrics=metrics_of(run))
    return UserSettings.from_setting(imaging, run, **facts)


def without_effect(command: Run | Study, technology: str = "") -> set[str]:
    """Return names of the settings without effect of a run, or of a technology of a study."""
    if isinstance(command, Run):
        return set(settings_of(command).without_effect())
    case = Case(command, resolved=(loaded_scene("csf", {}, None, Display()), Camera()))
    at_sizes = settings_of_technology(case, case, technology or command.technologies[0])
    return set.intersection(*(set(settings.without_effect()) for settings in at_sizes))


def study_of(**settings) -> Study:
    return Study.model_validate({"name": "a"} | settings)


INSET = {"fill_factor": 0.4, "fill_factor_law": "inset"}


@pytest.mark.parametrize(
    ("settings", "unused"),
    [
        ({"pitch": {"min_fill_factor": 0.1, "max_um": 12.0, "count": 6}}, set()),
        ({"pitch": {"min_fill_factor": 0.1, "min_um": 6.0}}, {"pitch.min_fill_factor"}),
        (
            {
                "pitch": {
                    "values_um": [6.0, 7.0, 8.0, 9.0, 10.0],
                    "min_um": 6.0,
                    "max_um": 9.0,
                    "count": 6,
                }
            },
            {"pitch.min_um", "pitch.max_um", "pitch.count"},
        ),
        ({"pitch": {"own_um": 3.0}}, {"pitch.own_um"}),
        ({"max_repeats": 16, "refine": False}, {"max_repeats"}),
        ({"max_repeats": 16, "max_evaluations": 5000, "target_ci_um": 0.1}, set()),
        ({"refine": False, "target_ci_um": 0.1}, {"refine"}),
        (
            {
                "render_noise": 0.1,
                "tolerance_delta_e": 0.01,
                "tolerance_e": 1e-4,
                "max_seconds": 60.0,
            },
            set(),
        ),
        ({"metrics": ["npwe"], "metric": {"detectability": {"registrations": 4}}}, set()),
        (
            {"metrics": ["information"], "metric": {"detectability": {"registrations": 4}}},
            {"metric.detectability.registrations"},
        ),
        ({"pixel": INSET}, set()),  # the sizes begin where the law says
        ({"pixel": INSET, "pitch": {"min_um": 6.0}}, {"pixel.fill_factor_law"}),
    ],
)
def test_settings_of_a_study_without_effect(settings: dict, unused: set[str]) -> None:
    """And those of its range of sizes that have one move the sizes."""
    study = study_of(**settings)
    assert without_effect(study) == unused
    sizes_um = study_pitches_um(study, study.technologies[0]).tolist()
    pitch = settings.get("pitch", {})
    for name in pitch:
        changed = study_of(
            **settings
            | {"pitch": {other: value for other, value in pitch.items() if other != name}}
        )
        others_um = study_pitches_um(changed, changed.technologies[0]).tolist()
        assert (others_um == sizes_um) == (f"pitch.{name}" in unused), name


@pytest.mark.parametrize(
    ("pixel", "display", "names"),
    [
        ({"dark_current_e_per_s": 0.0, "dsnu": 0.0, "hot_pixel_fraction": 0.0}, {}, set()),
        ({"dark_current_e_per_s": 0.0, "dsnu": 0.2}, {}, {"pixel.dsnu"}),
        (
            FAINT | {"reset_noise_factor": 0.0, "response": "scaled"},
            {"adaptation": "bradford"},
            set(),
        ),
        (
            FAINT | {"response": "literal"},
            {"adaptation": "none"},
            {"pixel.response", "display.adaptation"},
        ),
    ],
)
def test_value_that_holds_anyway_is_not_named(pixel: dict, display: dict, names: set[str]) -> None:
    """A default, that of the technology, 0 of what is not there; nor in the settings that a result
    states.
    """
    run = Run(pixel=Pixel(**pixel), display=Display(**display))
    assert without_effect(run) == names
    assert (
        without_effect(Run.model_validate(run.model_dump(mode="json", exclude_none=True))) == names
    )


@pytest.mark.parametrize("share", [0.9, 1.1])
def test_a_thousandth_of_the_scatter_or_of_a_code_is_resolved(share: float) -> None:
    """An offset pattern adds its square to the variance of each pixel, a well its end, light its
    mean, and sharpening a part of itself to the light of the display. A thousandth of the last of
    four digits of a metric is.
    """
    settings = settings_of(
        Run(
            pixel=Pixel(**FAINT),
            exposure=Exposure(integration_s=0.01),
            metrics=["delta_e", "snr10_lx"],
            metric=MetricOptions(snr10_lx={"reflectance": 0.18}),
        )
    )
    scatter_e = np.sqrt(settings.base.variance_e2(settings.base.frame.mean_e))
    light, sharpened = (
        trial.chain.development.light(settings.base.frame)
        for trial in (settings.base, settings.trial_with("develop.sharpen_amount", 1.0))
    )
    assert [
        changes(settings.base, settings.trial_with(name, value))
        for changes, name, value in (
            (_changes_frame, "pixel.dsnu_e", share * 1e-3 * scatter_e.min()),
            (_changes_frame, "pixel.full_well_e", 8000 + share * 1e-3 * scatter_e.min()),
            (
                _changes_frame,
                "pixel.quantum_efficiency",
                0.6 * (1 + share * 1e-3 * (scatter_e / settings.base.mean_e).min()),
            ),
            (
                _changes_picture,
                "develop.sharpen_amount",
                share * 1e-3 / 256 / np.abs(sharpened - light).max(),
            ),
            (_changes_metrics, "metric.snr10_lx.reflectance", 0.18 * (1 + share * 1e-6)),
        )
    ] == [share > 1] * 5


GOLDEN_S = 0.05 * (math.sqrt(5) - 1)  # part of the longest time


@pytest.mark.parametrize(
    ("exposure", "pixel", "share", "time_s"),
    [
        ({"integration_s": 0.01}, {}, 0.5, 0.01),
        ({}, {}, 0.95, GOLDEN_S),
        ({"flicker_hz": 100.0, "flicker_depth": 0.02}, {}, 0.95, GOLDEN_S / 10),
        ({"frames": 3, "frame_time": "each"}, {}, 0.95, 3 * GOLDEN_S),
        ({}, {"dark_current_e_per_s": 2e5}, 0.95, 0.5 * 0.95 * 8000 / 2e5),
        ({}, {"readout": {"kind": "staggered", "ratio": 4.0}}, 0.95, GOLDEN_S),
    ],
    ids=str,
)
def test_small_light_fills_no_pixel_and_shows_the_whole_field(
    exposure: dict[str, float], pixel: dict, share: float, time_s: float
) -> None:
    """Half of the well in a stated time; else a golden part of the longest time, or of a period of
    lamps, or the time in which dark charge takes half. White is 1.1 times the brightest dot. Within
    1 %, for the blur of the brightest part.
    """
    stated = {
        "die_height_mm": Camera().die_mm / 2,
        "chief_ray_angle": [[0.0, 0.0], [Camera().die_mm, 15.0]],
    }
    base = settings_of(
        Run(
            pixel=Pixel(**FAINT | pixel),
            exposure=Exposure(**exposure),
            camera=CameraOptions(**stated),
        )
    ).base
    camera = base.imaging.camera
    assert base.frame.estimate_e.shape == (10, 20)
    assert base.small.light.wavelength_nm.tolist() == [*range(410, 811, 40)]
    assert [base.frame.integration_s, base.mean_e.max()] == pytest.approx(
        [time_s, share * base.readout.saturation_e], rel=0.01
    )
    field = camera.fov_deg, *camera.die_um, *camera.chief_ray_angle[1]
    assert field == pytest.approx((Camera(**stated).fov_deg, 50.0, 100.0, 0.1, 15.0), rel=1e-9)
    assert base.prepared.screen.ideal.max() == pytest.approx(1 / 1.1, abs=0.002)


@pytest.mark.parametrize("name", packaged("data/studies"))
def test_packaged_studies_state_nothing_in_vain(name: str) -> None:
    cases = cases_of(with_range_ends(load_study(name)))
    tried = [cases[number].settings for number in cases_to_try(cases)]
    for technology in cases[0].settings.technologies:
        names = None
        for study in tried:
            if technology in study.technologies and names != set():
                in_case = without_effect(study, technology)
                names = in_case if names is None else names & in_case
        assert not names, technology


def test_cases_of_many_axes_are_tried_one_axis_at_a_time() -> None:
    """All values of every axis are among them, and the last case."""
    axes = [
        {"name": name, "set": name, "values": [2.0, 3.0, 4.0]}
        for name in ("camera.f_number", "exposure.gain_db")
    ]
    cases = cases_of(study_of(axis=axes))
    tried = [cases[number].at for number in cases_to_try(cases)]
    assert len(tried) == 1 + 2 + 2 + 1
    assert all({at[axis["name"]] for at in tried} == {2.0, 3.0, 4.0} for axis in axes)
    assert tried[-1] == cases[-1].at


def test_notes_name_the_sensors_unless_all_have_them() -> None:
    develop = Develop(matrix="least_squares")
    grey = settings_of(Run(develop=develop))
    colour = settings_of(Run(pixel=Pixel(**SHEET, colour=ColourOptions(**COLOUR)), develop=develop))
    note = "develop.matrix changes nothing here"
    assert effect_notes({"a": [grey], "b": [grey]}) == [note]
    assert effect_notes({"a": [grey], "b": [colour]})[0] == f"a: {note}"
    assert effect_notes({"a": [grey, colour]}) == [], "it has one in one of two cases"


@pytest.mark.parametrize(
    ("prepared", "names"),
    [
        (
            lambda _: prepare(
                tiny(
                    axis=[
                        {
                            "name": "a",
                            "set": "display.raster",
                            "values": ["one_to_one", "fixed_size"],
                        }
                    ],
                    exposure={"well_target": 0.5, "integration_s": 0.01},
                )
            ),
            "exposure.well_target changes",
        ),
        (
            lambda _: prepare_run(
                Run(scene=RunScene(file="csf"), correction=Correction(flat_level=0.3))
            ),
            "correction.flat_level changes",
        ),
        (
            lambda light: prepare_run(
                Run(
                    scene=RunScene(file=light),
                    camera=CameraOptions(die_mm=DIE_MM),
                    display=Display(dots=SIDE),
                    render_noise=0.1,
                    tolerance_e=1e-4,
                )
            ),
            "tolerance_e, render_noise change",
        ),
        (
            lambda _: evaluate(
                LIGHT,
                camera_with_lens(
                    Camera(**BASE["camera"]),
                    CameraOptions(),
                    LensOptions(veiling_glare_outside=0.5),
                ),
                Pixel(),
                display=Display(dots=SIDE),
            ),
            "lens.veiling_glare_outside changes",
        ),
    ],
    ids=["study with a case of dots", "run of a scene", "run of a picture", "records"],
)
def test_commands_name_settings_before_they_render(
    prepared: Callable[[str], object], names: str, tmp_path: Path
) -> None:
    write_npz(tmp_path / "light.npz", LIGHT)
    with pytest.warns(UserWarning, match=rf"^{re.escape(names)} nothing") as notes:
        prepared(str(tmp_path / "light.npz"))
    assert "display" not in "".join(str(note.message) for note in notes)


@pytest.mark.parametrize(
    ("metrics", "prnu", "names"),
    [
        (
            ["detectability", "information"],
            0.01,
            "metric.detectability.without, metric.snr10_lx.snr change nothing here",
        ),
        (["delta_e"], 0.01, "metric.information.contrast"),
        (["delta_e", "snr10_lx"], 0.3, "metric.detectability.without changes nothing here"),
    ],
)
def test_settings_of_metrics_act_with_their_metrics(
    metrics: list[str], prnu: float, names: str
) -> None:
    """But the scene without the target, whose light is an argument, and nothing is known of a
    metric without a number.
    """
    metric = MetricOptions(
        information={"contrast": 0.3},
        snr10_lx={"snr": 5.0},
        detectability={"without": {"contrast": 0.5}, "registrations": 4},
    )
    with pytest.warns(UserWarning, match=re.escape(names)):
        evaluate(
            LIGHT,
            Camera(**BASE["camera"]),
            Pixel(prnu=prnu),
            display=Display(dots=SIDE),
            metrics=metrics,
            metric=metric,
            without=LIGHT if "detectability" in metrics else None,
        )


ELSEWHERE = """
develop.denoise = "wavelet"
motion.image_um_per_s = [9.0, 0.0]
lens.veiling_glare = 0.1
exposure = { flicker_hz = 100, flicker_depth = 0.5, gain_db = 6 }
pixel.registration = [0.5, 0.5]
"""


def test_commands_name_the_settings_that_they_do_not_take(tmp_path: Path) -> None:
    path = tmp_path / "sensor.toml"
    path.write_text(ELSEWHERE, encoding="utf-8")
    names = (
        "lens.veiling_glare, pixel.registration, exposure.flicker_hz, exposure.flicker_depth,"
        " motion.image_um_per_s, develop.denoise change nothing here"
    )
    with pytest.warns(UserWarning, match=f"^{re.escape(names)}"):
        assert datasheet_settings(None, [path], None, None, None).exposure.gain_db == 6.0
    run = run_settings([path], {"pixel": {"pitch_um": 20.0}})
    assert effect_notes({"": [settings_of(run, not_taken=NOT_TAKEN)]}) == [
        "exposure.flicker_hz, exposure.flicker_depth, motion.image_um_per_s change nothing here"
    ]
    with warnings.catch_warnings(action="error"):  # a camera's own lens stands in its file
        datasheet_settings("imx363", [], None, None, None)


def test_rows_name_settings_that_exist() -> None:
    names = {
        *MOVES,
        *Run.model_fields,
        *Study.model_fields,
        *(f"camera.{name}" for name in CameraOptions.model_fields),
        *(
            f"metric.{metric}.{field}"
            for metric, options in METRIC_OPTIONS
            for field in type(options).model_fields
        ),
    }
    assert (
        not {*UNUSED_SETTINGS, *NOT_TAKEN, *(name for row in ROWS for name in row.settings)} - names
    )


def test_record_without_a_setting_that_is_not_stated_is_the_same() -> None:
    run = Run(seed=3)
    assert record_with(run, ["pixel", "prnu"], Default) == run
