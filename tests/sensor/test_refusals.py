"""Rules across fields, and combinations that no pixel, sensor or exposure can have: a row each."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from helpers.high_range import DUAL, split_of_three

import pixsim
from pixsim import Camera, Correction, Exposure, Motion, PixsimError, SpectralImage, datasheet
from pixsim.sensor.camera_data import camera_sensitivities, has_common_scale
from pixsim.sensor.collection import collected_fraction, emva_illumination, kernel_on_axis
from pixsim.sensor.correction import flat_light_e
from pixsim.sensor.crosstalk import share_with_neighbours
from pixsim.sensor.diffusion import absorption_per_um
from pixsim.sensor.integration import integrate_pixels, pixel_count, pixels_on
from pixsim.sensor.motion import border_with_motion_um
from pixsim.sensor.photodiode import diode_of
from pixsim.sensor.pixel import derive, given_efficiency, pitch_for_fill_factor_um
from pixsim.sensor.pixel_options import Pixel, excluded_by
from pixsim.sensor.raw import _check_image
from pixsim.sensor.reading import Readout
from pixsim.sensor.readout import (
    capture,
    capture_from_rates,
    make_frame,
    make_sensor,
    quantise,
    read_out,
    sample_sensor,
)
from pixsim.sensor.stack_options import StackOptions
from pixsim.sensor.technology import Technology, load_technology

T035 = load_technology("0.35um")
LENS = {"height_um": 4.0, "index": 1.5, "microlens": "square"}
SHEET = {
    "pitch_um": 4.0,
    "full_well_e": 1e4,
    "read_noise_e": 2.0,
    "dark_current_e_per_s": 5.0,
    "quantum_efficiency": 0.6,
}
GRID_NM = [float(nm) for nm in range(400, 701, 10)]
FLAT = [[nm, 0.4] for nm in GRID_NM]
RGB = {"quantum_efficiencies": dict.fromkeys("RGB", FLAT)}
DEVICE = Readout.of(derive(Pixel(pitch_um=100.0)))
DARKNESS = np.random.default_rng(0)


def pixel(**over) -> Pixel:
    """A data sheet with some numbers in place of others."""
    return Pixel(**{name: value for name, value in (SHEET | over).items() if value is not None})


def process(**over) -> Technology:
    """The 0.35 µm process with other numbers, also of its junction."""
    record = T035.model_dump() | {"ranges": {}, "distributions": {}} | over
    if record["junction"]:
        junction = {name: over.get(name, value) for name, value in record["junction"].items()}
        record["junction"] = junction
        record = {name: value for name, value in record.items() if name not in junction}
    return Technology(**record)


def at_red(**over) -> None:
    derive(pixel(quantum_efficiency_nm=850, **over))


def in_light(physics) -> float:
    return collected_fraction(physics, emva_illumination(np.array([550.0]), np.ones(1)))


def colour(**over) -> None:
    derive(pixel(technology="4t-bsi", quantum_efficiency=None, colour=RGB | over))


def channel_b(curve) -> None:
    colour(quantum_efficiencies={"R": FLAT, "G": FLAT, "B": curve})


def relative(camera: str, **over) -> None:
    response = {"sensitivities": camera, "peak_quantum_efficiency": 0.5}
    colour(quantum_efficiencies=None, **response | over)


REFUSALS: dict[str, tuple[Callable[[], object], str]] = {
    # stack
    "stack without height": (
        lambda: derive(Pixel(stack={"microlens": "square"})),
        "no height_um and no index",
    ),
    "depletion without diffusion length": (
        lambda: derive(Pixel(stack=LENS | {"depletion_um": 1.0})),
        "depletion_um alone",
    ),
    "diffusion length without depletion": (
        lambda: derive(Pixel(stack=LENS | {"diffusion_length_um": 1.0})),
        "diffusion_length_um alone",
    ),
    "lens too low to focus": (
        lambda: derive(Pixel(pitch_um=6.0, stack=LENS | {"height_um": 3.0})),
        "pixel.stack.height_um: got 3; .*3.38",
    ),
    "lens shifted to the neighbour": (
        lambda: derive(Pixel(pitch_um=6.0, stack=LENS | {"shift_um": [4.0, 0.0]})),
        "pixel.stack.shift_um: .*at most half of pitch_um",
    ),
    "two shifts": (lambda: StackOptions(shift="none", shift_um=[0, 0]), "shift and shift_um"),
    "crosstalk and diffusion": (
        lambda: StackOptions(crosstalk=0.1, depletion_um=1.0),
        "crosstalk and depletion_um",
    ),
    "QE above what the stack passes": (
        lambda: in_light(
            derive(pixel(pitch_um=2.0, fill_factor=0.2, quantum_efficiency=0.9, stack=LENS))
        ),
        "quantum efficiency.*0.9 at 700 nm.*at most 0.*quantum_efficiency_f_number",
    ),
    "QE measured on a pixel without photodiode": (
        lambda: in_light(
            derive(
                Pixel(
                    stack=LENS,
                    quantum_efficiency_includes="microlens",
                    quantum_efficiency_pitch_um=4.0,
                )
            )
        ),
        "quantum_efficiency_pitch_um: got 4; .*5.13",
    ),
    "kernel without a stack": (
        lambda: kernel_on_axis(derive(Pixel()), emva_illumination(np.ones(1), np.ones(1))),
        "pixel.stack: got none",
    ),
    # colour
    "no response": (lambda: colour(quantum_efficiencies=None), "no response of the channels"),
    "two responses": (
        lambda: colour(transmittances=dict.fromkeys("RGB", FLAT)),
        "quantum_efficiencies and transmittances",
    ),
    "relative responses": (
        lambda: relative("Nikon_D5100", peak_quantum_efficiency=None),
        "give peak_quantum_efficiency",
    ),
    "peak of absolute responses": (
        lambda: colour(peak_quantum_efficiency=0.5),
        "peak_quantum_efficiency together with",
    ),
    "two unit cells": (lambda: colour(pattern="rggb", matrix=["RG", "GB"]), "pattern and matrix"),
    "rows of other lengths": (lambda: colour(matrix=["RG", "G"]), "rows of equal length"),
    "small letters": (lambda: colour(matrix=["Rg", "GB"]), "capital letters"),
    "long rows": (lambda: colour(matrix=["RGRGRGRGRGRG"]), "8 x 8"),
    "no rows": (lambda: colour(matrix=[]), "rows of equal length"),
    "empty rows": (lambda: colour(matrix=["", ""]), "rows of equal length"),
    "letter without response": (lambda: colour(matrix=["RG", "XB"]), "unit cell has X"),
    "response without letter": (lambda: colour(matrix=["RG", "GR"]), "B has no pixels"),
    "binning of different pixels": (lambda: colour(binning=True), "binning = true"),
    "binning of 3T pixels": (
        lambda: derive(Pixel(pitch_um=8, colour=RGB | {"pattern": "quad_rggb", "binning": True})),
        "binning: .*3T pixel.*4t-bsi",
    ),
    "QE above 1": (lambda: channel_b([[nm, 1.2] for nm in GRID_NM]), "0 to 1"),
    "QE below 0": (lambda: channel_b([[nm, -0.1] for nm in GRID_NM]), "negative"),
    "curve that ends early": (lambda: channel_b(FLAT[:20]), "400 to 590 nm"),
    "curve with a gap": (lambda: channel_b(FLAT[:9] + FLAT[14:]), "gap from 480 to 540"),
    "dark channel": (lambda: channel_b([[nm, 0.0] for nm in GRID_NM]), "0 at every"),
    "curve with a wavelength twice": (
        lambda: channel_b(FLAT[:5] + FLAT[4:]),
        "440 nm followed by 440 nm",
    ),
    "curve far above 1": (lambda: channel_b([[nm, 150.0] for nm in GRID_NM]), "with 150 at 400 nm"),
    "curve that is a number": (lambda: channel_b(0.5), "pairs for B"),
    "channel of several letters": (
        lambda: colour(quantum_efficiencies={"R": FLAT, "G": FLAT, "B": FLAT, "teal": FLAT}),
        "'teal'; allowed: one letter",
    ),
    "file that is not there": (lambda: colour(quantum_efficiencies="no.csv"), "no.csv"),
    "unknown camera": (lambda: relative("Nikon_D510"), "Nikon_D5100"),
    "unknown camera in Python": (
        lambda: camera_sensitivities("Nikon D5100"),
        "ARRI_D21.*Did you mean 'Nikon_D5100'",
    ),
    "path in place of a camera": (lambda: has_common_scale("../LICENSE"), "ARRI_D21.*Sony_ILCE-9"),
    "camera without the channel": (lambda: relative("Nikon_D5100", pattern="rccb"), "channel C"),
    # data sheets
    "incomplete data sheet": (
        lambda: Pixel(technology=None, dark_current_e_per_s=1, quantum_efficiency=0.5),
        "missing: full_well_e, read_noise_e",
    ),
    "saturation capacity of a soft well": (
        lambda: Pixel(saturation_capacity_e=9000, well_limit="diode"),
        "Give full_well_e instead",
    ),
    "black above white": (lambda: Pixel(bits=8, black_level_dn=255.0), "black_level_dn = 255"),
    "QE above 1 elsewhere": (
        lambda: at_red(quantum_efficiency=0.41),
        "0.41 at 850 nm, .*absorb 0.234 .*at least 9.88",
    ),
    "QE of 1 at one wavelength": (lambda: at_red(quantum_efficiency=1.0), "Give a table"),
    "curve of one point": (lambda: given_efficiency([500.0], ((500.0, 0.5),)), "at least two"),
    "dark current beyond its range when warm": (
        lambda: derive(pixel(dark_current_e_per_s=None, dark_current={"e_per_s": 1e18, "at_c": 0})),
        "dark_current: got 1e.18 e-/s at 0 °C",
    ),
    "dark current in words that need a temperature": (
        lambda: pixel(dark_current_e_per_s=None, dark_current=4.0),
        "dark_current_e_per_s = 4, or dark_current = { e_per_s = 4",
    ),
    "well in thousands, scaled below an electron": (
        lambda: derive(pixel(pitch_um=1.0, data_sheet_pitch_um=4.0, full_well_e=10.5)),
        "scale as 0.66; .*full_well_e = 10500",
    ),
    "PRNU of a photodiode that is too small": (
        lambda: derive(Pixel(prnu_um=2.0)),
        "prnu_um: got 2, .*Give at most 1.09",
    ),
    "A_Vt without an area": (lambda: derive(Pixel(a_vt_mv_um=8.0)), "no follower_area_um2"),
    "area without A_Vt": (lambda: derive(Pixel(follower_area_um2=0.5)), "no a_vt_mv_um"),
    "A_Vt of a pinned photodiode": (
        lambda: derive(Pixel(technology="4t-bsi", a_vt_mv_um=8, follower_area_um2=1)),
        "pinned photodiode of 4t-bsi",
    ),
    "A_Vt of a data sheet": (
        lambda: derive(pixel(a_vt_mv_um=8, follower_area_um2=1)),
        "data sheet, whose node capacitance is unknown",
    ),
    "hot pixels like the others": (
        lambda: derive(Pixel(hot_pixel_fraction=0.1)),
        "hot_pixel_fraction: got 0.1",
    ),
    "tail without hot pixels": (
        lambda: derive(Pixel(hot_pixel_median=30.0)),
        "hot_pixel_median: got no hot_pixel_fraction",
    ),
    "unknown number": (lambda: derive(Pixel()).number("sharpness"), "quantity: got 'sharpness'"),
    # layout and technology
    **{
        f"{name} of a pinned photodiode": (
            lambda name=name, value=value: derive(Pixel(technology="4t-bsi", **{name: value})),
            f"{name}: got '{value}' for 4t-bsi",
        )
        for name, value in (
            ("well_limit", "diode"),
            ("conversion", "junction"),
            ("capacitance", "paper"),
        )
    },
    "diode of a pinned photodiode": (
        lambda: diode_of(Pixel(technology="4t-bsi", pitch_um=2.8)),
        "pinned photodiode of 4t-bsi",
    ),
    "pitch without a photodiode": (lambda: derive(Pixel(pitch_um=5.0)), "5.13.*transistors"),
    "circuits that fill the pixel": (
        lambda: derive(Pixel(pitch_um=6.0, readout={"area_um2": 36.0})),
        "readout.area_um2: got 36 in a pixel of 6 µm; allowed: below 36",
    ),
    "pitch of an unfinished data sheet": (
        lambda: derive(Pixel(pitch_um=2.0, full_well_e=1e4, read_noise_e=2.0)),
        "give dark_current_e_per_s, quantum_efficiency",
    ),
    "fill factor beyond the limit": (
        lambda: pitch_for_fill_factor_um(0.826, T035),
        "fill_factor: got 0.826",
    ),
    "swing above the reset": (lambda: process(voltage_swing_v=9.0), "voltage_swing_v = 9"),
    "no capacitance": (
        lambda: process(cj_ff_per_um2=0, cjsw_ff_per_um=0, node_capacitance_ff=0),
        "at least 1e-06",
    ),
    "a junction and a density of charge": (
        lambda: process(full_well_e_per_um2=1e3),
        "either full_well_e_per_um2",
    ),
    "fill factor inset beyond the smallest pixel": (
        lambda: process(fill_factor_inset_features=20.0),
        "inset_features = 20 exceeds",
    ),
    "no PRNU": (lambda: process(prnu=None), "neither prnu nor prnu_um"),
    "two PRNUs": (lambda: process(prnu_um=0.02), "both prnu and prnu_um"),
    "two offsets": (lambda: process(a_vt_mv_um=8.0), "a_vt_mv_um and offset_fpn"),
    "no offsets": (lambda: process(offset_fpn=None), "no offsets"),
    "half of an offset": (lambda: process(offset_fpn=None, a_vt_mv_um=8.0), "a_vt_mv_um alone"),
    "offsets of an unknown node": (
        lambda: process(
            offset_fpn=None,
            a_vt_mv_um=8.0,
            follower_area_um2=1.0,
            junction=None,
            full_well_e_per_um2=3e3,
        ),
        "node capacitance of a pinned photodiode is unknown",
    ),
    "range of an unknown number": (
        lambda: process(ranges={"sharpness": (0.0, 1.0)}),
        "range: got 'sharpness'",
    ),
    "unknown technology": (lambda: load_technology("0.13um"), "0.13um.*0.5um"),
    "sensor in place of a technology": (lambda: load_technology("imx363"), "config=imx363"),
    "mistyped sensor": (lambda: load_technology("imx36"), "Did you mean 'imx363'"),
    "technology that is not there": (lambda: load_technology("no/no.toml"), "does not exist"),
    "name that cannot stand in a table": (lambda: load_technology("=a.toml"), "Rename the file"),
    "unknown number of a process": (
        lambda: T035.with_numbers({"dark_currnt": 1.0}, "process.x"),
        "process.x: got 'dark_currnt'.*Did you mean",
    ),
    "number of a process out of range": (
        lambda: T035.with_numbers({"voltage_swing_v": 2.3}, "process.x"),
        "process.x: .*2.3 exceeds",
    ),
    # several readings
    "a kind beside readings": (
        lambda: pixel(readout=split_of_three(kind="split")),
        "got no response, .* with kind = 'split'",
    ),
    "two collectors of one name": (
        lambda: pixel(readout=split_of_three(collector=[{"name": "large"}] * 2)),
        "collectors large, large, small; .* large, large, all of them",
    ),
    "a reading of no collector": (
        lambda: pixel(readout=split_of_three(collector=[{"name": "large"}])),
        "collectors large, large, small; .* large, all of them",
    ),
    "a first collector that is no reference": (
        lambda: pixel(
            readout=split_of_three(
                collector=[{"name": "large", "response": 0.5}, {"name": "small"}]
            )
        ),
        "response = 0.5 and length_share = 1 of the first collector",
    ),
    "three numbers of two readings": (
        lambda: pixel(readout=DUAL | {"read_noise_e": [1, 2, 3]}),
        "read_noise_e of 3 numbers",
    ),
    "a blend that ends before it begins": (
        lambda: pixel(readout=DUAL | {"blend_from_share": 0.95}),
        "blend_from_share = 0.95",
    ),
    "readings of a soft well": (
        lambda: Pixel(readout=DUAL, well_limit="diode"),
        "several readings, or companding, with well_limit = 'diode'",
    ),
    "fifteen codes for ten linear DN": (
        lambda: pixel(companding=[[0, 0], [10, 10], [20, 25]]),
        "companding: got companding of 3 knees",
    ),
    "a burst of companded codes": (
        lambda: Readout.of(derive(pixel(companding=[[0, 0], [4000, 1000]]))).burst(2),
        "exposure.frames: got 2 with pixel.companding",
    ),
    "codes of several readings": (
        lambda: read_out(
            np.ones((2, 2)),
            1.0,
            sample_sensor(Readout.of(derive(pixel(readout=DUAL))), (2, 2), DARKNESS),
            DARKNESS,
        ),
        "pixel.readout: got the readings high, low",
    ),
    # readout and exposure
    "sum of more than 31 bits": (lambda: DEVICE.burst(2**30), "exposure.frames.*31 bits"),
    "codes of more than 31 bits": (lambda: quantise(np.zeros(1), 32), "bits: got 32"),
    "negative signal": (lambda: pixsim.snr_db(pixel(), -1.0), "charge_e: got .*-1"),
    "flat frames without light": (
        lambda: flat_light_e(Readout.of(derive(pixel())), Correction(flat_frames=1), 1e3),
        "correction.flat_level: got 0.5, with 5000 e-",
    ),
    "defects without frames that show them": (
        lambda: Correction(defects=True),
        "dark_frames or flat_frames",
    ),
    "rolling shutter without a time": (lambda: Exposure(shutter="rolling"), "line_time_us"),
    "flicker without depth": (lambda: Exposure(flicker_hz=100.0), "flicker_depth"),
    "two velocities": (
        lambda: Motion(velocity_mm_per_s=(1.0, 0.0), pixels_per_s=(0.0, 0.0)),
        "velocity_mm_per_s and pixels_per_s",
    ),
    "path longer than the die": (
        lambda: border_with_motion_um(
            3.0, Motion(image_um_per_s=(0.0, 1e6)), Exposure(), Camera(), [(5.0, 1)]
        ),
        "motion: got a path of up to 1e.05 µm",
    ),
    "margin wider than the die": (
        lambda: border_with_motion_um(
            3.0, Motion(pixels_per_s=(1, 0), margin_um=2e3), Exposure(), Camera(), [(5.0, 1)]
        ),
        "motion: got a margin of 2000 µm",
    ),
    "picture of another shape": (
        lambda: read_out(np.ones((2, 2)), 1.0, sample_sensor(DEVICE, (3, 2), DARKNESS), DARKNESS),
        "mean_e: .*2, 2.*3, 2",
    ),
    "rates of another shape": (
        lambda: capture_from_rates(
            np.ones((2, 2)), sample_sensor(DEVICE, (3, 2), DARKNESS), Exposure(), DARKNESS
        ),
        "sensor: .*Make the sensor",
    ),
    "more electrons than single precision holds": (
        lambda: make_frame(
            np.zeros((2, 3), np.int32),
            0.0,
            np.full((2, 3), 1e38, np.float32),
            DEVICE,
            Exposure(integration_s=100.0),
        ),
        "mean_e: .*1e.38",
    ),
    "more dark electrons than single precision holds": (
        lambda: make_frame(
            np.zeros((2, 3), np.int32),
            0.0,
            np.zeros((2, 3), np.float32),
            DEVICE.with_physics(dark_current_e_per_s=1e30),
            Exposure(integration_s=1e9),
        ),
        "mean_e: got 0 e-/s for 1e.09 s",
    ),
    "a well below an electron": (
        lambda: replace(derive(Pixel()), full_well_e=1e-320),
        "full_well_e: got 1e-320",
    ),
    "light that is not a number": (
        lambda: capture(
            SpectralImage([550.0], 10.0, 100.0, data=np.full((27, 27, 1), np.nan)),
            Camera(),
            make_sensor(Pixel(pitch_um=100.0), Camera()),
            rng=DARKNESS,
        ),
        "irradiance: got values from nan",
    ),
    "a picture in colour of more samples than are read": (
        lambda: [
            _check_image(
                type(
                    "Picture",
                    (),
                    {
                        "mode": "RGB",
                        "tile": ";16",
                        "width": 9459,
                        "height": height,
                        "getbands": tuple,
                    },
                ),
                {},
                "picture",
            )
            for height in (9459, 9460)  # 2²⁸/3 is 9459 × 9459.6
        ],
        "picture: got 3 × 9459 × 9460 samples",
    ),
    # pixels on a die
    "too many pixels": (lambda: pixel_count(2713.6, 1e-310), "pitch_um: .*on this die"),
    "pixel larger than the picture": (
        lambda: integrate_pixels(np.ones((10, 20)), 1.0, 11.0, 5.0),
        "pitch_um: got 11; .*the die, 10",
    ),
    "pixel larger than the die": (
        lambda: make_sensor(Pixel(pitch_um=3000.0), Camera()),
        "pitch_um: got 3000",
    ),
    "no room at a registration": (lambda: pixels_on((1.9, 1.5), 1.0, (0.0, 0.5)), "registration 0"),
    "kernel of another shape": (
        lambda: share_with_neighbours(np.ones((4, 4)), np.ones((2, 5, 5))),
        "shares: got an array of shape",
    ),
    "light that silicon's table lacks": (
        lambda: absorption_per_um([550.0, 1201.0]),
        "wavelength_nm: got 1201",
    ),
    # numbers in another unit
    "PRNU in per cent": (lambda: Pixel(prnu=0.5), "Write prnu = 0.005"),
    "fill factor in per cent": (lambda: Pixel(fill_factor=60.0), "Write fill_factor = 0.6"),
    "data sheet at a metered gain": (
        lambda: datasheet("4t-bsi", pixel={"pitch_um": 3.0}, exposure={"gain_db": "auto"}),
        "gain_db",
    ),
    "a PRNU beyond any float": (lambda: Pixel(prnu=10**400), "prnu: got"),
    "QE in per cent": (lambda: Pixel(quantum_efficiency=62.0), "0.62"),
}


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("name", REFUSALS)
def test_refusals(name: str) -> None:
    call, words = REFUSALS[name]
    with pytest.raises((PixsimError, ValueError), match=words):
        call()


@pytest.mark.parametrize(
    ("word", "fields"),
    [
        ("saturation_capacity_e", {"full_well_e": 1e4}),
        ("dn_per_e", {"gain_e_per_dn": 2.5, "adc_full_scale_e": 9000}),
        ("adc_full_scale_e", {"gain_e_per_dn": 2.5}),
        (
            "temporal_dark_noise_e",
            {"read_noise_e": 2.0, "row_noise_e": 1.0, "reset_noise_factor": 1},
        ),
        ("prnu_percent", {"prnu": 0.01, "prnu_um": 0.01}),
        ("prnu_um", {"prnu": 0.01}),
        ("dsnu_e", {"offset_fpn": 0.001, "column_fpn": 0.001, "a_vt_mv_um": 4.0}),
        ("a_vt_mv_um", {"offset_fpn": 0.001}),
        ("follower_area_um2", {"offset_fpn": 0.001}),
    ],
)
def test_a_quantity_is_stated_once(word: str, fields: dict[str, float]) -> None:
    for name, value in fields.items():
        with pytest.raises(ValueError, match=f"{word} and {name}"):
            Pixel(**{word: 4, name: value})
    assert excluded_by([word]) >= set(fields)
    assert all(word in excluded_by([name]) for name in fields)
