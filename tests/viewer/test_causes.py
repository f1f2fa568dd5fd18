"""What a mean ΔE is made of: noise budgets, whose variances add up to that of frames and parts of ΔE
to the whole; further causes, and notes: when each is named, how large a cause is, and what comes first.
"""

import math
import re
import warnings
from dataclasses import replace

import numpy as np
import pytest
from helpers.chains import imaging, imaging_chain, scene_of
from helpers.claims import Claim

from pixsim import (
    Camera,
    Develop,
    Display,
    Exposure,
    Motion,
    Pixel,
    SpectralImage,
    evaluate,
    optics,
    spectral,
)
from pixsim.base.note_kinds import NOTES
from pixsim.base.notes import collected_notes
from pixsim.light.spectral import (
    DIFFUSER,
    WHITE_RADIANCE,
    Spectrum,
    colour_matching,
    d65,
    luminous_weight,
)
from pixsim.optics import irradiance_factor
from pixsim.sensor import noise
from pixsim.sensor.collection import Collection, ColourCollection
from pixsim.sensor.colour import Layout
from pixsim.sensor.pixel import derive
from pixsim.sensor.reading import Readout
from pixsim.sensor.readout import frame_variance_dn2
from pixsim.sensor.spectral_range import OUTSIDE, outside_header, outside_share
from pixsim.viewer.causes import causes_of, is_uninformative
from pixsim.viewer.every_pixel import at_every_pixel, neighbours
from pixsim.viewer.noise_budget import (
    APERTURE,
    BLUR,
    COLOUR_ERROR,
    CROSSTALK,
    DARK,
    FLICKER,
    LENS,
    MOSAIC,
    MOTION,
    NOISE,
    REDUCTION,
    ROUNDING,
    SAMPLING,
    SHOT,
    VEIL,
    NoiseBudget,
    _merged_variances,
    finer_adc,
    noise_budget,
    noiseless_frame,
    without_denoising,
)
from pixsim.viewer.score import NOTHING, Cause

NM = np.arange(405.0, 700.0, 10.0)
CAMERA = Camera(focal_length_mm=4.0, die_mm=0.32)
DISPLAY = Display(dots=64, white_cd_per_m2=1000.0)
FLAT = Readout.of(derive(Pixel(pitch_um=5.0, technology="4t-bsi", quantum_efficiency=0.5)))
CHECKS = np.indices((64, 64)).sum(axis=0) // 8 % 2 * 0.8 + 0.1
QUIET = {
    "technology": "none",
    "pitch_um": 5.0,
    "full_well_e": 1e4,
    "quantum_efficiency": 0.5,
    "bits": 12,
    "read_noise_e": 1.0,
    "dark_current_e_per_s": 0.0,
}
STEADY = Exposure()


def light(picture: np.ndarray | float, **header) -> SpectralImage:
    """Return light of D65 with 1000 cd/m² where the picture is 1."""
    spectrum = spectral.d65(NM)
    lux = 683.002 * 10 * float(spectrum @ spectral.photopic_efficiency(NM))
    factor = float(optics.irradiance_factor(CAMERA.f_number, 0.0, CAMERA.magnification))
    factors = spectrum, picture * np.ones((1, 64, 64)) * factor * 1000 / lux
    return SpectralImage(NM, 10.0, 5.0, factors=factors, header={"diffraction": False} | header)


def named(
    readout: Readout = FLAT,
    white_e: float = 1e4,
    lightness: tuple[float, float] = (0.0, 100.0),
    saturated_fraction: float = 0.0,
    *,
    header: dict | None = None,
    display: dict | None = None,
    exposure: Exposure = STEADY,
    time_s: float = 0.01,
) -> tuple[Cause, ...]:
    """Return the causes of a frame of pixels whose numbers may be changed."""
    settings = imaging(CAMERA, readout.physics.pixel, exposure, Display(**display or {}))
    vars(settings)["readout"] = readout
    return causes_of(
        settings,
        header or {},
        white_e=white_e,
        integration_s=time_s,
        lightness=lightness,
        saturated_fraction=saturated_fraction,
    )


def delta_e_of(*arguments, **settings) -> list[float]:
    return [cause.delta_e for cause in named(*arguments, **settings)]


def lightness(luminance: float) -> float:
    """CIE L* above 8."""
    return 116 * luminance ** (1 / 3) - 16


def lamp(low_nm: float, high_nm: float) -> dict:
    """Return the header of a lamp of equal power per nm."""
    return outside_header([Spectrum(np.array([low_nm, high_nm], float), np.ones(2))])


def share_outside(low_nm: float, high_nm: float) -> float:
    """Photons outside 360-830 nm grow as the wavelength; silicon sees none beyond 1110 nm."""
    end_nm = min(high_nm, 1110)
    inside = max(0, min(end_nm, 830) ** 2 - max(low_nm, 360) ** 2)
    return 1 - inside / (end_nm**2 - low_nm**2)


def readout_of(**fields: float) -> Readout:
    return Readout.of(derive(Pixel(**QUIET | fields)))


def ramp_on_sums_of_pixels(collection: Collection | None, **registration) -> np.ndarray:
    """Return a ramp of light on sums of 2 × 2 pixels of 4 µm, away from the borders."""
    colour = {"pattern": "quad_rggb", "binning": True, "quantum_efficiencies": FILTERS}
    pixel = Pixel(technology="4t-bsi", pitch_um=4.0, colour=colour, **registration)
    scene = scene_of(light(1.0), CAMERA, pixel, DISPLAY)
    return at_every_pixel(2 * X[:64, :64] - Y[:64, :64], scene, derive(pixel), collection)[
        2:-2, 2:-2
    ]


FULL_E = FLAT.saturation_e - 0.01 * FLAT.dark_current_e_per_s
LAMP = Exposure(frames=8, flicker_hz=100.0, flicker_depth=0.6)
BURST = FLAT.burst(8)
BURST_WHITE_E = BURST.saturation_e - 0.004 * BURST.dark_current_e_per_s
HALF_FULL = {"saturated_fraction": 0.5, "time_s": 0.004}
EIGHT_BITS = readout_of(bits=8)
HIDDEN = replace(
    readout_of(full_well_e=65_535.0, bits=16, black_level_dn=30_000), read_noise_e=30_000.0
)
EVEN = np.multiply.outer([[[1.0, 2.0, 5.0, 2.0, 1.0]]], [0.0, 1.0, 4.0, 1.0, 0.0])
MIDDLES = (np.arange(2, 38) + 0.5) * 8 / 5 - 0.5  # of sums, in cells of 5 µm
CLAIMS = [
    *(
        Claim(
            f"share of a lamp from {low_nm} to {high_nm} nm outside",
            lambda low_nm=low_nm, high_nm=high_nm: outside_share(
                lamp(low_nm, high_nm), FLAT.physics
            ),
            share_outside(low_nm, high_nm),
            atol=1e-5,
            why="cells of the header",
        )
        for low_nm, high_nm in ((800, 900), (320, 700), (320, 1000), (360, 1300))
    ),
    *(
        Claim(
            f"sums of pixels have the light of their middle, {name}",
            lambda collection=collection: ramp_on_sums_of_pixels(collection),
            2 * MIDDLES - MIDDLES[:, None],
            atol=1e-10,
        )
        for name, collection in (
            ("without a stack", None),
            ("with even shares of the light around", Collection(EVEN, 2 * EVEN.sum(), 3.0)),
        )
    ),
    Claim(
        "sums whose borders lie 1/4 and 3/4 of their side beside the axis",
        lambda: ramp_on_sums_of_pixels(None, registration=(0.25, 0.75)),
        2 * (MIDDLES[:-1] + 2 / 5) - (MIDDLES[:-1, None] + 6 / 5),
        atol=1e-10,
    ),
    Claim(
        "variances of the longer of two exposures: rounding, what varies along columns, of pixels,"
        " with dark charge and light, along rows and in time, and shot noise of dark and light",
        lambda: [
            *_merged_variances(
                readout_of(**ALL | {"readout": {"kind": "staggered", "ratio": 16.0}}),
                np.array([1000.0]),
                TIME_S,
            ).values()
        ],
        [
            (14_000 / (1023 - 200)) ** 2 / 12,
            *(8.4**2, 11.2**2, 27**2, 4**2, 9**2, 12**2, 180, 1000),
        ],
        rtol=2e-5,
        why="rounding of 2⁻⁸ codes is left",
    ),
    Claim(
        "headers of other programs state no share",
        lambda: [
            outside_share({OUTSIDE: entry}, FLAT.physics)
            for entry in ("much", 1.0, [1.0], [[1.0]], {}, [["a"] * 3])
        ],
        np.zeros(6),
    ),
    Claim(
        "ΔE of light that is not computed",
        lambda: delta_e_of(header=lamp(320, 1000)),
        [100 - lightness(1 - share_outside(320, 1000))],
        rtol=1e-4,
        why="cells of the header",
    ),
    *(
        Claim(
            f"a contrast of {contrast} L* is noticed from 1 on",
            lambda contrast=contrast: delta_e_of(lightness=(50.0, 50.0 + contrast)),
            [100.0] * (contrast < 1),
        )
        for contrast in (0.9, 1.1)
    ),
    Claim(
        "of 85 % full pixels in a white of four wells, L* of a quarter is left",
        lambda: delta_e_of(FLAT, 4 * FULL_E, saturated_fraction=0.85),
        [100 - lightness(0.25)],
        atol=1e-9,
    ),
    *(
        Claim(
            f"full pixels cost nothing where {name}",
            lambda white=white, lightest=lightest, share=share: delta_e_of(
                FLAT, white * FULL_E, (0.0, lightest), share
            ),
            [],
        )
        for name, white, lightest, share in (
            ("white is full", 1, 100.0, 0.85),
            ("the picture is darker", 4, 57.0, 0.85),
            ("they are few", 4, 100.0, 0.005),
        )
    ),
    Claim(
        "of a burst at its wells each phase above the mean is lost, m/π of m = 0.6 sinc(0.05)",
        lambda: delta_e_of(BURST, BURST_WHITE_E, exposure=LAMP, **HALF_FULL),
        [100 - lightness(1 - 0.6 * np.sinc(0.05) / math.pi)],
        atol=1e-9,
    ),
    Claim(
        "steady light at the wells of a burst",
        lambda: delta_e_of(BURST, BURST_WHITE_E, exposure=LAMP.steady, **HALF_FULL),
        [],
    ),
    Claim(
        "light below the wells of a burst at all phases",
        lambda: delta_e_of(BURST, BURST_WHITE_E / 1.6, exposure=LAMP, **HALF_FULL),
        [],
    ),
    *(
        Claim(
            f"{count} codes to white: the lightness of one",
            lambda fields=fields, white_e=white_e: delta_e_of(
                readout_of(**{"black_level_dn": 0} | fields), white_e
            ),
            [lightness(1 / count)] * (count < 8),
            rtol=1e-6,
        )
        for fields, white_e, count in (
            ({"bits": 16}, 7 * 1e4 / 65535, 7),
            ({"bits": 2}, 4e4, 3),
            ({"bits": 10, "black_level_dn": 1020}, 4e4, 3),
            ({"bits": 16}, 8 * 1e4 / 65535, 8),
            ({"bits": 16}, 9 * 1e4 / 65535, 9),
        )
    ),
    *(
        Claim(
            f"lightest dot of {codes} codes of 255, where L* is linear",
            lambda codes=codes: delta_e_of(
                EIGHT_BITS,
                EIGHT_BITS.saturation_e,
                (24389 / 27 * codes / 255 - 1, 24389 / 27 * codes / 255),
            ),
            [24389 / 27 * codes / 255] * (codes < 1),
            rtol=1e-12,
        )
        for codes in (0.9, 6.0)
    ),
    Claim(
        "10 codes to white in noise of 16 000, a quarter of the range of the ADC",
        lambda: delta_e_of(HIDDEN, 10 / HIDDEN.dn_per_e),
        [100.0],
    ),
    # In each exposure 64² of read noise, 3600 dark electrons and their DSNU of 48; PRNU of the light alone.
    *(
        Claim(
            f"light of {share} thousandths of the noise is lost, {count} subexposures",
            lambda count=count, share=share: int(
                is_uninformative(
                    readout_of(
                        read_noise_e=64.0,
                        dark_current_e_per_s=count * 360_000.0,
                        prnu=0.3,
                        dsnu=48 / 3600,
                        black_level_dn=1000,
                        bits=16,
                    ).burst(count),
                    count * 0.1 * share / (66 / 116) ** 3,
                    0.01,
                    50.0,
                    0.0,
                )
            ),
            int(share < 1),
        )
        for count in (1, 4)
        for share in (0.99, 1.01)
    ),
    Claim(
        "a frame has no information where all but a millionth of its pixels are full",
        lambda: [
            int(is_uninformative(FLAT, 1e4, 0.01, 100.0, share))
            for share in (1 - 1e-5, 1 - 1e-7, 1.0)
        ],
        [0, 1, 1],
    ),
    Claim(
        "the largest cause comes first",
        lambda: np.diff(
            np.argsort(-np.array(delta_e_of(FLAT, 1.0, (50.0, 50.0), header=lamp(400, 900))))
        ),
        [1, 1],
    ),
]


@pytest.mark.parametrize("claim", CLAIMS, ids=str)
def test_closed_forms(claim: Claim) -> None:
    claim.check()


# --- contrast


@pytest.mark.parametrize(("picture", "hint"), [(0.5, "alone"), (1e-5, "lower"), (3.0, "raise")])
@pytest.mark.filterwarnings("ignore:.*brighter than display white")
def test_ideal_picture_without_contrast_is_named(picture: float, hint: str) -> None:
    pixel = Pixel(technology="4t-bsi", pitch_um=5.0, infrared_cut_nm=650.0)
    score = evaluate(light(picture), CAMERA, pixel, display=DISPLAY)
    (cause,) = score.causes
    assert "no contrast" in cause.words in repr(score)
    assert hint in cause.hint
    assert evaluate(light(CHECKS), CAMERA, pixel, display=DISPLAY).causes == ()


@pytest.mark.parametrize(
    ("header", "display", "setting"),
    [
        ({"luminance_cd_per_m2": 5.0}, {}, "raise Display(white_cd_per_m2=…) if"),
        ({WHITE_RADIANCE: 5.0}, {}, "raise Display(white_w_per_m2_sr=…) if"),
        ({WHITE_RADIANCE: 5.0}, {"white_cd_per_m2": 5.0}, "raise Display(white_cd_per_m2=…) if"),
        ({DIFFUSER: {}, WHITE_RADIANCE: 5.0}, {}, "in place of Display(white=…) if"),
    ],
)
def test_hint_names_the_setting_that_states_white(
    header: dict, display: dict[str, float], setting: str
) -> None:
    (cause,) = named(lightness=(100.0, 100.0), header=header, display=display)
    assert setting in cause.hint


# --- uninformative frames


FAINT_LIGHT = {"read_noise_e": 10.0, "black_level_dn": 200}


@pytest.mark.parametrize(
    ("fields", "exposure", "reason"),
    [
        ({"dark_current_e_per_s": 1e9}, {"integration_s": 0.01}, "dark charge leaves no code"),
        ({}, {"integration_s": 0.01, "gain_db": 60.0}, "100 % of the pixels are saturated"),
        ({}, {"integration_s": 10.0}, "100 % of the pixels are saturated"),
        ({}, {"integration_s": 5.7e-14}, "only .* codes of the ADC between black and"),
        # 1 e- in noise of 10 e-: a million pixels have an SNR of 100 together.
        (FAINT_LIGHT, {"integration_s": 1.6e-3}, ""),
        (FAINT_LIGHT, {"integration_s": 2e-7}, ""),
    ],
)
@pytest.mark.parametrize("metric", ["delta_e", "information"])
def test_uninformative_frame_is_noted_once(
    fields: dict[str, float], exposure: dict[str, float], reason: str, metric: str
) -> None:
    settings = CAMERA, Pixel(**QUIET | fields), Exposure(**exposure), DISPLAY
    with warnings.catch_warnings(record=True) as notes:
        warnings.simplefilter("always")
        evaluate(light(CHECKS), *settings, metrics=[metric])
    texts = [str(note.message) for note in notes if NOTHING in str(note.message)]
    assert [bool(re.search(f"{NOTHING}: {reason}", text)) for text in texts] == [True] * bool(
        reason
    )


# --- notes


SILICON = {"technology": "4t-bsi", "pitch_um": 5.0, "stack": {"enabled": False}}
WHITE = {"white_w_per_m2_sr": 200.0}


def notes_of(change: dict) -> set[str]:
    """Return the ids of the notes of one evaluation, of light that was rendered with a camera."""
    header = {"camera": CAMERA.model_dump(mode="json")} | change.get("light", {})
    pixel = Pixel.model_validate(SILICON | change.get("pixel", {}))
    display = Display.model_validate({"dots": 32} | change.get("display", WHITE))
    with warnings.catch_warnings(action="ignore"), collected_notes(alone=True) as notes:
        evaluate(
            light(CHECKS, **header),
            change.get("camera", CAMERA),
            pixel,
            change.get("exposure", STEADY),
            display,
        )
    return {note.id for note in notes}


ROWS: list[tuple[str, dict, dict]] = [
    ("unit_slip", {"pixel": {"prnu": 0.2}}, {"pixel": {"prnu": 0.002}}),
    ("other_camera", {"camera": CAMERA.model_copy(update={"f_number": 2.0})}, {"camera": CAMERA}),
    ("assumed", {"display": {}}, {"display": WHITE}),
    (
        "white_clipped",
        {"display": {"white_w_per_m2_sr": 1e-4}},
        {"display": {"white_w_per_m2_sr": 200.0}},
    ),
    (
        "spectral_range",
        {"pixel": {"quantum_efficiency": [[400.0, 0.5], [650.0, 0.5]]}},
        {"pixel": {"quantum_efficiency": [[400.0, 0.5], [650.0, 0.5], [660.0, 0.0]]}},
    ),
    ("cause", {"exposure": Exposure(integration_s=1e4)}, {}),
    (
        "focus",
        {"light": {"depths_m": [0.02, 0.02, 0.02]}},
        {"light": {"depths_m": [0.02, CAMERA.object_distance_m, None]}},
    ),
]


@pytest.mark.parametrize(("kind", "causing", "other"), ROWS, ids=[row[0] for row in ROWS])
def test_settings_cause_their_note(kind: str, causing: dict, other: dict) -> None:
    assert kind in NOTES
    assert [kind in notes_of(change) for change in (causing, other)] == [True, False]


# --- noise budgets


SIDE = 256
SAMPLE_UM = 2.0
TIME_S = 0.02
BUDGET_CAMERA = Camera(die_mm=SIDE * SAMPLE_UM / 1e3)
BUDGET_DISPLAY = Display(dots=64, bits=16, white_cd_per_m2=2e3)
# Sources of like size: rounding by 10 bits is 4 e-.
ALL = {
    "technology": "4t-bsi",
    "pitch_um": 2.0,
    "bits": 10,
    "full_well_e": 14_000.0,
    "black_level_dn": 200,
    "quantum_efficiency": 0.5,
    "read_noise_e": 12.0,
    "row_noise_e": 9.0,
    "dark_current_e_per_s": 9e3,
    "prnu": 0.004,
    "dsnu": 0.15,
    "offset_fpn": 8e-4,
    "column_fpn": 6e-4,
    "stack": {"enabled": False},
}
NOISELESS = {
    **dict.fromkeys(("prnu", "dsnu", "read_noise_e", "row_noise_e"), 0),
    **dict.fromkeys(("dark_current_e_per_s", "offset_fpn", "column_fpn"), 0),
}
Y, X = np.mgrid[:SIDE, :SIDE]
PICTURE = 0.006 * (0.75 + 0.25 * np.sin(X / 5 + Y / 9))[..., None]
LIGHT = SpectralImage(
    [550.0], 10.0, SAMPLE_UM, data=PICTURE, header={"render_noise": {"relative": 0.01}}
)


def budget_of(image: SpectralImage = LIGHT, *, pixel=None, **settings) -> NoiseBudget:
    arguments = {
        "camera": BUDGET_CAMERA,
        "display": BUDGET_DISPLAY,
        "exposure": Exposure(integration_s=TIME_S),
    }
    budget = noise_budget(
        imaging_chain(image, pixel=Pixel(**ALL | (pixel or {})), **arguments | settings),
        image,
        "budget",
        1,
    )
    assert sum(budget.delta_e.values()) + budget.remainder_delta_e == pytest.approx(
        budget.mean_delta_e, abs=1e-12
    )
    return budget


def test_variances_add_up_to_that_of_frames() -> None:
    """All sources at once, of like size, within 2 %: half a standard error of 256 columns and rows
    of 12 sensors.
    """
    chain = imaging_chain(
        LIGHT, BUDGET_CAMERA, Pixel(**ALL), Exposure(integration_s=TIME_S), BUDGET_DISPLAY
    )
    frames = [chain.capture("frames", number) for number in range(12)]
    noise_e = [
        (frame.dn - frame.black_level_dn) / frame.dn_per_e - frame.mean_dark_e - frame.mean_e
        for frame in frames
    ]
    budget = budget_of()
    sources = {source.name for source in noise.SOURCES if source.name != "reset noise"}
    assert {*budget.electrons_e} == {ROUNDING, DARK, SHOT, *sources}
    assert min(budget.electrons_e.values()) > 0.05 * max(budget.electrons_e.values())
    assert budget.total_e**2 == pytest.approx(np.mean(np.square(noise_e)), rel=0.02)
    assert budget.measured_e == pytest.approx(budget.total_e, rel=0.05)
    closed_dn2 = frame_variance_dn2(frames[0].mean_e, TIME_S, chain.readout).mean()
    np.testing.assert_allclose(
        [budget.total_e**2, np.square([*budget.electrons_e.values()]).sum(), budget.render_e**2],
        [*[closed_dn2 / chain.readout.dn_per_e**2] * 2, 1e-4 * np.mean(frames[0].mean_e ** 2)],
        rtol=1e-12,
    )


def test_causes_that_are_not_there_take_off_nothing() -> None:
    """Without noise and diffraction sampling and aperture are left; a veil changes no other cause."""
    quiet = budget_of(
        SpectralImage([550.0], 10.0, SAMPLE_UM, data=PICTURE, header={"diffraction": False}),
        pixel=NOISELESS,
    )
    assert [*quiet.electrons_e] == [ROUNDING, SHOT]
    assert VEIL not in quiet.delta_e
    assert quiet.delta_e[SAMPLING] > 0.01
    np.testing.assert_allclose([quiet.delta_e[LENS], quiet.remainder_delta_e], 0, atol=1e-9)
    blurred = budget_of(pixel=NOISELESS)
    veiled = budget_of(
        pixel=NOISELESS, camera=BUDGET_CAMERA.model_copy(update={"veiling_glare": 0.05})
    )
    assert blurred.delta_e[LENS] > 0.01
    assert veiled.delta_e[VEIL] > 0.1
    others = [
        [budget.delta_e[name] for name in (LENS, SAMPLING, APERTURE)]
        for budget in (veiled, blurred)
    ]
    np.testing.assert_allclose(*others, atol=1e-5)
    fine = budget_of(
        pixel=NOISELESS, display=BUDGET_DISPLAY.model_copy(update={"raster": "one_to_one"})
    )
    assert SAMPLING not in fine.delta_e
    assert fine.remainder_delta_e == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize("pattern", [None, "rggb"])
def test_noise_reduction_has_the_blur_of_the_expected_frame(pattern: str | None) -> None:
    """And leaves mosaic, colour and blur as they are without it. To rounding."""
    colour = {"pattern": pattern, "sensitivities": "Sony_ILCE-7M4", "peak_quantum_efficiency": 0.5}
    image = SpectralImage(
        [450.0, 550.0, 620.0], 60.0, SAMPLE_UM, data=PICTURE * np.array([0.3, 0.4, 0.3])
    )
    fields = {"colour": colour} if pattern else {}
    settings: dict = {"pixel": fields, "exposure": Exposure(integration_s=5e-5)}
    plain = budget_of(image, **settings)
    develop = Develop(denoise="wiener_bound")
    reduced = budget_of(image, develop=develop, **settings)

    chain = imaging_chain(
        image,
        BUDGET_CAMERA,
        Pixel(**ALL | fields),
        settings["exposure"],
        BUDGET_DISPLAY,
        develop=develop,
    )
    mean_delta_e = [
        developing.development.score(noiseless_frame(chain, 5e-5)).mean_delta_e
        for developing in (chain, without_denoising(chain))
    ]
    blur = mean_delta_e[0] - mean_delta_e[1]
    assert blur > 0.05
    assert reduced.delta_e[REDUCTION] == pytest.approx(blur, abs=1e-12)
    others = {name: value for name, value in plain.delta_e.items() if name not in plain.electrons_e}
    assert {name: reduced.delta_e[name] for name in others} == pytest.approx(others, abs=1e-9)


def test_motion_takes_off_what_it_adds() -> None:
    """What a moving picture has more than a still one, on the same part of the scene."""
    still, moving = (
        budget_of(
            pixel=NOISELESS,
            border_um=40.0,
            motion=Motion(image_um_per_s=(speed, 0.0), margin_um=20.0),
        )
        for speed in (0.0, 400.0)
    )
    assert MOTION not in still.delta_e
    assert moving.delta_e[MOTION] > 0.05
    others = {name: value for name, value in still.delta_e.items() if name not in still.electrons_e}
    assert {name: moving.delta_e[name] for name in others} == pytest.approx(others, abs=1e-4)


def test_flicker_is_the_first_cause() -> None:
    """The others are those of the steady exposure."""
    lamp = Exposure(
        integration_s=TIME_S / 8, frames=8, flicker_hz=100.0, flicker_depth=0.9, line_time_us=10,
        shutter="rolling",
    )  # fmt: skip
    budget = budget_of(exposure=lamp)
    steady = budget_of(exposure=lamp.steady)
    assert next(iter(budget.delta_e)) == FLICKER
    assert budget.delta_e == pytest.approx(
        {FLICKER: budget.mean_delta_e - steady.mean_delta_e} | steady.delta_e, abs=1e-12
    )


def test_new_source_has_its_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        noise,
        "SOURCES",
        (*noise.SOURCES, noise.NoiseSource("a new source", lambda _: 30.0, is_temporal=True)),
    )
    budget = budget_of(pixel=NOISELESS)
    assert budget.electrons_e["a new source"] == pytest.approx(30, rel=1e-12)
    assert budget.delta_e["a new source"] > 0


def test_finer_adc_has_the_same_range() -> None:
    readout = Readout.of(derive(Pixel(**ALL))).at(Exposure(gain_db=12.0))
    finer = finer_adc(readout)
    assert finer.adc_range_e == pytest.approx(readout.adc_range_e, rel=2**-9)
    codes = [np.array([adc.dn_per_e, adc.adc.black_level_dn]) for adc in (finer, readout)]
    np.testing.assert_allclose(codes[0] / codes[1], 256, rtol=1e-12)
    assert finer_adc(replace(readout, adc=replace(readout.adc, bits=24))).adc.bits == 31


# --- parts of colour


COLOUR_NM = np.arange(402.5, 700.0, 5.0)
COLOUR_CAMERA = Camera(die_mm=0.1)
FILTERS = {
    k: [[float(x), float(0.5 * np.exp(-(((x - c) / 45) ** 2)))] for x in range(400, 701, 10)]
    for k, c in zip("RGB", (600, 540, 460), strict=True)
}
OBSERVER = {
    k: np.stack([nm, curve / 4], axis=1).tolist()
    for nm in [np.arange(400.0, 701.0)]
    for k, curve in zip("RGB", (colour_matching(nm) / nm[:, None] * 400).T, strict=True)
}


def parts(colour: dict | None, **fields) -> dict[str, float]:
    """Return the parts of waves of two colours."""
    wave = np.sin(X[:64, :64] / 4 + Y[:64, :64] / 9)
    spectra = 0.2 + 0.6 * np.array([COLOUR_NM > 580, COLOUR_NM < 500])
    factor = float(irradiance_factor(4.0, 0.0, COLOUR_CAMERA.magnification))
    weight = luminous_weight(COLOUR_NM, np.full(COLOUR_NM.size, 5.0))
    white = 1e3 * factor * d65(COLOUR_NM) / (weight @ d65(COLOUR_NM))
    image = SpectralImage(
        COLOUR_NM,
        5.0,
        100 / 64,
        factors=(spectra * white, np.array([0.5 + 0.4 * wave, 0.5 - 0.4 * wave], np.float32)),
        header={"lamp_w_per_m2_sr_nm": white.tolist()},
    )
    bare = {"technology": "4t-bsi", "pitch_um": 2.0, "stack": {"enabled": False}, "bits": 16}
    chain = imaging_chain(
        image,
        COLOUR_CAMERA,
        Pixel(**bare | {"colour": colour} | fields),
        display=Display(dots=40, bits=16, white_cd_per_m2=1e3),
        develop=Develop(matrix="least_squares"),
    )
    budget = noise_budget(chain, image, "parts", 1)
    assert sum(budget.parts.values()) == pytest.approx(budget.mean_delta_e, abs=1e-12)
    return budget.parts


def test_each_part_of_colour_has_its_cause() -> None:
    """The observer's channels have no colour error and the same blur; pixels with all channels no
    mosaic; grey ones neither.
    """
    noisy = {"read_noise_e": 100.0}
    whole = parts({"quantum_efficiencies": FILTERS}, **noisy)
    assert min(whole[part] for part in (NOISE, MOSAIC, COLOUR_ERROR, BLUR)) > 0.02
    assert whole[CROSSTALK] == 0.0
    exact = parts({"quantum_efficiencies": OBSERVER}, **noisy)
    assert exact[COLOUR_ERROR] == pytest.approx(0, abs=2e-3)
    assert exact[BLUR] == pytest.approx(whole[BLUR], rel=1e-12)
    layers = parts({"pattern": "stacked", "quantum_efficiencies": FILTERS}, **noisy)
    assert layers[MOSAIC] == pytest.approx(0, abs=1e-6)
    assert layers[COLOUR_ERROR] == pytest.approx(whole[COLOUR_ERROR], rel=1e-9)
    grey = parts(None, quantum_efficiency=0.5, **noisy)
    assert [grey[MOSAIC], grey[CROSSTALK], grey[COLOUR_ERROR]] == [0.0, 0.0, 0.0]


def test_crosstalk_between_colours_is_no_colour_error() -> None:
    """The matrix takes it apart, which sharpens: the part is below 0, and more blur is left."""
    stack = {"height_um": 4.0, "index": 1.5, "microlens": "none"}
    colour = {"quantum_efficiencies": FILTERS}
    alone, mixed = (
        parts(colour, stack=stack | {"crosstalk": c}, **NOISELESS, reset_noise_factor=0)
        for c in (0.0, 0.1)
    )
    assert mixed[COLOUR_ERROR] == pytest.approx(alone[COLOUR_ERROR], rel=0.05)
    assert mixed[MOSAIC] == pytest.approx(alone[MOSAIC], rel=0.1)
    assert mixed[CROSSTALK] < 2 * alone[CROSSTALK] < 0
    assert mixed[BLUR] > alone[BLUR] + 0.01


@pytest.mark.parametrize(
    "colour",
    [{"pattern": "grbg"}, {"pattern": "quad_rggb"}, {"matrix": ["RGB", "GGR", "BRG"]},
     {"pattern": "stacked"}],
    ids=str,
)  # fmt: skip
def test_neighbours_share_what_the_mosaic_collects(colour: dict) -> None:
    """Of uniform light, channel by channel."""
    layout = Layout.unbinned(
        Pixel(technology="4t-bsi", pitch_um=2.0, colour=colour | {"quantum_efficiencies": FILTERS})
    )
    around = neighbours(layout)
    np.testing.assert_allclose(around.sum(axis=1), 1, rtol=1e-12)
    shares = np.random.default_rng(1).uniform(0, 1, (3, 5, 5))
    collection = ColourCollection(
        layout,
        tuple(Collection(kernel[None, None], kernel.sum(), 2.0) for kernel in shares),
        (1.0, 2.0, 3.0),
        2.0,
    )
    np.testing.assert_allclose(
        (around * shares).sum(axis=(2, 3)) * 2.0**2, collection.mixing_um2, rtol=1e-12
    )
