"""e-SFR of edges whose MTF is known in closed form, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from helpers.commands import command
from scipy.special import erf

from pixsim import PixsimError, edge_response
from pixsim.light.exr import write_channels
from pixsim.measure.sfr import NYQUIST_CY_PER_PX, first_crossing, read_edge_picture, response, sfr_line
from pixsim.measure.sfr import sfr_summary as summary

SIDE = 320
DARK, LIGHT = 100.0, 1000.0
WITHIN = 3e-4  # of noiseless edges: what finite bins leave


def distances(angle_deg: float, height: int = SIDE, width: int = SIDE, shift: float = 0.2) -> np.ndarray:
    """Of the pixel centres from an edge `angle_deg` clockwise from the vertical."""
    y, x = np.mgrid[:height, :width]
    angle = np.radians(angle_deg)
    return (x - (width - 1) / 2 - shift) * np.cos(angle) + (y - (height - 1) / 2) * np.sin(angle)


def gaussian_edge(angle_deg: float = 5.0, sigma_px: float = 0.6, **size: int) -> np.ndarray:
    """MTF exp(-2 π² σ² f²)."""
    return DARK + (LIGHT - DARK) * (1 + erf(distances(angle_deg, **size) / (sigma_px * 2**0.5))) / 2


def gaussian_mtf(frequency: np.ndarray, sigma_px: float = 0.6) -> np.ndarray:
    return np.exp(-2 * (np.pi * sigma_px * frequency) ** 2)


def below_nyquist(picture: np.ndarray, **how: object) -> tuple[np.ndarray, np.ndarray]:
    found = edge_response(picture, **how)
    kept = found.frequency_cy_per_px <= NYQUIST_CY_PER_PX
    return found.frequency_cy_per_px[kept], found.sfr[kept]


@pytest.mark.parametrize("angle_deg", [5.0, -5.0, 2.5, 8.0, 12.0, 95.0, 85.0, 185.0, -85.0, 101.0])
def test_a_gaussian_edge_at_any_slant(angle_deg: float) -> None:
    frequency, sfr = below_nyquist(gaussian_edge(angle_deg))
    assert np.abs(sfr - gaussian_mtf(frequency)).max() < WITHIN
    assert edge_response(gaussian_edge(angle_deg)).angle_deg == pytest.approx((angle_deg + 45) % 180 - 45, abs=1e-3)


def test_light_on_the_left_or_on_the_right_is_the_same() -> None:
    there, back = gaussian_edge(5.0), gaussian_edge(185.0)
    assert np.abs(edge_response(there).sfr - edge_response(back).sfr).max() < 5e-4


@pytest.mark.parametrize("angle_deg", [5.0, 95.0])
def test_a_square_pixel_on_a_sharp_edge(angle_deg: float) -> None:
    """Exact cell means of a step: a trapezoid across, of widths cos θ and sin θ; MTF sinc(f cos θ) sinc(f sin θ)."""
    cos, sin = abs(np.cos(np.radians(angle_deg))), abs(np.sin(np.radians(angle_deg)))

    def ramp(u: np.ndarray) -> np.ndarray:
        return np.maximum(u, 0.0) ** 2 / 2

    d, wide, narrow = distances(angle_deg), (cos + sin) / 2, abs(cos - sin) / 2
    cover = (ramp(d + wide) - ramp(d + narrow) - ramp(d - narrow) + ramp(d - wide)) / (cos * sin)
    frequency, sfr = below_nyquist(DARK + (LIGHT - DARK) * cover)
    assert np.abs(sfr - np.sinc(frequency * cos) * np.sinc(frequency * sin)).max() < 0.002  # the corners alias a little


def test_skirts_of_diffraction_need_a_wide_window() -> None:
    """1/x² skirts: LSF = a/π/(a² + x²), MTF exp(-2π a f). What a window misses falls as it widens."""
    a = 0.2
    picture = DARK + (LIGHT - DARK) * (0.5 + np.arctan(distances(5.0) / a) / np.pi)
    missed = []
    for half_px in (20, 48, 96):
        frequency, sfr = below_nyquist(picture, half_window_px=half_px)
        missed.append(np.abs(sfr - np.exp(-2 * np.pi * a * frequency)).max())
    assert missed[0] > 0.008
    assert missed[1] < 0.005
    assert missed[0] > 2 * missed[1] > 2 * missed[2]


def test_its_own_bin_and_derivative_are_taken_out() -> None:
    """A line one bin wide, spread over four by bin means: without corrections a perfect edge would have 0.88 at Nyquist."""
    spread = np.where(np.arange(400) < 200, 0.0, 1.0)
    frequency, sfr = response(spread)
    own = np.sinc(frequency / 2) * np.sinc(frequency / 4)
    low = frequency <= NYQUIST_CY_PER_PX
    assert np.allclose((sfr * own)[low], np.abs(np.cos(np.pi * frequency / 4))[low], atol=1e-3)
    assert (np.sinc(0.25) * np.sinc(0.125)) == pytest.approx(0.877, abs=1e-3)


def test_noise_scatters_the_sfr_but_does_not_move_it() -> None:
    rng, edge = np.random.default_rng(0), gaussian_edge()
    found = np.array([below_nyquist(edge + 15 * rng.standard_normal(edge.shape))[1] for _ in range(16)])
    frequency, _ = below_nyquist(edge)
    error = found.mean(axis=0) - gaussian_mtf(frequency)
    assert np.abs(error).max() < 5 * found.std(axis=0, ddof=1).max() / 4
    assert 0.001 < found.std(axis=0).max() < 0.05


def test_black_level_and_gain_do_not_matter() -> None:
    one, other = edge_response(gaussian_edge()), edge_response(3 * gaussian_edge() + 500)
    assert np.allclose(one.sfr, other.sfr, atol=1e-12)
    assert one.contrast == pytest.approx((LIGHT - DARK) / (LIGHT + DARK), rel=1e-6)


def test_a_region_and_what_it_tells() -> None:
    found = edge_response(gaussian_edge(), region=(60, 40, 260, 280))
    assert found.half_window_px == 64
    assert found.mtf50_cy_per_px == pytest.approx(np.sqrt(np.log(2) / 2) / np.pi / 0.6, abs=3e-4)
    assert found.at_nyquist == pytest.approx(gaussian_mtf(np.array(0.5)), abs=3e-4)
    assert found.frequency_cy_per_mm(5.0)[-1] == pytest.approx(200.0)
    assert edge_response(gaussian_edge(height=100, width=60)).half_window_px < 30


def test_a_crossing_is_found_or_not() -> None:
    frequency = np.array([0.0, 1.0, 2.0])
    assert first_crossing(frequency, np.array([1.0, 0.6, 0.2]), 0.5) == pytest.approx(1.25)
    assert first_crossing(frequency, np.array([1.0, 0.9, 0.8]), 0.5) is None


REFUSED = {
    "contrast": np.full((64, 64), 100.0) + np.random.default_rng(1).standard_normal((64, 64)),
    "step of": DARK + 30 * (distances(5.0, 64, 64) > 0) + 40 * np.random.default_rng(1).standard_normal((64, 64)),
    "from the rows or columns": gaussian_edge(0.0),
    "columns, over": gaussian_edge(90.4),
    "at least 24 a side": gaussian_edge()[:20],
    "one channel of numbers": np.zeros((64, 64, 3)),
    "NaN or infinite": np.where(distances(5.0) > 150, np.nan, gaussian_edge()),
    "straight edge": DARK + 900.0 * (distances(5.0) > ((np.arange(SIDE)[:, None] - SIDE / 2) / 30) ** 2),  # a curve
    "bins without a pixel": gaussian_edge(45.0),
    "on either side": gaussian_edge(5.0)[:, 160 - 5 : 160 + 200][:, :60],
}


@pytest.mark.parametrize("told", REFUSED)
def test_what_is_no_slanted_edge_is_refused(told: str) -> None:
    with pytest.raises(PixsimError, match=told):
        edge_response(REFUSED[told])


def test_a_saturated_edge_and_a_region_outside_are_refused() -> None:
    with pytest.raises(PixsimError, match="saturated"):
        edge_response(gaussian_edge(), saturation=999.0)
    edge_response(gaussian_edge(), saturation=1023.0)
    with pytest.raises(PixsimError, match="within 0,0,320,320"):
        edge_response(gaussian_edge(), region=(0, 0, 321, 100))


# --- files and the command --------------------------------------------------------------------------------------------


def save_png16(path: Path, picture: np.ndarray) -> None:
    from PIL import Image

    Image.fromarray(picture.astype(np.uint16)).save(path)


def test_every_format_gives_the_same(tmp_path: Path) -> None:
    edge = np.rint(gaussian_edge())
    header = {"unit": "DN", "bits": 10, "black_level_dn": 20.0, "pitch_um": 5.3}
    write_channels(tmp_path / "raw.exr", {"DN": edge}, header)
    np.save(tmp_path / "edge.npy", edge.astype(np.uint16))
    np.savez(tmp_path / "edge.npz", edge)
    save_png16(tmp_path / "edge.png", edge)
    for name in ("raw.exr", "edge.npy", "edge.npz", "edge.png"):
        assert np.array_equal(read_edge_picture(tmp_path / name).data, edge)
    raw = read_edge_picture(tmp_path / "raw.exr")
    assert (raw.pitch_um, raw.black_level_dn, raw.top) == (5.3, 20.0, 1023.0)
    assert read_edge_picture(tmp_path / "edge.png").top == 65535


def test_the_command_writes_what_it_says(tmp_path: Path) -> None:
    write_channels(tmp_path / "raw.exr", {"DN": np.rint(gaussian_edge())}, {"bits": 10, "black_level_dn": 20.0, "pitch_um": 5.0})
    code, out, err = command(f"sfr {tmp_path}/raw.exr --out {tmp_path}/o --json")
    assert (code, err) == (0, "")
    result = json.loads(out)
    assert result == json.loads((tmp_path / "o/summary.json").read_text(encoding="utf-8"))
    assert result["mtf50_cy_per_mm"] == pytest.approx(200 * result["mtf50_cy_per_px"])
    assert {path.name for path in (tmp_path / "o").iterdir()} == {
        "sfr.csv", "sfr.svg", "edge_spread.csv", "edge_spread.svg", "summary.json"
    }  # fmt: skip
    first = (tmp_path / "o/sfr.csv").read_text(encoding="utf-8").splitlines()
    assert first[0] == "frequency_cy_per_px,sfr,frequency_cy_per_mm"
    assert float(first[1].split(",")[1]) == 1.0
    code, out, _ = command(f"sfr {tmp_path}/raw.exr --out {tmp_path}/o --region 60,40,260,280")
    assert code == 0
    assert out.startswith("MTF50 0.31")


def test_without_a_pitch_there_are_no_millimetres() -> None:
    result = summary(edge_response(gaussian_edge(sigma_px=0.1)), None)
    assert "mtf50_cy_per_mm" not in result
    assert "above 1 cy/px" in sfr_line(result)


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ("sfr none.exr", "does not exist"),
        ("sfr edge.jpg", "16 bits"),
        ("sfr two.npz", "one: the picture"),
        ("sfr grey8.png", "linear in light"),
        ("sfr text.npy", "readable"),
        ("sfr text.png", "readable"),
        ("sfr rgb.exr", "one: DN"),
        ("sfr edge.npy --region 1,2,3", "four whole numbers|x0,y0,x1,y1"),
        ("sfr edge.npy --pitch-um -1", "above 0"),
        ("sfr edge.npy --black-level-dn 2000", "black level is right"),
    ],
)
def test_unusable_files_are_told_in_one_message(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, line: str, told: str) -> None:
    from PIL import Image

    monkeypatch.chdir(tmp_path)
    edge = gaussian_edge()
    np.save("edge.npy", edge)
    np.savez("two.npz", a=edge, b=edge)
    Image.fromarray(np.zeros((64, 64), np.uint8)).save("grey8.png")
    for name in ("text.npy", "text.png"):
        Path(name).write_text("not a picture", encoding="utf-8")
    write_channels("rgb.exr", {"R": edge, "G": edge}, {})
    code, _, err = command(line)
    assert code == 2
    assert err.count("\n") == 1
    assert any(part in err for part in told.split("|"))
    assert not Path("pixsim-out").exists()
