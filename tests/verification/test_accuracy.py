"""`pixsim accuracy`: the ladder of error against run time, and its files; every extreme case meets
its known answer without a warning, its numbers are those of closed forms, and wrong kernels fail.
"""

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import closed_forms as exact
from helpers.edits import VARIANT

import pixsim
from pixsim.base.progress import no_stage
from pixsim.light.spectral import SpectralImage, photons_per_joule, photopic_efficiency
from pixsim.optics.diffraction import diffract, diffraction_otf
from pixsim.optics.stack import stack_collection
from pixsim.optics.thin_lens import irradiance_factor
from pixsim.report.accuracy import FILES, reference_words
from pixsim.sensor.integration import (
    electrons_per_joule,
    integrate_pixels,
    mean_signal_rate,
    pixel_count,
)
from pixsim.sensor.photodiode import collected_charge_e, diode_of
from pixsim.sensor.reading import Readout
from pixsim.studies.design import Case
from pixsim.studies.lights import light_request
from pixsim.verification import extreme_cases, ladder
from pixsim.verification.case import ANSWERS, KnownAnswer
from pixsim.verification.ladder import EFFORTS, Accuracy, Rung, climb
from pixsim.viewer.score import LightError
from pixsim.viewer.setting import Run

SMALL = {"display": {"dots": 32}, "camera": {"die_mm": 0.4}}
CASES = [
    KnownAnswer("one", lambda: 1.0, 1.0, 0.1, "it's right").check("optics"),
    KnownAnswer("two & three", lambda: 2.0, 1.0, 0.1, "by <hand>").check("viewer"),
]


def test_ladder_of_a_chart_climbs_to_the_film_of_a_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The stated error is a bound, where the film is large enough to tell."""
    monkeypatch.setattr(ladder, "all_cases", lambda: CASES)
    small = SMALL | {"display": {"dots": 64}, "parameters": {"resolution": 64}}
    accuracy = pixsim.accuracy("csf", variant=VARIANT, **small)
    width = pixsim.run("csf", **small).irradiance.shape[1]
    assert [rung.across for rung in accuracy.rungs] == [width // times for times in (4, 2, 1)]
    assert accuracy.reference.across >= 2 * width
    stated, errors = np.transpose(
        [(rung.stated_delta_e, rung.error_delta_e) for rung in accuracy.rungs]
    )
    assert accuracy.reference.stated_delta_e < errors.min() / 3
    assert (stated / errors)[1:].min() > 1, "the first film is too coarse to tell"
    assert math.isnan(stated[0])
    assert "by &lt;hand&gt;" in accuracy.write(tmp_path).read_text(encoding="utf-8")
    files = {path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*.*")}
    assert files >= {name for name in FILES if not name.endswith(".pdf")}
    assert len(json.loads((tmp_path / "summary.json").read_bytes())["ladder"]) == 3


@pytest.mark.parametrize(("error", "is_sure"), [(0.001, True), (0.004, False), (math.nan, False)])
def test_reference_is_one_whose_error_is_below_a_third_of_the_smallest_shown(
    error: float, is_sure: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Films that err by 0.04, 0.02 and 0.01."""
    scene = pixsim.load_scene("csf", resolution=64)
    run = Run.model_validate(SMALL)
    request = light_request(Case(run, resolved=(scene, scene.camera(run.camera))))

    def measured(request: object, imaging: object, across: int, *_: object) -> tuple[Rung, None]:
        miss, stated = (0.0, error) if across > 256 else (2.56 / across, 2.56 / across)
        return Rung(across, 0.2, 0.1, 1.0 + miss, LightError(stated, 0.0)), None

    monkeypatch.setattr(ladder, "_measure", measured)
    rungs, reference = climb(request, 256, EFFORTS, no_stage(""))
    assert (reference is not None) == is_sure
    expected = [0.04, 0.02, 0.01] if is_sure else [math.nan] * 3
    np.testing.assert_allclose([rung.error_delta_e for rung in rungs], expected, rtol=1e-9)
    header = {"scene": "csf", "scene_hash": "a", "variant": "b"}
    accuracy = Accuracy("csf", rungs, reference, tuple(CASES), header, Run(), 1.0)
    assert ("no reference" in reference_words(accuracy)) == (not is_sure)
    assert accuracy.to_csv().count("\n") == 1 + 3
    drawn = accuracy.plot().axes[0].get_legend_handles_labels()[1]
    assert (drawn, repr(accuracy)[:16]) == (
        ["measured", "stated"][not is_sure :],
        "<Accuracy of csf",
    )


@pytest.mark.parametrize(
    ("scene", "pixel", "text"),
    [
        ("no_such_scene", {}, "no_such_scene"),
        ("csf", {"pitch_um": 1.0}, "pitch"),
        ("picture.exr", {}, "picture.exr"),
    ],
)
def test_a_scene_without_a_ladder_is_refused(scene: str, pixel: dict, text: str) -> None:
    with pytest.raises(pixsim.PixsimError, match=text):
        pixsim.accuracy(scene, quick=True, pixel=pixel)


ROOMS = {rows.__name__: rows for rows in extreme_cases.TABLE}


@pytest.mark.parametrize("room", ROOMS)
def test_extreme_cases_pass(room: str) -> None:
    cases = [KnownAnswer(*row).check(room) for row in ROOMS[room]()]
    misses = [
        (case.name, case.expected, case.got, case.error, case.allowed, case.warned)
        for case in cases
        if not case.passed
    ]
    assert not misses


# --- What a case takes for right ---


@pytest.mark.parametrize(
    ("call", "expected", "tolerance", "scale", "passes"),
    [
        (lambda: [1.0, 2.0 + 1e-9], [1.0, 2.0], 1e-8, None, True),
        (lambda: [1.0, 2.1], [1.0, 2.0], 1e-2, None, False),
        (lambda: [1.0, math.nan], [1.0, 1.0], 1.0, None, False),
        (lambda: [1e-300], [0.0], 1.0, None, False),
        (lambda: [1e-3], [0.0], 1e-2, 1.0, True),
        (lambda: [math.nan], [0.0], 1e-2, None, False),
        (lambda: [np.inf], [1.0], 1e9, None, False),
        (lambda: 1 / (1 / np.float64(0)), 0.0, 0.1, None, False),  # warns
    ],
)
def test_case_passes_within_its_tolerance_without_a_warning(
    call: Callable, expected, tolerance: float, scale: float | None, passes: bool
) -> None:
    assert (
        KnownAnswer("values", call, expected, tolerance, "", ((),), scale).check().passed == passes
    )


def test_case_names_its_worst_element_of_all_calls() -> None:
    calls = [(1.0, 1.0), (2.0, 5.0), (3.0, 9.0)]
    case = KnownAnswer("squares", lambda x: x * x, ANSWERS, 0.5, "", calls).check("room")
    assert (case.expected, case.got, case.error, case.room) == (5.0, 4.0, 0.2, "room")


# --- Numbers of the table ---


def line_numbers(centre_nm: float) -> list[float]:
    physics = extreme_cases.physics_of({"pitch_um": 10.0})
    electrons = exact.response_to_line(
        centre_nm, lambda nm: physics.quantum_efficiency(nm) * photons_per_joule(nm)
    )
    return [
        exact.power_in_range(centre_nm),
        electrons,
        683.002 * exact.response_to_line(centre_nm, photopic_efficiency),
    ]


def junction_well_e(pitch_um: float) -> float:
    """∫C dV/q over the voltage swing, of a diode scaled from that of 6.5 µm."""
    side_um = pitch_um * math.sqrt(0.5)
    reference = diode_of(extreme_cases.physics_of({"fill_factor": 0.5}))
    diode = replace(reference, area_um2=side_um**2, perimeter_um=4 * side_um)
    swing_v = extreme_cases.physics_of({}).technology.junction.voltage_swing_v
    return exact.charge_to_e(diode, diode.reset_voltage_v - swing_v)


def saturated_share() -> float:
    quiet = {"prnu": 0, "dark_current_e_per_s": 0, "column_fpn": 0}
    return exact.saturated_share(Readout.of(extreme_cases.physics_of(quiet)))


def green_e_per_s() -> float:
    camera, per_joule = extreme_cases.CAMERA, 555e-9 / (6.62607015e-34 * 299792458.0)
    sin2 = 1 / (1 + 4 * (camera.f_number * (1 + camera.magnification)) ** 2)
    return math.pi * sin2 / 683.002 * 12.5e-12 * per_joule * 0.5


def airy_tail() -> float:
    """Over its rings, the Airy pattern decays as λN/(π³ r³); mirrored at the borders, strips of 80
    µm repeat every 160 µm.
    """
    near_um = np.add.outer([30, 50], 160 * np.arange(1000))
    n_w = extreme_cases.CAMERA.f_number * (1 + extreme_cases.CAMERA.magnification)
    return float(2e-3 * 555 * n_w / math.pi**3 * (1 / near_um - 1 / (near_um + 80)).sum())


def spot_shares() -> list[float]:
    nodes, weights = np.polynomial.legendre.leggauss(400)
    half = 0.4 * 1.5 / (2 * 3e-3 * extreme_cases.SPOT_NM)
    return [float(share) for share in (half * (np.sinc(half[:, None] * nodes) ** 2 @ weights)) ** 2]


def lit_rate() -> float:
    nm = extreme_cases.BANDS_NM[::2]
    physics = extreme_cases.physics_of({"pitch_um": 10.0})
    per_joule = nm * 1e-9 / (6.62607015e-34 * 299792458.0)
    return (
        math.fsum(0.2 * physics.quantum_efficiency(nm) * per_joule)
        * physics.photodiode_area_um2
        * 1e-12
    )


NAMED = {name: row for rows in ROOMS.values() for row in rows() for name in [row[0]]}
CHARGES: dict[str, Callable] = {
    "closed form": exact.constant_diode_charge_e,
    "LSODA, an implicit solver, with a tolerance of 1e-13": exact.implicit_charge_e,
    "∫C dV/q of SPICE's C(V) down to V_oc = -V_T ln(1 + i/I_s), by quadrature": (
        exact.open_circuit_charge_e
    ),
}
NUMBERS: dict[
    str, tuple[object, Callable, float]
] = {  # of the table, of a closed form, relative tolerance
    "irradiance": (
        [row[-1] for row in extreme_cases.IRRADIANCES],
        lambda: [
            exact.solid_angle_integral(0.5 / (n * (1 - m)), t)
            for n, t, m, _ in extreme_cases.IRRADIANCES
        ],
        1e-14,  # of the quadrature
    ),
    # Where a number is printed with all of its digits, 1e-9 is far below the tolerance of its case.
    "OTF": (
        [otf for _, otf in extreme_cases.OTFS],
        lambda: [exact.pupil_overlap(1 - share) for share, _ in extreme_cases.OTFS],
        1e-4,  # the last one, 1.2e-15, has five digits
    ),
    "lines": (
        [row[1:] for row in extreme_cases.LINES],
        lambda: [line_numbers(row[0]) for row in extreme_cases.LINES],
        1e-5,
    ),
    "junction wells": (
        [well for _, well in extreme_cases.JUNCTION_WELLS_E],
        lambda: [junction_well_e(pitch_um) for pitch_um, _ in extreme_cases.JUNCTION_WELLS_E],
        1e-12,
    ),
    "saturated share": (extreme_cases.SATURATED_SHARE, saturated_share, 1e-9),
    "green light": (extreme_cases.GREEN_E_PER_S, green_e_per_s, 1e-12),
    "24 bits": (
        [extreme_cases.WIDE_DN, extreme_cases.WIDE_DN2],
        lambda: [1000 + (2**24 - 1001) / 2, 0.5e12 * ((2**24 - 1001) / 1e12) ** 2 + 1 / 12],
        1e-12,
    ),
    "Airy tail": (
        NAMED["1e10 : 1 with diffraction: light 6 pixels inside the dark half"][2],
        airy_tail,
        1e-6,
    ),
    "spots": (NAMED["diffraction of a microlens of 1 µm, 300 … 1200 nm"][2], spot_shares, 1e-9),
    "lit bands": (NAMED["electrons of every pixel, every second band dark"][2], lit_rate, 1e-12),
    "CIELAB": (
        [lab for _, lab in extreme_cases.COLOURS],
        lambda: [exact.lab_of(np.array(colour)) for colour, _ in extreme_cases.COLOURS],
        1e-12,
    ),
    "gratings": (
        [lab for *_, lab in extreme_cases.GRATINGS],
        lambda: [
            exact.blurred_grating_lab(density, order)[0]
            for density, order, _ in extreme_cases.GRATINGS
        ],
        1e-12,
    ),
    **{
        source: (
            [answer[-1] for answer in answers],
            lambda answers=answers, source=source: [
                CHARGES[source](i, t, diode_of(extreme_cases.pixel_at(process, kelvin)))
                for process, kelvin, i, t, _ in answers
            ],
            1e-11,  # of LSODA; the table has 14 digits
        )
        for source, answers in extreme_cases.CHARGES_E.items()
    },
}


@pytest.mark.parametrize("name", NUMBERS)
def test_numbers_of_the_table_are_those_of_closed_forms(name: str) -> None:
    number, closed_form, tolerance = NUMBERS[name]
    np.testing.assert_allclose(
        np.asarray(number), np.asarray(closed_form(), float), rtol=tolerance, atol=1e-13
    )


# --- Wrong kernels ---


def sampled(rate, sample_um, pitch_um, side_um):
    """Point sampling at the centres of the pixels."""
    places = [
        np.clip((n / 2 + (np.arange(k) - (k - 1) / 2) * pitch_um / sample_um).astype(int), 0, n - 1)
        for n, k in ((n, pixel_count(n * sample_um, pitch_um)) for n in rate.shape)
    ]
    return rate[np.ix_(*places)] * side_um**2


def at_the_middle(lamp, bands):
    """Lamps sampled at the centres of bands."""
    return SpectralImage(
        bands.wavelength_nm,
        10.0,
        20.0,
        factors=(np.interp(bands.wavelength_nm, lamp.nodes_nm, lamp.values), np.ones((1, 6, 6))),
        header={"luminance_cd_per_m2": 1000.0},
    )


LENS, OTF, PIXELS = (
    ("optics", "irradiance_factor"),
    ("optics", "diffraction_otf"),
    ("integration", "integrate_pixels"),
)
WRONG = {
    "cos⁴": (
        *LENS,
        lambda n, t, m: np.pi / (4 * np.square(n * (1 + np.abs(m))) * (1 + np.square(t)) ** 2),
    ),
    "1/N² of the engraved f-number": (*LENS, lambda n, t, m: irradiance_factor(n, t, 0 * m)),
    "E/L in single precision": (*LENS, lambda n, t, m: np.float32(irradiance_factor(n, t, m))),
    "an error of 5e-15": (*LENS, lambda n, t, m: irradiance_factor(n, t, m) * (1 + 5e-15)),
    "a linear OTF": (*OTF, lambda f, nm, n: np.maximum(1 - np.asarray(f) * nm * n / 1e6, 0)),
    "an OTF above 0 beyond the cut-off": (
        *OTF,
        lambda f, nm, n: np.maximum(diffraction_otf(f, nm, n), 1e-300),
    ),
    "0.01 % in N": (*OTF, lambda f, nm, n: diffraction_otf(np.asarray(f) * 1.0001, nm, n)),
    "black padding": (
        "optics",
        "diffract",
        lambda picture, *light: diffract(np.pad(picture, 8), *light)[8:-8, 8:-8],
    ),
    "rates in single precision": (
        *PIXELS,
        lambda r, *lengths: integrate_pixels(r.astype(np.float32).astype(float), *lengths),
    ),
    "a gap of 1e-9 between photodiodes": (
        *PIXELS,
        lambda r, s, p, d: integrate_pixels(r, s, p, d * (1 - 1e-9)),
    ),
    "point sampling": (*PIXELS, sampled),
    "0.1 % of QE": (
        "spectra",
        "electrons_per_joule",
        lambda physics, image: 1.001 * electrons_per_joule(physics, image),
    ),
    "a signal in the dark": (
        "spectra",
        "mean_signal_rate",
        lambda *arguments: 1e-300 + mean_signal_rate(*arguments),
    ),
    "lamps sampled at the centres of bands": ("spectra", "image_of", at_the_middle),
    "1e-7 of a diode's charge": (
        "photodiode",
        "collected_charge_e",
        lambda i, t, d: (1 + 1e-7) * collected_charge_e(i, t, d),
    ),
    "noise on the wrong side of the gain": (
        "sensor",
        "Readout.read_noise_at_gain_e",
        property(lambda readout: np.hypot(readout.read_noise_e, readout.read_noise_after_gain_e)),
    ),
    # It collects more than étendue allows.
    "2 % in the f-number of a stack": (
        "stacks",
        "stack_collection",
        lambda *sizes, f_number, **more: stack_collection(*sizes, f_number=1.02 * f_number, **more),
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_cases_with_a_wrong_kernel_fail(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    room, kernel, wrong = WRONG[name]
    monkeypatch.setattr(f"pixsim.verification.extreme_cases.{kernel}", wrong)
    monkeypatch.setattr(extreme_cases, "LONG", 200)
    assert not all(KnownAnswer(*row).check(room).passed for row in ROOMS[room]())
