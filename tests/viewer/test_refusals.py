"""Refusals of rules across arguments and fields: a row for each, with the argument and the cause."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from helpers.chains import imaging, imaging_chain

from pixsim import (
    Camera,
    Develop,
    Display,
    Exposure,
    Motion,
    Pixel,
    PixsimError,
    SpectralImage,
    evaluate,
    metrics,
    score_pictures,
)
from pixsim.sensor.camera_data import camera_sensitivities
from pixsim.viewer import (
    adaptation,
    colour_matrix,
    develop,
    display as displays,
    scielab,
    screen,
    shown_metrics,
)
from pixsim.viewer.demosaic import demosaic, demosaic_covariance, remosaic
from pixsim.viewer.denoising import filters, wiener
from pixsim.viewer.denoising.filters import denoised_plane
from pixsim.viewer.metric_options import MetricOptions
from pixsim.viewer.settings_file import run_settings

CAMERA = Camera(die_mm=0.1)
DISPLAY = Display(dots=16, white_cd_per_m2=1000.0)
QUAD = ("RRGG", "RRGG", "GGBB", "GGBB")
D65 = [95.047, 100.0, 108.883]
PLANE = np.full((24, 24), 10.0)
NM, CURVES = camera_sensitivities("Canon_EOS_R5")
VIEW = {"white_xyz": D65, "samples_per_deg": 23.0}
GREY = np.full((4, 6), 0.5)
SHEET = {"technology": "4t-bsi", "pitch_um": 4.0, "stack": {"enabled": False}}


def light(nm=(450.0, 550.0, 620.0), level: float = 1e-3, **header) -> SpectralImage:
    """Return uniform light of few bands."""
    header = {"diffraction": False, **header}
    return SpectralImage(
        np.array(nm), 10.0, 2.0, data=np.full((50, 50, len(nm)), level), header=header
    )


def evaluated(image: SpectralImage | None = None, **settings) -> object:
    arguments = {"camera": CAMERA, "pixel": Pixel(**SHEET), "display": DISPLAY} | settings
    return evaluate(light() if image is None else image, **arguments)


def coloured(pitch_um: float = 4.0, image: SpectralImage | None = None, **fields) -> object:
    """Return the matrix of a colour sensor."""
    colour = {"sensitivities": "Nikon_D5100", "peak_quantum_efficiency": 0.5}
    develop = fields.pop("develop", Develop())
    colour |= fields.pop("colour", {})
    nm = np.arange(405.0, 700.0, 10.0)
    display = DISPLAY.model_copy(update={"raster": "one_to_one"})
    image = light(nm) if image is None else image
    return imaging_chain(
        image,
        CAMERA,
        Pixel(**SHEET | {"pitch_um": pitch_um, "colour": colour} | fields),
        Exposure(),
        display,
        develop=develop,
    ).development.matrix


def lamp(*lines_nm: float) -> SpectralImage:
    nm = np.arange(400.0, 701.0, 5.0)
    factors = [np.isin(nm, lines_nm).astype(float)], np.full((1, 50, 50), 1e-3)
    return SpectralImage(nm, 5.0, 2.0, factors=factors, header={"diffraction": False})


def sized(rows: int, columns: int, pitch_um: float, dots: int = 512) -> object:
    image = SpectralImage(
        [550.0], 10.0, 20.0, data=np.ones((rows, columns, 1)), header={"luminance_cd_per_m2": 1e9}
    )
    return evaluate(
        image, Camera(die_mm=0.02 * columns), Pixel(pitch_um=pitch_um), display=Display(dots=dots)
    )


def overlapping() -> dict:
    """Return filters that overlap almost wholly."""
    nm = np.arange(380.0, 781.0, 10.0)
    bells = {k: 0.5 * np.exp(-(((nm - centre) / 150) ** 2)) for k, centre in
             zip("RGB", (570, 545, 520), strict=True)}  # fmt: skip
    return {name: np.stack([nm, bell], axis=1).tolist() for name, bell in bells.items()}


ROWS: dict[str, tuple[Callable[[], object], str]] = {
    # --- noise
    "patches without noise": (
        lambda: metrics.contrast_detection_probability([10.0], 0.1, [0.0], [0.0]),
        "0 everywhere; allowed: noise in some patch",
    ),
    # --- white
    "no white": (
        lambda: displays.white_cd_per_m2(light(), Display()),
        r"white_cd_per_m2: got no value.*Set Display\(white_cd_per_m2=",
    ),
    "dark picture": (
        lambda: screen.white_header([(imaging(CAMERA, Pixel(**SHEET)), light(level=0.0))]),
        "too dark to estimate it",
    ),
    "luminance of infrared light": (
        lambda: evaluated(light((930.0, 940.0, 950.0))),
        r"state the white as a radiance",
    ),
    "white of light that the sensor does not see": (
        lambda: evaluated(light((365.0, 375.0)), pixel=Pixel(pitch_um=8.0)),
        r"the scene's white: got .*both the sensor and the eye",
    ),
    "faint white": (
        lambda: evaluated(display=Display(), image=light(luminance_cd_per_m2=1e-300)),
        "the scene's white: got",
    ),
    "diffuser without a plate": (
        lambda: evaluated(display=Display(white="diffuser")),
        "display.white: got 'diffuser', but this light does not state",
    ),
    "two whites": (
        lambda: Display(white_cd_per_m2=100.0, white_w_per_m2_sr=4.0),
        "state the same quantity",
    ),
    "grey and coloured sensors": (
        lambda: screen.check_one_ideal(["a"], {"b": np.array([[[0.5, 0.2, 0.5]]])}),
        "sensors: got a without colour filters and b",
    ),
    # --- sizes
    "pixel larger than the die": (lambda: sized(2, 40, 60.0), "pitch_um: got 60; allowed: at most"),
    "pixel that is all border": (lambda: sized(3, 3, 60.0, 8), "leaves none of the 8 dots"),
    "too many dots": (lambda: sized(20_000, 1, 6.5), "display.dots: got 512 .* 5240 million dots"),
    "die without a whole unit cell": (lambda: coloured(60.0), "1 × 1 pixels on the die; allowed"),
    "binned unit cell": (
        lambda: coloured(30.0, colour={"pattern": "quad_rggb", "binning": True}),
        "30, which leaves 1 × 1 pixels on the die after binning of 2 × 2",
    ),
    "motion beyond the margin": (
        lambda: evaluated(
            motion=Motion(image_um_per_s=(1e4, 0.0), margin_um=1.0),
            exposure=Exposure(integration_s=0.01),
        ),
        "motion: got a path of 100 µm .*allowed: at most",
    ),
    "motion of pixels as dots": (
        lambda: evaluated(
            motion=Motion(image_um_per_s=(2e3, 0.0)),
            exposure=Exposure(integration_s=0.01),
            display=DISPLAY.model_copy(update={"raster": "one_to_one"}),
        ),
        "motion: got .*'fixed_size'",
    ),
    "edges that do not increase": (
        lambda: displays.average_axis(np.ones(4), 1.0, 0.0, np.array([0.0, 2.0, 1.0]), 1, 0),
        "edges_um: got",
    ),
    "values without an axis": (
        lambda: displays.average_axis(np.ones(4), 1.0, 0.0, np.arange(3.0), 1, 1),
        "values: got an array of shape .4,.",
    ),
    "shading of another shape": (
        lambda: displays.relative_to_white(np.ones((2, 2)), None, 1.0, np.ones(3)),
        "shading: got an array .3,.",
    ),
    "planes first": (lambda: displays.rgb_to_xyz(np.ones((3, 2))), "rgb, shape"),
    # --- colour
    "lamp of one wavelength": (lambda: coloured(image=lamp(550.0)), "the scene's lamp.*rank 1"),
    "lamp of two wavelengths": (lambda: coloured(image=lamp(450.0, 620.0)), "lamp.*rank 2"),
    "lamp without blue": (lambda: coloured(image=lamp(700.0)), "colour under .* got"),
    "lamp too saturated": (
        lambda: adaptation.adaptation_matrix([1.0985, 1.0, 0.35585], [1e-3, 1.0, 5.0], "bradford"),
        "to_white_xyz: got .*Choose adaptation 'none'",
    ),
    "lamp without luminance": (lambda: colour_matrix.chart_xyz(NM, 0 * NM), "power: got a lamp without"),
    "matrix of much noise": (
        lambda: coloured(colour={"sensitivities": None, "peak_quantum_efficiency": None,
                                 "quantum_efficiencies": overlapping()}),
        "pixels of 4 µm: .*noise gains of .* in R, G, B.*up to 10",
    ),
    "gains above 10": (lambda: colour_matrix.check_noise_gains(2000 * np.eye(3), D65), "gains up to 10"),
    "colours that mix": (lambda: coloured(0.5, **{"stack": {"height_um": 3.0, "index": 1.5, "microlens": "square"}}), "larger pixels mix the channels less"),
    "gains of other channels": (
        lambda: coloured(develop=Develop(white_balance=(1.0, 2.0))),
        "white_balance: got 2 gains for 3 channels",
    ),
    "sensitivities from 420 nm": (lambda: colour_matrix.colour_matrix(NM[8:], CURVES[8:]), "at least 400 to 700"),
    "gap of sensitivities": (
        lambda: colour_matrix.colour_matrix(np.delete(NM, slice(30, 36)), np.delete(CURVES, slice(30, 36), 0)),
        "a gap from 525 to 560 nm",
    ),
    "falling wavelengths": (lambda: colour_matrix.colour_matrix(NM[::-1], CURVES[::-1]), "increasing order"),
    "channels first": (lambda: colour_matrix.colour_matrix(NM, CURVES.T), r"allowed: \(81, channels\)"),
    "two channels": (lambda: colour_matrix.colour_matrix(NM, CURVES[:, :2]), "three channels or more"),
    "channel without response": (
        lambda: colour_matrix.colour_matrix(NM, CURVES * [1, 0, 1]),
        r"no response of channel \[1\]",
    ),
    "no response": (lambda: colour_matrix.colour_matrix(NM, 0 * CURVES), "0 everywhere"),
    "two equal channels": (lambda: colour_matrix.colour_matrix(NM, CURVES[:, [0, 1, 1]]), "D55: .*of rank 2"),
    # --- demosaicing
    "Bayer method of another pattern": (
        lambda: demosaic(np.ones((8, 8)), QUAD, "bilinear"),
        "method: got 'bilinear' for the pattern",
    ),
    "setting of the method": (
        lambda: coloured(colour={"pattern": "quad_rggb"}, develop=Develop(demosaic="bilinear")),
        "develop.demosaic: got 'bilinear' for the unit cell",
    ),
    "method of stacked channels": (
        lambda: coloured(colour={"pattern": "stacked"}, develop=Develop(demosaic="malvar2004")),
        "'malvar2004' for stacked channels",
    ),
    "unknown pattern": (lambda: demosaic(np.ones((8, 8)), "RGGB"), "Did you mean 'rggb'"),
    "rows of other lengths": (
        lambda: demosaic(np.ones((8, 8)), ["RG", "GBB"], "interpolate"),
        "rows of equal length",
    ),
    "mosaic below the unit cell": (
        lambda: demosaic(np.ones((4, 3)), QUAD, "interpolate"),
        "unit cell of 4 × 4",
    ),
    "mosaic with a NaN": (
        lambda: demosaic(np.where(np.eye(4) > 0, math.nan, 1.0), "rggb"),
        "got 4 values that are not finite",
    ),
    "sums that overflow": (lambda: demosaic(np.full((4, 4), -1e301), "rggb"), "too large"),
    "remosaic of a Bayer pattern": (lambda: remosaic(np.ones((8, 8)), "rggb"), "2 × 2 equal"),
    "covariance of a method that is not linear": (
        lambda: demosaic_covariance("rggb", "menon2007", np.ones(3)),
        "method: got 'menon2007'; allowed: a linear method",
    ),
    # --- denoising
    "plane below a patch": (lambda: denoised_plane(PLANE[:16], 1.0, "nlm"), "allowed: 17 pixels"),
    "plane below a wavelet": (lambda: denoised_plane(PLANE[:7], 1.0, "wavelet"), "allowed: 8"),
    "function of another shape": (
        lambda: denoised_plane(PLANE, 1.0, lambda plane, _: plane[1:]),
        r"of shape \(23, 24\)",
    ),
    "function of infinity": (
        lambda: denoised_plane(PLANE, 1.0, lambda plane, _: plane * np.inf),
        "returns inf at",
    ),
    "powers of other shapes": (lambda: wiener.response(PLANE, PLANE[1:]), "signal and noise: got"),
    "unknown denoiser": (lambda: Develop(denoise="bm3d"), "denoise.*can be set in Python only"),
    "sharpening too wide": (
        lambda: evaluated(develop=Develop(sharpen_amount=1, sharpen_radius_cy_per_deg=1e-3)),
        "sharpen_radius_cy_per_deg: got .*up to 100 pixels",
    ),
    "two radii": (
        lambda: Develop(sharpen_amount=1.0, sharpen_radius_px=1.0, sharpen_radius_cy_per_deg=3.0),
        "state the same quantity",
    ),
    "falling tone curve": (
        lambda: Develop(tone_curve=[[0, 0], [0.5, 0.7], [1, 0.6]]),
        "brighter stays brighter",
    ),
    "tone curve of codes": (lambda: Develop(tone_curve=[[0, 0], [1, 255]]), "Divide values of"),
    "level tone curve": (lambda: Develop(tone_curve=[[0, 0.5], [1, 0.5]]), "increasing values"),
    "tone curve of one row": (lambda: Develop(tone_curve=[[0, 0.5]]), "of 1 rows; allowed: 2 to"),
    "tone curve of numbers": (lambda: Develop(tone_curve=3), "neither a name, nor a file"),
    "tone curve without a file": (lambda: Develop(tone_curve="linear"), "does not exist"),
    # --- S-CIELAB
    "images of other shapes": (
        lambda: scielab.delta_e_map(np.ones((4, 5, 3)), np.ones((5, 4, 3)), **VIEW),
        r"reference_xyz and test_xyz.*\(4, 5, 3\).*\(5, 4, 3\)",
    ),
    "reference of another shape": (
        lambda: scielab.grey_delta_e_map(np.zeros((2, 3, 3)), np.zeros((3, 2)), **VIEW),
        r"reference_lab, shape: got \(2, 3, 3\); allowed: \(3, 2, 3\)",
    ),
    "white of one number": (
        lambda: scielab.xyz_to_lab(np.ones(3), np.ones(2)),
        "white_xyz: got .*three numbers",
    ),
    "image of two axes": (lambda: scielab.filtered_lab(np.ones((4, 3)), **VIEW), "xyz, shape"),
    "luminance of three axes": (
        lambda: scielab.filtered_grey_lab(np.ones((2, 2, 3)), **VIEW),
        r"luminance: got shape .*\(H, W\)",
    ),
    "density of 1996": (
        lambda: scielab.filtered_lab(
            np.ones((6, 4, 3)), white_xyz=D65, samples_per_deg=1e9, filters="zhang1996"
        ),
        r"samples_per_deg: got .*1e-06 to 1e\+06 for 'zhang1996'",
    ),
    "channels that are nearly dependent": (
        lambda: colour_matrix.fit_matrix(np.diag([3.0, 3.0, 2.7e-6]), np.eye(3), np.ones(3), "least_squares"),
        "responses: got 3 channels of rank 2",
    ),
    "channels that are nearly dependent under a lamp": (
        lambda: develop.check_separable(np.diag([3.0, 3.0, 2.7e-6]), "D65"),
        "colour under D65: got channels of rank 2",
    ),
    "unknown interpolation": (
        lambda: displays.interpolation_mtf(10.0, 6.5, "sinc"),
        "interpolation: got 'sinc'; allowed: nearest, linear, cubic",
    ),
    # --- metrics
    "axis that does not reach Nyquist": (
        lambda: metrics.information_bits_per_mm2(np.linspace(1.0, 100.0, 5), 1.0, 1.0),
        "frequency_cy_per_mm: got 5 from 1 to 100",
    ),
    "axis that misses Nyquist by 1.5e-6 of a cell": (
        lambda: metrics.information_bits_per_mm2(np.array([-1.0, 0.0, 1 + 1.5e-6]), 1.0, 1.0),
        "frequency_cy_per_mm: got 3 from -1 to 1",
    ),
    "spectrum of another shape": (
        lambda: metrics.information_bits_per_mm2(np.linspace(0, 100.0, 5), np.ones(5), 1.0),
        r"signal: got an array of shape \(5,\); allowed: \(5, 5\)",
    ),
    "picture of few cells": (
        lambda: metrics.radial_spectrum(np.ones((7, 20)), 5.0),
        "picture: got .*8 cells or more",
    ),
    "variance of another shape": (
        lambda: metrics.detectability(np.ones((3, 4)), np.ones((4, 3))),
        r"variance: got an array of shape \(4, 3\)",
    ),
    "slopes of another shape": (
        lambda: metrics.detectability(np.ones((3, 4)), np.array(1.0), offset_slopes=np.ones((3, 4))),
        r"offset_slopes: got .*two of the shape of difference, \(2, 3, 4\)",
    ),
    "noise power of another shape": (
        lambda: metrics.npwe(np.ones((3, 4)), np.ones((4, 3)), 30.0),
        "noise_power: got",
    ),
    "falling frequencies": (
        lambda: metrics.mtf50(np.array([0.0, 2.0, 1.0]), np.ones(3)),
        "got 3 numbers from 0; allowed: increasing",
    ),
    "curve of another shape": (
        lambda: metrics.acutance(np.array([0.0, 1.0]), np.ones(3)),
        "and mtf: got shapes",
    ),
    "edge without a step": (lambda: metrics.edge_mtf(np.ones((8, 8)), 5.0, 0.1), "got no step"),
    "patch of two planes": (
        lambda: metrics.visual_noise(np.ones((4, 4, 2)), 30.0),
        "picture: got an array of shape",
    ),
    "surfaces that are equal": (
        lambda: MetricOptions(niirs={"reflectances": (0.1, 0.1)}),
        "niirs: reflectances.*equal",
    ),
    "metric with a typing error": (
        lambda: evaluated(metrics=["detectabilty"]),
        "Did you mean 'detectability'",
    ),
    "metric twice": (lambda: evaluated(metrics=["delta_e", "delta_e"]), "'delta_e' twice"),
    "no metric": (lambda: evaluated(metrics=[]), "metrics: got none"),
    "lambda as metric": (lambda: evaluated(metrics=[lambda score: 1.0]), "not a lambda"),
    "background of other samples": (
        lambda: evaluated(
            metrics=["detectability"],
            without=SpectralImage([550.0], 10.0, 4.0, data=np.ones((25, 25, 1))),
        ),
        "without: got 25 × 25 samples of 4 µm",
    ),
    "negative background": (
        lambda: evaluated(metrics=["detectability"], without=light(level=-1.0)),
        "negative",
    ),
    # --- pictures of other programs
    "pictures of other shapes": (
        lambda: score_pictures(GREY, GREY[:3]),
        r"shapes \(4, 6\) and \(3, 6\)",
    ),
    "grey and colour": (
        lambda: score_pictures(GREY, np.repeat(GREY[..., None], 3, axis=2)),
        "equal shapes. Grey light is",
    ),
    "picture of one axis": (
        lambda: score_pictures(GREY[0], GREY[0]),
        r"ideal: got an array of shape \(6,\)",
    ),
    "picture of codes": (
        lambda: score_pictures(GREY, np.full((4, 6), 128, np.uint8)),
        "image: got whole numbers up to 128, which are codes",
    ),
    "metric of a frame": (
        lambda: score_pictures(GREY, GREY, metrics=["acutance"]),
        "'acutance'; allowed: the frame of a sensor",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", ROWS)
@pytest.mark.filterwarnings("ignore")
def test_refusals_name_the_argument_and_the_cause(name: str) -> None:
    call, words = ROWS[name]
    with pytest.raises(PixsimError, match=words):
        call()


@pytest.mark.parametrize("value", [math.nan, math.inf, "a", None, True, np.ones(3)], ids=str)
def test_metric_of_a_user_is_one_finite_number(value) -> None:
    def wrong(score):
        return value

    with pytest.raises(PixsimError, match="one finite number"):
        evaluated(metrics=[wrong])


@pytest.mark.parametrize(
    ("module", "call", "words"),
    [
        (
            filters,
            lambda: denoised_plane(PLANE, 1.0, "wavelet"),
            r"needs scikit-image.*pip install 'pixsim\[denoise\]'",
        ),
        (
            shown_metrics,
            lambda: score_pictures(GREY, GREY, metrics=["flip"]),
            r"pip install 'pixsim\[flip\]'",
        ),
    ],
)
def test_missing_package_is_named(
    monkeypatch: pytest.MonkeyPatch, module, call: Callable[[], object], words: str
) -> None:
    monkeypatch.setattr(module, "find_spec", lambda name: None)
    with pytest.raises(PixsimError, match=words):
        call()


def test_files_name_no_function(tmp_path) -> None:
    """Code comes from Python only."""
    (tmp_path / "own.toml").write_text('[develop]\ndenoise = "shutil:rmtree"\n')
    with pytest.raises(PixsimError, match=r"own.toml.*got .shutil:rmtree.*in Python only"):
        run_settings(tmp_path / "own.toml", {})
