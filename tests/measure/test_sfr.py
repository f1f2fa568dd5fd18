"""e-SFR of edges whose MTF is known in closed form, and errors for invalid pictures and files."""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from helpers.commands import assert_refused, command
from helpers.looks import Elements
from PIL import Image
from scipy.special import erf

from pixsim import PixsimError, edge_response, sfr, write_frame
from pixsim.light.exr import write_channels
from pixsim.measure.sfr import NYQUIST_CY_PER_PX, read_edge_picture
from pixsim.report.sfr import sfr_document, sfr_parts
from pixsim.sensor.colour import Layout
from pixsim.sensor.raw import RawFrame
from pixsim.show.render import text
from pixsim.viewer.metric_kernels.sharpness import first_crossing

SIDE = 320
DARK, LIGHT = 100.0, 1000.0
TOLERANCE = 3e-4  # error of finite bins on noiseless edges


def distances(
    angle_deg: float, height: int = SIDE, width: int = SIDE, shift: float = 0.2
) -> np.ndarray:
    """Signed distances of the pixel centres from an edge `angle_deg` clockwise from the
    vertical.
    """
    y, x = np.mgrid[:height, :width]
    angle = np.radians(angle_deg)
    return (x - (width - 1) / 2 - shift) * np.cos(angle) + (y - (height - 1) / 2) * np.sin(angle)


def gaussian_edge(angle_deg: float = 5.0, sigma_px: float = 0.6, **size: int) -> np.ndarray:
    """An edge with the MTF exp(-2 π² σ² f²)."""
    return DARK + (LIGHT - DARK) * (1 + erf(distances(angle_deg, **size) / (sigma_px * 2**0.5))) / 2


def gaussian_mtf(frequency: np.ndarray, sigma_px: float = 0.6) -> np.ndarray:
    return np.exp(-2 * (np.pi * sigma_px * frequency) ** 2)


def below_nyquist(picture: np.ndarray, **how: object) -> tuple[np.ndarray, np.ndarray]:
    edge = edge_response(picture, **how)
    below = edge.frequency_cy_per_px <= NYQUIST_CY_PER_PX
    return edge.frequency_cy_per_px[below], edge.sfr[below]


@pytest.mark.parametrize("angle_deg", [5.0, -5.0, 2.5, 8.0, 12.0, 95.0, 85.0, 185.0, -85.0, 101.0])
def test_edge_response_gaussian_edge_matches_mtf(angle_deg: float) -> None:
    edge = edge_response(gaussian_edge(angle_deg))
    below = edge.frequency_cy_per_px <= NYQUIST_CY_PER_PX
    assert np.abs(edge.sfr - gaussian_mtf(edge.frequency_cy_per_px))[below].max() < TOLERANCE
    assert edge.angle_deg == pytest.approx((angle_deg + 45) % 180 - 45, abs=1e-3)


@pytest.mark.parametrize("angle_deg", [5.0, 95.0])
def test_edge_response_square_pixel_matches_sinc(angle_deg: float) -> None:
    """Exact cell means of a step, with the MTF sinc(f cos θ) sinc(f sin θ)."""
    cos, sin = abs(np.cos(np.radians(angle_deg))), abs(np.sin(np.radians(angle_deg)))

    def ramp(u: np.ndarray) -> np.ndarray:
        return np.maximum(u, 0.0) ** 2 / 2

    d, wide, narrow = distances(angle_deg), (cos + sin) / 2, abs(cos - sin) / 2
    cover = (ramp(d + wide) - ramp(d + narrow) - ramp(d - narrow) + ramp(d - wide)) / (cos * sin)
    frequency, sfr = below_nyquist(DARK + (LIGHT - DARK) * cover)
    assert (
        np.abs(sfr - np.sinc(frequency * cos) * np.sinc(frequency * sin)).max() < 0.002
    )  # a little aliasing


def test_edge_response_wide_tails_need_wide_window() -> None:
    """LSF a/π/(a² + x²) with 1/x² tails, MTF exp(-2π a f): the error falls as the window widens."""
    a = 0.2
    picture = DARK + (LIGHT - DARK) * (0.5 + np.arctan(distances(5.0) / a) / np.pi)
    curves = [below_nyquist(picture, half_window_px=half_px) for half_px in (20, 48, 96)]
    errors = [np.abs(sfr - np.exp(-2 * np.pi * a * frequency)).max() for frequency, sfr in curves]
    assert errors[0] > 0.008
    assert errors[1] < 0.005
    assert errors[0] > 2 * errors[1] > 2 * errors[2]


def test_edge_response_offset_and_gain_do_not_change_sfr() -> None:
    one, other = edge_response(gaussian_edge()), edge_response(3 * gaussian_edge() + 500)
    assert np.allclose(one.sfr, other.sfr, atol=1e-12)
    assert one.contrast == pytest.approx((LIGHT - DARK) / (LIGHT + DARK), rel=1e-6)


def test_edge_response_region_gives_properties() -> None:
    edge = edge_response(gaussian_edge(), region=(60, 40, 260, 280))
    assert edge.half_window_px == 64
    assert edge.mtf50_cy_per_px == pytest.approx(np.sqrt(np.log(2) / 2) / np.pi / 0.6, abs=3e-4)
    assert edge.at_nyquist == pytest.approx(gaussian_mtf(np.array(0.5)), abs=3e-4)
    assert edge.frequency_cy_per_mm(5.0)[-1] == pytest.approx(200.0)
    assert edge_response(gaussian_edge(height=100, width=60)).half_window_px < 30


def test_first_crossing_interpolates_or_is_none() -> None:
    frequency = np.array([0.0, 1.0, 2.0])
    assert first_crossing(frequency, np.array([1.0, 0.6, 0.2]), 0.5) == pytest.approx(1.25)
    assert first_crossing(frequency, np.array([1.0, 0.9, 0.8]), 0.5) is None


INVALID = {
    "contrast": np.full((64, 64), 100.0) + np.random.default_rng(1).standard_normal((64, 64)),
    "step of": (
        DARK
        + 30 * (distances(5.0, 64, 64) > 0)
        + 40 * np.random.default_rng(1).standard_normal((64, 64))
    ),
    "from the rows or columns": gaussian_edge(0.0),
    "columns, over": gaussian_edge(90.4),
    "at least 24 a side": gaussian_edge()[:20],
    "one channel of numbers": np.zeros((64, 64, 3)),
    "largest value of .*e-3": 1e-310 * gaussian_edge(),
    "largest value of .*e[+]30": 1e300 * gaussian_edge(),
    "NaN or infinite": np.where(distances(5.0) > 150, np.nan, gaussian_edge()),
    "of a polynomial of degree 5": (
        DARK + 900.0 * (distances(5.0) > 4 * np.sign(np.sin(np.arange(SIDE)[:, None] / 20)))
    ),
    "an edge in 189 of 320 lines": (
        DARK + 900.0 * (distances(5.0) > 6 * np.sign(np.sin(np.arange(SIDE)[:, None] / 20)))
    ),
    "bins without a pixel": gaussian_edge(45.0),
    "on either side": gaussian_edge(5.0)[:, 160 - 5 : 160 + 200][:, :60],
}


@pytest.mark.parametrize("message", INVALID)
def test_edge_response_invalid_edge_raises(message: str) -> None:
    with pytest.raises(PixsimError, match=message):
        edge_response(INVALID[message])


def test_edge_response_saturated_or_outside_region_raises() -> None:
    with pytest.raises(PixsimError, match="saturated"):
        edge_response(gaussian_edge(), saturation=999.0)
    edge_response(gaussian_edge(), saturation=1023.0)
    with pytest.raises(PixsimError, match="within 0,0,320,320"):
        edge_response(gaussian_edge(), region=(0, 0, 321, 100))


CASES = Path(__file__).parents[1] / "data/cases/sfr"
AT_NYQUIST, MTF50 = 0.109, 0.2808  # of the pictures in CASES
TRUE_MTF50 = float(np.sqrt(np.log(2) / 2) / np.pi / 0.6)
GAINS = {"R": 0.6, "G": 1.0, "B": 0.4, "W": 1.6}


def mosaic(layout: str, edge: np.ndarray) -> np.ndarray:
    cell = Layout.parse(layout)
    return edge * np.array([GAINS[letter] for letter in cell.channels])[cell.numbers(edge.shape)]


@pytest.mark.parametrize(
    ("layout", "channel", "nyquist", "tolerance"),
    [
        ("RG/GB", "R", 0.25, 0.001), ("RG/GB", "G", 0.5, 0.001), ("RG/GB", "B", 0.25, 0.001), ("RG/GB", "luminance", 0.25, 0.001),
        ("GR/BG", "0,1", 0.25, 0.001), ("RW/WB", "W", 0.5, 0.001),
        # clusters of four pixels: replicas at a quarter and at three eighths
        ("RRGG/RRGG/GGBB/GGBB", "G", 0.25, 0.003),
    ],
)  # fmt: skip
@pytest.mark.parametrize("angle_deg", [5.0, -94.0])
def test_channel_of_a_mosaic_has_the_mtf_in_pixels_of_the_sensor(
    layout: str, channel: str, nyquist: float, tolerance: float, angle_deg: float
) -> None:
    """Each channel sees the same edge: its curve is that of all pixels, up to 0.5 cy/px, with bins
    of up to its own pixel.
    """
    edge = edge_response(mosaic(layout, gaussian_edge(angle_deg)), layout=layout, channel=channel)
    below = edge.frequency_cy_per_px <= NYQUIST_CY_PER_PX
    assert below.sum() > 50
    assert np.abs(edge.sfr[below] - gaussian_mtf(edge.frequency_cy_per_px[below])).max() < tolerance
    assert (edge.channel, edge.nyquist_cy_per_px) == (channel, nyquist)
    assert edge.angle_deg == pytest.approx((angle_deg + 45) % 180 - 45, abs=5e-3)


def test_channel_in_a_region_is_that_of_the_frame() -> None:
    """Letters are counted from the frame's corner, not from the region's."""
    picture = mosaic("RG/GB", gaussian_edge())
    picture[0::2, 0::2] = np.random.default_rng(3).uniform(1, 2, (160, 160))  # no edge in red
    edge = edge_response(picture, layout="RG/GB", channel="B", region=(41, 33, 281, 300))
    assert edge.mtf50_cy_per_px == pytest.approx(TRUE_MTF50, abs=1e-3)


def test_luminance_weighs_channels_that_see_other_edges() -> None:
    """Lateral colour: red and blue are shifted along the normal by ±1 px, after white balance: Σ w
    exp(-2πi f d).
    """
    shift = {"R": 1.0, "G": 0.0, "B": -1.0}
    letters = np.array(list("RGGB")).reshape(2, 2)
    picture = np.zeros((SIDE, SIDE))
    for row, column in np.ndindex(2, 2):
        away = distances(5.0)[row::2, column::2] - shift[letters[row, column]]
        picture[row::2, column::2] = GAINS[letters[row, column]] * (
            DARK + (LIGHT - DARK) * (1 + erf(away / (0.6 * 2**0.5))) / 2
        )
    edge = edge_response(picture, layout="RG/GB", channel="luminance")
    frequency = edge.frequency_cy_per_px[edge.frequency_cy_per_px <= 0.5]
    weights = {"R": 0.2126, "G": 0.7152, "B": 0.0722}
    wanted = abs(
        sum(weights[one] * np.exp(-2j * np.pi * frequency * shift[one]) for one in "RGB")
    ) * gaussian_mtf(frequency)
    np.testing.assert_allclose(edge.sfr[: frequency.size], wanted, atol=0.002)
    assert np.abs(wanted - gaussian_mtf(frequency)).max() > 0.05


def test_stacked_sensor_measures_a_plane() -> None:
    sigmas = {"R": 0.5, "G": 0.6, "B": 0.9}
    picture = np.concatenate(
        [GAINS[letter] * gaussian_edge(sigma_px=sigma) for letter, sigma in sigmas.items()]
    )
    edge = edge_response(picture, layout="R+G+B", channel="G")
    assert edge.mtf50_cy_per_px == pytest.approx(TRUE_MTF50, abs=3e-4)
    with pytest.raises(PixsimError, match=r"one channel\. As in --channel R"):
        edge_response(picture, layout="R+G+B")


@pytest.mark.parametrize("suffix", [".exr", ".tiff", ".png", ".npz"])
def test_frame_of_a_colour_sensor_is_measured_by_its_layout(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"raw{suffix}"
    write_frame(
        path, RawFrame(np.rint(10 * mosaic("GR/BG", gaussian_edge())), layout=Layout.parse("GR/BG"))
    )
    with pytest.raises(PixsimError, match="one channel"):
        sfr(path)
    result = sfr(path, channel="R").as_dict()
    assert result["mtf50_cy_per_px"] == pytest.approx(TRUE_MTF50, abs=1e-3)
    assert result["channel_nyquist_cy_per_px"] == 0.25


@pytest.mark.parametrize(
    ("file", "channel", "layout", "warned"),
    [
        ("ex1.0.png", None, None, 0), ("mosaic_tagged.tif", "G", None, 0), ("mosaic_tagged.tif", "R", None, 0),
        ("mild.tif", "1,1", None, 0), ("mild.tif", "luminance", "RG/GB", 0), ("mild.tif", "G", None, 1),
        ("rgb16.tif", None, None, 0), ("rgb16.tif", "B", None, 0),
    ],
)  # fmt: skip
def test_pictures_of_other_programs_are_measured(
    file: str, channel: str | None, layout: str | None, warned: int
) -> None:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        result = sfr(CASES / file, channel=channel, layout=layout).as_dict()
    assert result["mtf50_cy_per_px"] == pytest.approx(MTF50, abs=1.5e-3)
    assert result["sfr_at_nyquist"] == pytest.approx(AT_NYQUIST, abs=2e-3)
    assert len(result["notes"]) == warned == len(caught)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("ex1.6.png", "exactly 4095 above black, beside noise"),
        ("ex1.6.png --saturation 4095", "49.9 % saturated"),
        ("mild.tif", "looks like a colour mosaic"),
        ("mild.tif --channel R", "--layout RG/GB"),
        ("mild.tif --channel 2,0", "from 0,0 to 1,1"),
        ("mild.tif --channel G --layout rggb", "capital letters"),
        ("mosaic_tagged.tif", "As in --channel G"),
        ("mosaic_tagged.tif --channel X", "R, G, B, luminance"),
        ("rgb16.tif --channel 0,1", "R, G, B, luminance"),
        ("rgb16.tif --layout RG/GB", "a mosaic"),
        ("ex1.0.png --black 5000 --saturation 4095", "more than it"),
    ],
)
def test_pictures_that_would_mislead_are_refused_by_their_cause(
    line: str, message: str, tmp_path: Path
) -> None:
    assert_refused(*command(f"sfr {CASES}/{line} --out {tmp_path}/o"), [message])


@pytest.mark.parametrize(
    "layout", ["RG/GB", "RRGG/RRGG/GGBB/GGBB", "GBGGRG/RGRBGB/GBGGRG/GRGGBG/BGBRGR/GRGGBG"]
)
def test_mosaic_without_a_layout_is_named(layout: str) -> None:
    noise = np.random.default_rng(4).standard_normal((SIDE, SIDE))
    with pytest.raises(PixsimError, match="looks like a colour mosaic"):
        edge_response(mosaic(layout, gaussian_edge()) + 5 * noise)
    edge_response(gaussian_edge() + 50 * noise)  # noise is no mosaic


def curved_edge(bow: Callable[[np.ndarray], np.ndarray], side: int = SIDE) -> np.ndarray:
    """An edge at 5° with the MTF of `gaussian_edge`, whose rows are shifted by a bow (px).

    bow : of the place along the edge, -1 to 1

    Distances are those to the nearest point of the edge, by Newton's method.
    """
    y, x = np.mgrid[:side, :side].astype(float)
    centre, slope = (side - 1) / 2, np.tan(np.radians(5.0))

    def edge(row: np.ndarray) -> np.ndarray:
        place = (row - centre) / centre
        return np.asarray(centre - slope * (row - centre) + bow(place))

    foot = y.copy()
    for _ in range(25):
        tangent = (edge(foot + 1e-3) - edge(foot - 1e-3)) / 2e-3
        foot -= 0.7 * ((foot - y) + (edge(foot) - x) * tangent) / (1 + tangent**2)
    distance = np.sign(x - edge(y)) * np.hypot(foot - y, edge(foot) - x)
    return np.asarray(DARK + (LIGHT - DARK) * (1 + erf(distance / (0.6 * 2**0.5))) / 2)


BOWS: dict[str, tuple[Callable[[np.ndarray], np.ndarray], int]] = {
    "parabola 1.5 px": (lambda place: 1.5 * place**2, 2), "parabola 5 px": (lambda place: 5 * place**2, 2),
    "parabola 28 px": (lambda place: 28 * place**2, 2), "S": (lambda place: 3 * place**3, 3),
    "bent ends": (lambda place: 3 * place**4, 4), "bent ends of an S": (lambda place: 3 * place**5, 5),
}  # fmt: skip


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("name", BOWS)
@pytest.mark.parametrize("turned", [False, True])
def test_curved_edge_has_the_mtf_of_a_straight_one(name: str, turned: bool) -> None:
    """As distortion bends it. A straight line has MTF50s of 0.254 and 0.119 cy/px at 1.5 and 5 px,
    for 0.312.
    """
    bow, degree = BOWS[name]
    picture = curved_edge(bow)
    edge = edge_response(picture.T if turned else picture)
    below = edge.frequency_cy_per_px <= NYQUIST_CY_PER_PX
    assert np.abs(edge.sfr - gaussian_mtf(edge.frequency_cy_per_px))[below].max() < 1e-3
    assert edge.edge_degree == degree
    rows = np.linspace(-1, 1, SIDE)[(SIDE - edge.rows_used) // 2 :][: edge.rows_used]
    chord = np.interp(rows, rows[[0, -1]], bow(rows[[0, -1]]))
    assert edge.edge_sagitta_px == pytest.approx(np.abs(bow(rows) - chord).max(), rel=0.03)
    assert (
        f"(bowed by {edge.edge_sagitta_px:.2g} px, degree {degree})" in sfr_parts(edge.as_dict())[1]
    )


def test_curved_edge_in_a_mosaic_has_the_mtf_of_all_pixels() -> None:
    picture = mosaic("RG/GB", curved_edge(BOWS["parabola 5 px"][0]))
    for channel in ("R", "G", "luminance"):
        edge = edge_response(picture, layout="RG/GB", channel=channel)
        assert edge.mtf50_cy_per_px == pytest.approx(TRUE_MTF50, abs=1e-3), channel


@pytest.mark.filterwarnings("ignore:edge picture")
def test_interval_of_a_curved_edge_holds_the_truth() -> None:
    """95 % of 40 pictures: 33 and less are 3.6 σ of a binomial number below. The seeds are
    fixed.
    """
    picture, hits = curved_edge(BOWS["parabola 1.5 px"][0], side=120), 0
    for seed in range(40):
        edge = edge_response(
            picture + 10 * np.random.default_rng([12, seed]).standard_normal(picture.shape)
        )
        low, high = edge.mtf50_interval_cy_per_px
        hits += low is not None and high is not None and low <= TRUE_MTF50 <= high
    assert hits > 33


@pytest.mark.filterwarnings("ignore:edge picture")
def test_noise_of_a_straight_edge_is_no_curve() -> None:
    """1 in 1000 by chance (3 of 3000 others were): 2 of 120 are 1 in 150. The seeds are fixed."""
    rng = np.random.default_rng(5)
    picture = gaussian_edge(height=100, width=100)
    degrees = [
        edge_response(picture + noise * rng.standard_normal(picture.shape)).edge_degree
        for noise in (1, 10, 30) * 40
    ]
    assert sum(degree > 1 for degree in degrees) < 2


PIXEL_NOISE = np.random.default_rng(9).standard_normal((SIDE, SIDE))
UNEVEN = {
    "waves": curved_edge(lambda place: 0.5 * np.sin(20 * place)),
    "a kink": curved_edge(lambda place: 6 * np.abs(place)),
    "shifted rows": (
        DARK
        + 450
        * (1 + erf((distances(5.0) + 0.3 * (-1.0) ** np.arange(SIDE)[:, None]) / (0.6 * 2**0.5)))
    ),
}


@pytest.mark.parametrize("name", UNEVEN)
@pytest.mark.parametrize("noise_dn", [0.0, 5.0])
def test_edge_that_is_no_polynomial_is_named(name: str, noise_dn: float) -> None:
    with pytest.warns(UserWarning, match="is no polynomial of degree"):
        edge_response(UNEVEN[name] + noise_dn * PIXEL_NOISE)


@pytest.mark.filterwarnings("error:edge picture. the edge is no polynomial")
@pytest.mark.parametrize("noise_dn", [0.0, 5.0, 50.0])
@pytest.mark.parametrize("sigma_px", [0.01, 0.3, 3.0])
def test_sampling_and_noise_are_no_misfit(noise_dn: float, sigma_px: float) -> None:
    """A hard edge is 0.29 px (RMS) from its pixels, in each row at another place."""
    edge_response(gaussian_edge(sigma_px=sigma_px) + noise_dn * PIXEL_NOISE)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("below", [0.004, 0.0])
def test_dark_side_below_black_is_measured(below: float) -> None:
    """As dark subtraction leaves it in floating point; an offset changes no MTF."""
    picture = ((gaussian_edge() - DARK) / (LIGHT - DARK) - below + 0.003 * PIXEL_NOISE).astype(
        np.float32
    )
    edge = edge_response(picture)
    assert edge.mtf50_cy_per_px == pytest.approx(TRUE_MTF50, abs=2e-3)
    assert edge.mtf50_cy_per_px == pytest.approx(
        edge_response(picture + 0.2).mtf50_cy_per_px, abs=1e-5
    )
    assert 0.999 < edge.contrast <= 1.0


def test_dark_side_far_below_black_is_named() -> None:
    with pytest.warns(
        UserWarning, match=r"below black by 10\.0 % of the step: the black level is too high"
    ):
        assert edge_response(gaussian_edge() - DARK - 90).contrast == 1.0


@pytest.mark.parametrize("noise_dn", [0.5, 1.0, 8.0])
@pytest.mark.parametrize("clip_dn", [0.0, 1.0])
def test_clipping_shows_in_the_noise(noise_dn: float, clip_dn: float) -> None:
    """Clipped at the level of the bright side, or a little above it; without clipping the same
    picture is measured.
    """
    picture = np.rint(gaussian_edge() + noise_dn * PIXEL_NOISE)
    edge_response(picture)
    clipped = np.minimum(picture, LIGHT + clip_dn * noise_dn - (noise_dn < 1))
    with pytest.raises(PixsimError, match="this is clipped"):
        edge_response(clipped)
    with pytest.warns(UserWarning, match="as if it were clipped"):
        edge_response(clipped, is_unclipped=True)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("noise_dn", [0.0, 0.1, 0.2, 0.35, 0.6, 1.0, 3.0])
@pytest.mark.parametrize("level", [0.0, 0.3, 0.5])
def test_few_codes_of_noise_are_no_clipping(noise_dn: float, level: float) -> None:
    """Noise of less than a code can leave all pixels of a side in one, whatever the level."""
    edge_response(np.rint(gaussian_edge() + level + noise_dn * PIXEL_NOISE))


PLATEAUS = {"float 1.0": 1.0, "float 0.8": 0.8, "float 250": 250.0, "8 bits": 255.0}


def edge_of_levels(name: str, share: float, is_dark: bool) -> np.ndarray:
    """An edge without noise that ends at a share of its step: of floats, or of whole codes."""
    top = PLATEAUS[name]
    edge = top * np.minimum((gaussian_edge() - DARK) / (LIGHT - DARK) / share, 1.0)
    levels = np.rint(edge) if "bits" in name else edge.astype(np.float32)
    return np.asarray(top - levels[:, ::-1] if is_dark else levels)


@pytest.mark.parametrize("name", PLATEAUS)
@pytest.mark.parametrize("share", [0.95, 0.6])
@pytest.mark.parametrize("is_dark", [False, True])
def test_clipping_without_noise_shows_by_its_kink(name: str, share: float, is_dark: bool) -> None:
    """At 95 and 60 % of the step, where the MTF50 is 10 and 62 % too high."""
    picture = edge_of_levels(name, share, is_dark)
    side = "dark" if is_dark else "bright"
    with pytest.raises(
        PixsimError, match=f"a {side} side at exactly .* an edge that is clipped on neither side"
    ):
        edge_response(picture)
    with pytest.warns(UserWarning, match=f"a {side} side at exactly .* as if it were clipped"):
        edge_response(picture, is_unclipped=True)


@pytest.mark.parametrize("channel", ["R", "G", "luminance"])
def test_clipping_of_a_mosaic_without_noise_shows_by_its_kink(channel: str) -> None:
    picture = mosaic("RG/GB", np.minimum(gaussian_edge(), 0.7 * LIGHT))
    with pytest.raises(PixsimError, match="an edge that is clipped on neither side"):
        edge_response(picture, layout="RG/GB", channel=channel)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("name", PLATEAUS)
@pytest.mark.parametrize("is_dark", [False, True])
def test_edge_without_noise_is_not_clipped(name: str, is_dark: bool) -> None:
    assert edge_response(edge_of_levels(name, 1.0, is_dark)).mtf50_cy_per_px == pytest.approx(
        TRUE_MTF50, abs=1e-3
    )


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("angle_deg", [3.0, 12.0, 95.0])
def test_asymmetric_blur_is_no_clipping(angle_deg: float) -> None:
    """As of coma: an exponential tail on one side only, in a pixel of one pitch and a Gaussian of
    0.3 px.
    """
    x = np.linspace(-20, 20, 8001)
    line = np.convolve(np.where(x >= 0, np.exp(-x), 0.0), np.exp(-(x**2) / (2 * 0.3**2)), "same")
    line = np.convolve(line, np.abs(x) <= 0.5, "same")
    edge_response(
        DARK + (LIGHT - DARK) * np.interp(distances(angle_deg), x, np.cumsum(line) / line.sum())
    )


@pytest.mark.parametrize(
    "picture",
    [np.clip(gaussian_edge(), 300, 800), DARK + 900 * np.clip(distances(5.0) + 0.5, 0, 1)],
)
def test_edge_with_two_kinks_is_named(picture: np.ndarray) -> None:
    """Clipped at both sides, or blurred by a pixel alone."""
    with pytest.warns(UserWarning, match="a kink at both sides"):
        edge_response(picture)


def test_clipping_at_black_is_warned_of() -> None:
    with pytest.warns(UserWarning, match="clipped at black"):
        edge_response(np.maximum(np.rint(gaussian_edge() - DARK + 8 * PIXEL_NOISE), 0.0))


def coverage(noise: float, side: int, draws: int) -> tuple[int, np.ndarray]:
    """How often the interval holds the MTF50, and at how many frequencies that of the curve holds
    the MTF.
    """
    rng = np.random.default_rng([11, side])
    hits, inside = 0, []
    for _ in range(draws):
        edge = gaussian_edge(rng.uniform(4, 6), height=side, width=side)
        result = edge_response(
            edge + noise * np.sqrt(edge * LIGHT) * rng.standard_normal(edge.shape)
        )
        low, high = result.mtf50_interval_cy_per_px
        hits += (low is None or low <= TRUE_MTF50) and (high is None or high >= TRUE_MTF50)
        truth = gaussian_mtf(result.frequency_cy_per_px)
        inside.append(
            ((result.sfr_interval[0] <= truth) & (truth <= result.sfr_interval[1]))[1:].mean()
        )
    return hits, np.array(inside)


@pytest.mark.filterwarnings("ignore:edge picture")
def test_intervals_hold_the_truth_as_often_as_they_state() -> None:
    """95 % of 160 pictures of 64 × 64 pixels, 1 to 10 % of noise: 89 to 98.5 % are 3.5 σ of a
    binomial number below and 2 above.

    Seeds are fixed. An interval that holds 84 % is found in 95 of 100 such tests.
    """
    results = [coverage(noise, 64, 40) for noise in (0.005, 0.02, 0.06, 0.12)]
    assert 0.89 <= sum(hits for hits, _ in results) / 160 <= 0.985
    for _, inside in results:
        assert 0.93 <= inside.mean() <= 0.97


@pytest.mark.filterwarnings("ignore:edge picture")
def test_interval_narrows_with_the_root_of_the_pixels() -> None:
    def width(height: int) -> float:
        picture = gaussian_edge(height=height) + 10 * np.random.default_rng(2).standard_normal(
            (height, SIDE)
        )
        edge = edge_response(picture)
        return float(np.diff(edge.sfr_interval, axis=0)[0, 5:40].mean())

    assert width(160) / width(640) == pytest.approx(2.0, rel=0.1)


@pytest.mark.filterwarnings("ignore:edge picture")
def test_curve_above_one_is_named() -> None:
    """Each of the three causes; the pictures may have others besides."""
    sharp = gaussian_edge()
    sharp = sharp + 1.5 * (sharp - gaussian_edge(sigma_px=1.2))
    with pytest.warns(UserWarning, match="sharpened, or noise: the SFR is"):
        assert edge_response(sharp).sfr.max() > 1.1
    shaded = gaussian_edge() * (1 + 0.2 * distances(5.0) / SIDE)
    with pytest.warns(UserWarning, match="shading: beside the edge"):
        edge_response(shaded)
    with pytest.warns(UserWarning, match="noise or shading: the SFR is"):
        edge_response(gaussian_edge() - 0.3 * DARK * np.clip(distances(5.0) / 64, -1, 1) * 5)


@pytest.mark.filterwarnings("error")
def test_tails_of_a_lens_are_no_shading() -> None:
    """Line spread with 1/x² tails, as of diffraction, with and without noise."""
    picture = DARK + (LIGHT - DARK) * (0.5 + np.arctan(distances(5.0) / 0.4) / np.pi)
    edge_response(picture)
    edge_response(picture + 5 * PIXEL_NOISE)


def test_correlated_noise_is_named() -> None:
    smooth = (PIXEL_NOISE + np.roll(PIXEL_NOISE, 1, axis=1)) * 10
    with pytest.warns(UserWarning, match="correlated"):
        edge_response(gaussian_edge() + smooth)


def test_read_edge_picture_all_formats_agree(tmp_path: Path) -> None:
    edge = np.rint(gaussian_edge())
    header = {"unit": "DN", "bits": 10, "black_level_dn": 20.0, "pitch_um": 5.3}
    write_channels(tmp_path / "raw.exr", {"DN": edge}, header)
    np.save(tmp_path / "edge.npy", edge.astype(np.uint16))
    np.savez(tmp_path / "edge.npz", edge)
    Image.fromarray(edge.astype(np.uint16)).save(tmp_path / "edge.png")
    Image.fromarray(edge.astype(np.float32)).save(tmp_path / "edge.tif")
    for name in ("raw.exr", "edge.npy", "edge.npz", "edge.png", "edge.tif"):
        assert np.array_equal(read_edge_picture(tmp_path / name).data, edge)
    raw = read_edge_picture(tmp_path / "raw.exr")
    assert (raw.pitch_um, raw.black_level_dn, raw.top) == (5.3, 20.0, 1023.0)
    assert read_edge_picture(tmp_path / "edge.png").top == 65535
    assert read_edge_picture(tmp_path / "edge.tif").top is None


def test_sfr_command_writes_files(tmp_path: Path) -> None:
    write_channels(
        tmp_path / "raw.exr",
        {"DN": np.rint(gaussian_edge())},
        {"bits": 10, "black_level_dn": 20.0, "pitch_um": 5.0},
    )
    region = (60, 40, 260, 280)
    code, out, err = command(
        f"sfr {tmp_path}/raw.exr --region {','.join(map(str, region))} --out {tmp_path}/o --json"
    )
    assert (code, err) == (0, "")
    result = json.loads(out)
    assert result == json.loads((tmp_path / "o/summary.json").read_text(encoding="utf-8"))
    assert result["mtf50_cy_per_mm"] == pytest.approx(200 * result["mtf50_cy_per_px"])
    page = Elements((tmp_path / "o/report.html").read_text(encoding="utf-8"))
    assert sfr_parts(result)[0] in "".join(page.words)
    assert page.tags.count("img") == 2
    assert {path.name for path in (tmp_path / "o").iterdir()} == {
        "sfr.csv", "sfr.svg", "edge_spread.csv", "edge_spread.svg", "summary.json", "pixsim.json", "report.html"
    }  # fmt: skip
    first = (tmp_path / "o/sfr.csv").read_text(encoding="utf-8").splitlines()
    assert first[0] == "frequency_cy_per_px,sfr,sfr_low,sfr_high,frequency_cy_per_mm"
    assert float(first[1].split(",")[1]) == 1.0
    edge = sfr(tmp_path / "raw.exr", region=region)
    assert edge.write(tmp_path / "python") == tmp_path / "python/report.html"
    for path in {*(tmp_path / "o").iterdir()} - {
        tmp_path / "o/pixsim.json"
    }:  # which has times of files
        assert (tmp_path / "python" / path.name).read_bytes() == path.read_bytes(), path.name
    assert edge.to_csv().encode() == (tmp_path / "o/sfr.csv").read_bytes()
    assert repr(edge).startswith(f"<EdgeResponse MTF50 {edge.mtf50_cy_per_px:.3f} cy/px")
    assert f"contrast {edge.contrast:.2f}" in edge._repr_html_()
    assert text(sfr_document(edge)).startswith("MTF50 0.31")
    assert edge.mtf50_cy_per_px != sfr(tmp_path / "raw.exr").mtf50_cy_per_px
    other = sfr(tmp_path / "raw.exr", region=region, pitch_um=2.5, black=30.0, saturation=1100.0)
    assert other.contrast > edge.contrast, "of a higher black level"
    assert other.as_dict()["nyquist_cy_per_mm"] == 200.0


def test_sfr_summary_without_pitch_has_no_millimetres() -> None:
    result = edge_response(gaussian_edge(sigma_px=0.1)).as_dict()
    assert "mtf50_cy_per_mm" not in result
    assert "above 1 cy/px" in sfr_parts(result)[0]


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("sfr none.exr", "does not exist"),
        ("sfr edge.jpg", ".png"),
        ("sfr two.npz", "a single array"),
        ("sfr grey8.png", "linear in light"),
        ("sfr text.npy", "readable"),
        ("sfr text.png", "readable"),
        ("sfr rgb.exr", "one: digital numbers"),
        ("sfr edge.npy --region 1,2,3", "x0,y0,x1,y1"),
        ("sfr edge.npy --pitch-um -1", "above 0"),
        ("sfr edge.npy --black-level-dn 2000", "black level is right"),
    ],
)
def test_sfr_command_invalid_file_raises(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, line: str, message: str
) -> None:
    monkeypatch.chdir(tmp_path)
    edge = gaussian_edge()
    np.save("edge.npy", edge)
    np.savez("two.npz", a=edge, b=edge)
    Image.fromarray(np.zeros((64, 64), np.uint8)).save("grey8.png")
    for name in ("text.npy", "text.png"):
        Path(name).write_text("not a picture", encoding="utf-8")
    write_channels("rgb.exr", {"R": edge, "G": edge}, {})
    assert_refused(*command(line), [message])
    assert not Path("pixsim-out").exists()
