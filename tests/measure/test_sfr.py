"""e-SFR of edges whose MTF is known in closed form, and of pictures of other programs."""

import json
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from helpers.claims import check
from helpers.commands import assert_refused, command, output_of
from helpers.edges import (
    DARK,
    GAINS,
    LIGHT,
    PIXEL_NOISE,
    SIDE,
    SIGMA_PX,
    blurred,
    distances,
    gaussian_edge,
    gaussian_mtf,
    mosaic,
)
from PIL import Image

from pixsim import PixsimError, edge_response, sfr, write_frame
from pixsim.light.exr import write_channels
from pixsim.measure.sfr import NYQUIST_CY_PER_PX, EdgeResponse, read_edge_picture
from pixsim.sensor.colour import Layout
from pixsim.sensor.raw import RawFrame

CASES = Path(__file__).parents[1] / "data/cases/sfr"
TRUE_MTF50 = float(np.sqrt(np.log(2) / 2) / np.pi / SIGMA_PX)


def check_mtf(edge: EdgeResponse, mtf: Callable[[np.ndarray], np.ndarray], atol: float) -> None:
    """Check the SFR up to the Nyquist frequency of all pixels."""
    below = edge.frequency_cy_per_px <= NYQUIST_CY_PER_PX
    assert below.sum() > 15
    wanted = mtf(edge.frequency_cy_per_px[below])
    check("SFR", edge.sfr[below], wanted, atol=atol, why="finite bins")


# Closed forms


def step(level: np.ndarray) -> np.ndarray:
    return DARK + (LIGHT - DARK) * level


@pytest.mark.parametrize("angle_deg", [5.0, 95.0])
def test_square_pixel_has_its_sinc(angle_deg: float) -> None:
    """Exact cell means of a step, with the MTF sinc(f cos θ) sinc(f sin θ); a little aliasing."""
    cos = abs(np.cos(np.radians(angle_deg)))
    sin = abs(np.sin(np.radians(angle_deg)))
    corners = np.array([cos + sin, cos - sin, sin - cos, -cos - sin]) / 2
    ramps = np.maximum(distances(angle_deg)[..., None] + corners, 0.0) ** 2 / 2
    edge = edge_response(step(ramps @ [1, -1, -1, 1] / (cos * sin)))
    check_mtf(edge, lambda f: np.sinc(f * cos) * np.sinc(f * sin), 0.002)


def test_wide_tails_need_a_wide_window() -> None:
    """LSF a/π/(a² + x²) with 1/x² tails, MTF exp(-2π a f): the error falls as the window widens."""
    picture = step(0.5 + np.arctan(distances(5.0) / 0.2) / np.pi)
    errors = []
    for half_px in (20, 48, 96):
        edge = edge_response(picture, half_window_px=half_px)
        error = np.abs(edge.sfr - np.exp(-0.4 * np.pi * edge.frequency_cy_per_px))
        errors.append(error[edge.frequency_cy_per_px <= NYQUIST_CY_PER_PX].max())
    assert errors[0] > 0.008 > 0.005 > errors[1], errors
    assert errors[0] > 2 * errors[1] > 2 * errors[2], errors


def test_offset_gain_and_region_do_not_change_the_sfr() -> None:
    edge = edge_response(gaussian_edge())
    check(
        "gain", edge_response(3 * gaussian_edge() + 500).sfr, edge.sfr, atol=1e-12, why="rounding"
    )
    check("contrast", edge.contrast, (LIGHT - DARK) / (LIGHT + DARK), rtol=1e-6, why="tails")
    part = edge_response(gaussian_edge(), region=(60, 40, 260, 280))
    numbers = [part.mtf50_cy_per_px, part.at_nyquist]
    wanted = [TRUE_MTF50, float(gaussian_mtf(np.array(0.5)))]
    check("MTF50 and SFR at Nyquist's", numbers, wanted, atol=3e-4, why="finite bins")
    check("cy/mm", part.frequency_cy_per_mm(5.0)[-1], 200.0, rtol=1e-12, why="1/5 µm")
    assert part.half_window_px == 64
    assert edge_response(gaussian_edge(height=100, width=60)).half_window_px < 30


# Mosaics


# layout, channel, Nyquist frequency, tolerance of the SFR, angles
EDGES = [
    (None, None, 0.5, 3e-4, (5.0, -5.0, 2.5, 12.0, 95.0, 185.0, -85.0, 101.0)),
    ("RG/GB", "R", 0.25, 0.001, (5.0, -94.0)),
    ("RG/GB", "G", 0.5, 0.001, (5.0, -94.0)),
    ("RG/GB", "luminance", 0.25, 0.001, (5.0, -94.0)),
    ("GR/BG", "0,1", 0.25, 0.001, (5.0, -94.0)),
    ("RW/WB", "W", 0.5, 0.001, (5.0, -94.0)),
    # Clusters of four pixels: replicas at a quarter and at three eighths.
    ("RRGG/RRGG/GGBB/GGBB", "G", 0.25, 0.003, (5.0, -94.0)),
]


@pytest.mark.parametrize(
    ("layout", "channel", "nyquist", "tolerance", "angle_deg"),
    [(*row, angle_deg) for *row, angles_deg in EDGES for angle_deg in angles_deg],
)
def test_gaussian_edge_has_its_mtf_in_pixels_of_the_sensor(
    layout, channel, nyquist, tolerance, angle_deg
) -> None:
    picture = gaussian_edge(angle_deg)
    if layout:
        picture = mosaic(layout, picture)
    edge = edge_response(picture, layout=layout, channel=channel)
    check_mtf(edge, gaussian_mtf, tolerance)
    assert (edge.channel, edge.nyquist_cy_per_px) == (channel, nyquist)
    stated_deg = (angle_deg + 45) % 180 - 45
    check("angle", edge.angle_deg, stated_deg, atol=5e-3 if layout else 1e-3, why="fewer pixels")


def test_channel_in_a_region_is_that_of_the_frame() -> None:
    """Letters are counted from the frame's corner; red has no edge."""
    picture = mosaic("RG/GB", gaussian_edge())
    picture[0::2, 0::2] = np.random.default_rng(3).uniform(1, 2, (160, 160))
    edge = edge_response(picture, layout="RG/GB", channel="B", region=(41, 33, 281, 300))
    check("MTF50", edge.mtf50_cy_per_px, TRUE_MTF50, atol=1e-3, why="fewer pixels")


def test_luminance_weighs_channels_that_see_other_edges() -> None:
    """Lateral colour of ±1 px along the normal, after white balance: Σ w exp(-2πi f d)."""
    shifts = {"R": 1.0, "G": 0.0, "B": -1.0}
    picture = np.zeros((SIDE, SIDE))
    for letter, (row, column) in zip("RGGB", np.ndindex(2, 2), strict=True):
        part = np.s_[row::2, column::2]
        picture[part] = GAINS[letter] * blurred(distances(5.0)[part] - shifts[letter])
    edge = edge_response(picture, layout="RG/GB", channel="luminance")

    def mtf(frequency: np.ndarray) -> np.ndarray:
        phases = np.exp(-2j * np.pi * frequency * np.array([[1.0], [0.0], [-1.0]]))
        return abs(np.array([0.2126, 0.7152, 0.0722]) @ phases) * gaussian_mtf(frequency)

    check_mtf(edge, mtf, 0.002)


@pytest.mark.parametrize("suffix", [".exr", ".tiff", ".png", ".npz"])
def test_frame_of_a_colour_sensor_is_measured_by_its_layout(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"raw{suffix}"
    dn = np.rint(10 * mosaic("GR/BG", gaussian_edge()))
    write_frame(path, RawFrame(dn, layout=Layout.parse("GR/BG")))
    edge = sfr(path, channel="R")
    check("MTF50", edge.mtf50_cy_per_px, TRUE_MTF50, atol=1e-3, why="fewer pixels")
    assert edge.nyquist_cy_per_px == 0.25


@pytest.mark.parametrize(
    ("file", "channel", "layout", "note_count"),
    [
        ("ex1.0.png", None, None, 0),
        ("mosaic_tagged.tif", "G", None, 0),
        ("mosaic_tagged.tif", "R", None, 0),
        ("mild.tif", "1,1", None, 0),
        ("mild.tif", "luminance", "RG/GB", 0),
        ("mild.tif", "G", None, 1),
        ("rgb16.tif", None, None, 0),
        ("rgb16.tif", "B", None, 0),
    ],
)
def test_pictures_of_other_programs_are_measured(file, channel, layout, note_count) -> None:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        edge = sfr(CASES / file, channel=channel, layout=layout)
    check("MTF50", edge.mtf50_cy_per_px, 0.2808, atol=1.5e-3, why="its digits and noise")
    check("Nyquist", edge.at_nyquist, 0.109, atol=2e-3, why="its digits and noise")
    assert len(edge.notes) == note_count == len(caught)


# Curved edges


def curved_edge(bow: Callable[[np.ndarray], np.ndarray], side: int = SIDE) -> np.ndarray:
    """Return an edge at 5° with the MTF of `gaussian_edge`, whose rows are shifted by a bow (px).

    bow : of the place along the edge, -1 to 1

    Distances are those to the nearest point of the edge, by Newton's method.
    """
    y, x = np.mgrid[:side, :side].astype(float)
    centre = (side - 1) / 2

    def edge_px(row: np.ndarray) -> np.ndarray:
        return centre - np.tan(np.radians(5.0)) * (row - centre) + bow((row - centre) / centre)

    foot = y.copy()
    for _ in range(12):  # each leaves a third of the error
        tangent = (edge_px(foot + 1e-3) - edge_px(foot - 1e-3)) / 2e-3
        foot -= 0.7 * ((foot - y) + (edge_px(foot) - x) * tangent) / (1 + tangent**2)
    return blurred(np.sign(x - edge_px(y)) * np.hypot(foot - y, edge_px(foot) - x))


BOWS: dict[str, tuple[Callable[[np.ndarray], np.ndarray], int]] = {
    "parabola 1.5 px": (lambda place: 1.5 * place**2, 2),
    "parabola 28 px": (lambda place: 28 * place**2, 2),
    "S": (lambda place: 3 * place**3, 3),
    "bent ends": (lambda place: 3 * place**4, 4),
    "bent ends of an S": (lambda place: 3 * place**5, 5),
}


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("name", BOWS)
def test_curved_edge_has_the_mtf_of_a_straight_one(name: str) -> None:
    """Upright and turned, and behind a mosaic. A straight line has an MTF50 of 0.254 cy/px at
    1.5 px, for 0.312.
    """
    bow, degree = BOWS[name]
    picture = curved_edge(bow)
    for edge in (edge_response(picture), edge_response(picture.T)):
        check_mtf(edge, gaussian_mtf, 1e-3)
        assert edge.edge_degree == degree
        rows = np.linspace(-1, 1, SIDE)[(SIDE - edge.rows_used) // 2 :][: edge.rows_used]
        sagitta_px = np.abs(bow(rows) - np.interp(rows, rows[[0, -1]], bow(rows[[0, -1]]))).max()
        check("sagitta", edge.edge_sagitta_px, sagitta_px, rtol=0.03, why="the slant")
    if degree == 2:
        green = edge_response(mosaic("RG/GB", picture), layout="RG/GB", channel="G")
        check("MTF50", green.mtf50_cy_per_px, TRUE_MTF50, atol=1e-3, why="fewer pixels")


# Statistics


def noise(*key: int, side: int) -> np.ndarray:
    return np.random.default_rng(list(key)).standard_normal((side, side))


@pytest.mark.filterwarnings("ignore:edge picture")
def test_noise_of_a_straight_edge_is_no_curve() -> None:
    """1 in 1000 by chance: 2 of 60 are 1 in 600. A test at 1 in 20 is found in 80 of 100 tests."""
    picture = gaussian_edge(height=64, width=64)
    degrees = [
        edge_response(picture + (1, 10, 30)[seed % 3] * noise(5, seed, side=64)).edge_degree
        for seed in range(60)
    ]
    assert sum(degree > 1 for degree in degrees) < 2


@pytest.mark.filterwarnings("ignore:edge picture")
# A straight edge has the claim; a curved one takes twice as long.
@pytest.mark.parametrize("kind", ["straight", pytest.param("curved", marks=pytest.mark.slow)])
def test_intervals_hold_the_truth_as_often_as_they_state(kind: str) -> None:
    """95 % of 80 pictures of 0.5 to 12 % of noise: 69 and less are 3.6 σ of a binomial number
    below, once in 4000. An interval that holds 80 % is found in 90 of 100 such tests.
    """
    rng = np.random.default_rng(11)
    hits = []
    inside = []
    for seed in range(80):
        edge = gaussian_edge(rng.uniform(4, 6), height=48, width=48)
        if kind == "curved":
            edge = curved_edge(BOWS["parabola 1.5 px"][0], side=96)
        sigma = (0.005, 0.02, 0.06, 0.12)[seed % 4] * np.sqrt(edge * LIGHT)
        result = edge_response(edge + sigma * noise(12, seed, side=len(edge)))
        low, high = result.mtf50_interval_cy_per_px
        hits.append((low or 0.0) <= TRUE_MTF50 <= (high or np.inf))
        truth = gaussian_mtf(result.frequency_cy_per_px)
        holds = (result.sfr_interval[0] <= truth) & (truth <= result.sfr_interval[1])
        inside.append(holds[1:].mean())
    assert 69 < sum(hits) <= 80
    check("of the curve", np.mean(inside), 0.95, atol=0.025, why="3 σ of 80 curves")


# Warnings: each picture has one, or none

SMALL = 224  # pixels, for pictures of which the message counts
PLACE = distances(5.0, SMALL, SMALL)
EDGE = blurred(PLACE)
NOISE = PIXEL_NOISE[:SMALL, :SMALL]


def edge_of_levels(top: float, share: float, is_dark: bool) -> np.ndarray:
    """Return an edge without noise that ends at a share of its step: of floats, or of codes."""
    edge = top * np.minimum((EDGE - DARK) / (LIGHT - DARK) / share, 1.0)
    levels = np.rint(edge) if top == 255.0 else edge.astype(np.float32)
    return np.asarray(top - levels[:, ::-1] if is_dark else levels)


def coma(angle_deg: float) -> np.ndarray:
    """Return an edge with an exponential tail on one side, in a pixel and a Gaussian of 0.3 px."""
    x = np.linspace(-20, 20, 8001)
    line = np.convolve(np.where(x >= 0, np.exp(-x), 0.0), np.exp(-(x**2) / 0.18), "same")
    line = np.convolve(line, np.abs(x) <= 0.5, "same")
    return step(np.interp(distances(angle_deg, SMALL, SMALL), x, np.cumsum(line) / line.sum()))


ALTERNATE = 0.3 * (-1.0) ** np.arange(SMALL)[:, None]
TAILS = step(0.5 + np.arctan(PLACE / 0.4) / np.pi)
NOTES: dict[str, tuple[Callable[[], np.ndarray], str]] = {
    "sharpened": (lambda: EDGE + 1.5 * (EDGE - blurred(PLACE, 1.2)), "sharpened, or noise: the SFR is"),
    "shaded": (lambda: EDGE * (1 + 0.2 * PLACE / SMALL), "shading: beside the edge"),
    "shaded on one side": (lambda: EDGE - 1.5 * DARK * np.clip(PLACE / 64, -1, 1), "noise or shading: the SFR is"),
    "correlated": (lambda: EDGE + (NOISE + np.roll(NOISE, 1, axis=1)) * 10, "correlated"),
    "waves": (lambda: curved_edge(lambda place: 0.5 * np.sin(20 * place), SMALL), "follow a polynomial of degree"),
    "a bend": (lambda: curved_edge(lambda place: 6 * np.abs(place), SMALL), "follow a polynomial of degree"),
    **{
        f"shifted rows, {dn} codes of noise": (lambda dn=dn: blurred(PLACE + ALTERNATE) + dn * NOISE, "follow a polynomial of degree")
        for dn in (0, 5)
    },
    "far below black": (lambda: EDGE - DARK - 90, "below black by 10.0 % of the step"),
    "clipped at both sides": (lambda: np.clip(EDGE, 300, 800), "a kink on both sides"),
    "a pixel alone": (lambda: step(np.clip(PLACE + 0.5, 0, 1)), "a kink on both sides"),
    "clipped at black": (lambda: np.maximum(np.rint(EDGE - DARK + 8 * NOISE), 0.0), "clipped at black"),
    **{f"tails of a lens, {dn} codes of noise": (lambda dn=dn: TAILS + dn * NOISE, "") for dn in (0, 5)},
    "below black": (lambda: ((EDGE - DARK) / (LIGHT - DARK) + 0.003 * NOISE).astype(np.float32) - np.float32(0.004), ""),
    **{f"a hard edge, noise {dn}": (lambda dn=dn: blurred(PLACE, 0.3) + dn * NOISE, "") for dn in (0, 5)},
    **{f"coma at {deg:g}°": (lambda deg=deg: coma(deg), "") for deg in (3.0, 12.0, 95.0)},
    **{
        f"{dn} codes of noise at {level}": (lambda dn=dn, level=level: np.rint(EDGE + level + dn * NOISE), "")
        for dn, level in ((0.0, 0.0), (0.0, 0.5), (0.2, 0.0), (0.2, 0.5), (0.35, 0.3), (0.35, 0.5), (0.6, 0.0), (3.0, 0.3))
    },
    **{
        f"no clipping at {top:g}, dark {is_dark}": (lambda top=top, is_dark=is_dark: edge_of_levels(top, 1.0, is_dark), "")
        for top, is_dark in ((1.0, False), (0.8, True), (250.0, False), (255.0, False), (255.0, True))
    },
}  # fmt: skip


@pytest.mark.parametrize("name", NOTES)
def test_pictures_that_mislead_are_noted(name: str) -> None:
    picture, words = NOTES[name]
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        edge = edge_response(picture())
    messages = [str(warning.message) for warning in caught]
    assert any(words in message for message in messages) if words else not messages, messages
    if name.startswith(("no clipping", "below")):
        check("MTF50", edge.mtf50_cy_per_px, TRUE_MTF50, atol=2e-3, why="noise, codes")
        assert 0.999 < edge.contrast <= 1.0


CLIPPED: dict[str, tuple[Callable[[], np.ndarray], str]] = {
    **{
        f"{dn} codes of noise, {above} above": (
            lambda dn=dn, above=above: np.minimum(np.rint(EDGE + dn * NOISE), LIGHT + above * dn - (dn < 1)),
            "a side without noise is clipped",
        )
        for dn, above in ((0.5, 0.0), (1.0, 1.0), (8.0, 0.0), (8.0, 1.0))
    },
    **{
        f"without noise at {share:g} of {top:g}, dark {is_dark}": (
            lambda top=top, share=share, is_dark=is_dark: edge_of_levels(top, share, is_dark),
            f"a {'dark' if is_dark else 'bright'} side at exactly",
        )
        for top, share, is_dark in (
            (1.0, 0.95, False), (0.8, 0.6, True), (0.8, 0.95, True), (250.0, 0.6, False),
            (255.0, 0.95, False), (255.0, 0.95, True), (255.0, 0.6, True),
        )
    },
}  # fmt: skip


@pytest.mark.parametrize("name", CLIPPED)
def test_clipping_shows_in_the_noise_or_by_a_kink(name: str) -> None:
    """At 95 and 60 % of the step the MTF50 is 10 and 62 % too high."""
    picture, words = CLIPPED[name]
    with pytest.raises(PixsimError, match=words):
        edge_response(picture())
    with pytest.warns(UserWarning, match="as if it were clipped"):
        edge_response(picture(), is_unclipped=True)


# Files


def test_pictures_of_all_formats_agree(tmp_path: Path) -> None:
    edge = np.rint(gaussian_edge())
    header = {"unit": "DN", "bits": 10, "black_level_dn": 20.0, "pitch_um": 5.3}
    write_channels(tmp_path / "raw.exr", {"DN": edge}, header)
    np.save(tmp_path / "edge.npy", edge.astype(np.uint16))
    np.savez(tmp_path / "edge.npz", edge)
    Image.fromarray(edge.astype(np.uint16)).save(tmp_path / "edge.png")
    Image.fromarray(edge.astype(np.float32)).save(tmp_path / "edge.tif")
    names = ["raw.exr", "edge.npy", "edge.npz", "edge.png", "edge.tif"]
    raw, *pictures = (read_edge_picture(tmp_path / name) for name in names)
    assert all(np.array_equal(picture.data, edge) for picture in (raw, *pictures))
    assert [picture.top for picture in pictures] == [None, None, 65535.0, None]
    assert (raw.top, raw.pitch_um, raw.black_level_dn) == (1023.0, 5.3, 20.0)


def test_python_and_the_command_write_same_files(tmp_path: Path) -> None:
    path = tmp_path / "raw.exr"
    header = {"bits": 10, "black_level_dn": 20.0, "pitch_um": 5.0}
    write_channels(path, {"DN": np.rint(gaussian_edge())}, header)
    out = output_of(f"sfr {path} --region 60,40,260,280 --out {tmp_path}/o --json")
    edge = sfr(path, region=(60, 40, 260, 280))
    assert edge.mtf50_cy_per_px != sfr(path).mtf50_cy_per_px
    summary = json.loads(out)
    assert summary == json.loads((tmp_path / "o/summary.json").read_text())
    check("cy/mm", summary["mtf50_cy_per_mm"], 200 * edge.mtf50_cy_per_px, rtol=1e-9, why="5 µm")
    edge.write(tmp_path / "python")
    for file in {*(tmp_path / "o").iterdir()} - {tmp_path / "o/pixsim.json"}:
        assert (tmp_path / "python" / file.name).read_bytes() == file.read_bytes(), file.name
    other = sfr(path, region=(60, 40, 260, 280), pitch_um=2.5, black=30.0, saturation=1100.0)
    assert other.contrast > edge.contrast, "of a higher black level"
    assert other.as_dict()["nyquist_cy_per_mm"] == 200.0
    assert "mtf50_cy_per_mm" not in edge_response(gaussian_edge()).as_dict()


# What is refused

WAVES = np.sign(np.sin(np.arange(SIDE)[:, None] / 20))
RGB = np.concatenate([gaussian_edge()] * 3)
REFUSED: list[tuple[str, Callable[[], object], str]] = [
    ("contrast", lambda: edge_response(100 + PIXEL_NOISE[:64, :64]), "contrast"),
    ("noisy step", lambda: edge_response(DARK + 30 * (distances(5.0, 64, 64) > 0) + 40 * PIXEL_NOISE[:64, :64]), "step of"),
    ("upright", lambda: edge_response(gaussian_edge(0.0)), "from the rows or columns"),
    ("along rows", lambda: edge_response(gaussian_edge(90.4)), "columns, over"),
    ("small", lambda: edge_response(gaussian_edge()[:20]), "at least 24 pixels per side"),
    ("small mosaic", lambda: edge_response(gaussian_edge()[:40], layout="RG/GB", channel="G"), "for one channel of a mosaic"),
    ("no green", lambda: edge_response(gaussian_edge(), channel="G"), "stands out as green"),
    ("three channels", lambda: edge_response(np.zeros((64, 64, 3))), "one channel of numbers"),
    ("denormal", lambda: edge_response(1e-310 * gaussian_edge()), "largest value of"),
    ("huge", lambda: edge_response(1e300 * gaussian_edge()), "largest value of"),
    ("NaN", lambda: edge_response(np.where(distances(5.0) > 150, np.nan, gaussian_edge())), "NaN or infinite"),
    ("no polynomial", lambda: edge_response(DARK + 900.0 * (distances(5.0) > 4 * WAVES)), "of a polynomial of degree 5"),
    ("few lines", lambda: edge_response(DARK + 900.0 * (distances(5.0) > 6 * WAVES)), "an edge in 189 of 320 lines"),
    ("45°", lambda: edge_response(gaussian_edge(45.0)), "bins without a pixel"),
    ("at the side", lambda: edge_response(gaussian_edge(5.0)[:, 155:215]), "on either side"),
    ("saturated", lambda: edge_response(gaussian_edge(), saturation=999.0), "saturated"),
    ("outside", lambda: edge_response(gaussian_edge(), region=(0, 0, 321, 100)), "within 0,0,320,320"),
    ("three numbers", lambda: edge_response(gaussian_edge(), region=(0, 0, 100)), "region: got 0,0,100"),
    ("planes", lambda: edge_response(RGB, layout="R+G+B"), "one channel"),
    ("two thirds", lambda: edge_response(RGB[1:], layout="R+G+B", channel="G"), "layout: got"),
    *(
        (f"clipped {channel}", lambda channel=channel: edge_response(mosaic("RG/GB", np.minimum(gaussian_edge(), 0.7 * LIGHT)), layout="RG/GB", channel=channel), "clipped on neither side")
        for channel in ("R", "luminance")
    ),
    *(
        (f"mosaic {layout}", lambda layout=layout: edge_response(mosaic(layout, gaussian_edge()) + 5 * PIXEL_NOISE), "looks like a colour mosaic")
        for layout in ("RG/GB", "RRGG/RRGG/GGBB/GGBB", "GBGGRG/RGRBGB/GBGGRG/GRGGBG/BGBRGR/GRGGBG")
    ),
]  # fmt: skip


@pytest.mark.parametrize(("name", "call", "words"), REFUSED)
def test_edges_that_mislead_are_refused(name: str, call: Callable[[], object], words) -> None:
    with pytest.raises(PixsimError, match=words):
        call()


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("pictures")
    np.save(folder / "edge.npy", gaussian_edge())
    np.save(folder / "complex.npy", 1j * gaussian_edge())
    np.savez(folder / "two.npz", a=EDGE, b=EDGE)
    Image.fromarray(np.zeros((64, 64), np.uint8)).save(folder / "grey8.png")
    for name in ("text.npy", "text.png"):
        (folder / name).write_text("not a picture")
    write_channels(folder / "rgb.exr", {"R": EDGE, "G": EDGE}, {})
    return folder


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("ex1.6.png", "exactly 4095 above black, while the other"),
        ("ex1.6.png --saturation 4095", "49.9 % saturated"),
        ("mild.tif", "looks like a colour mosaic"),
        ("mild.tif --channel R", "--layout RG/GB"),
        ("mild.tif --channel 2,0", "from 0,0 to 1,1"),
        ("mild.tif --channel G --layout rggb", "capital letters"),
        ("mosaic_tagged.tif", "--channel G"),
        ("mosaic_tagged.tif --channel X", "R, G, B, luminance"),
        ("rgb16.tif --channel 0,1", "R, G, B, luminance"),
        ("rgb16.tif --layout RG/GB", "a mosaic"),
        ("ex1.0.png --black 5000 --saturation 4095", "more than the black level"),
        ("none.exr", "does not exist"),
        ("edge.jpg", ".png"),
        ("two.npz", "a single array"),
        ("grey8.png", "linear in light"),
        ("text.npy", "readable"),
        ("text.png", "readable"),
        ("rgb.exr", "one channel of digital numbers"),
        ("edge.npy --region 1,2,3", "x0,y0,x1,y1"),
        ("edge.npy --pitch-um -1", "above 0"),
        ("edge.npy --saturation nan", "a finite number"),
        ("complex.npy", "real or whole numbers"),
        ("edge.npy --black-level-dn 2000", "black level is right"),
    ],
)
def test_pictures_of_edges(line: str, words: str, pictures: Path, tmp_path: Path) -> None:
    folder = CASES if (CASES / line.split()[0]).exists() else pictures
    assert_refused(*command(f"sfr {folder}/{line} --out {tmp_path}/o"), [words])
    assert not (tmp_path / "o").exists()
