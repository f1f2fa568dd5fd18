"""e-SFR of edges whose MTF is known in closed form, and errors for invalid pictures and files."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from helpers.commands import assert_refused, command
from PIL import Image
from scipy.special import erf

from pixsim import PixsimError, edge_response, read_frame, write_frame
from pixsim.light.exr import write_channels
from pixsim.measure.sfr import NYQUIST_CY_PER_PX, first_crossing, read_edge_picture, sfr_line, sfr_summary as summary
from pixsim.sensor.colour import Layout
from pixsim.sensor.raw import RawFrame

SIDE = 320
DARK, LIGHT = 100.0, 1000.0
TOLERANCE = 3e-4  # error of finite bins on noiseless edges


def distances(angle_deg: float, height: int = SIDE, width: int = SIDE, shift: float = 0.2) -> np.ndarray:
    """Signed distances of the pixel centres from an edge `angle_deg` clockwise from the vertical."""
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
    frequency, sfr = below_nyquist(gaussian_edge(angle_deg))
    assert np.abs(sfr - gaussian_mtf(frequency)).max() < TOLERANCE
    assert edge_response(gaussian_edge(angle_deg)).angle_deg == pytest.approx((angle_deg + 45) % 180 - 45, abs=1e-3)


@pytest.mark.parametrize("angle_deg", [5.0, 95.0])
def test_edge_response_square_pixel_matches_sinc(angle_deg: float) -> None:
    """Exact cell means of a step, with the MTF sinc(f cos θ) sinc(f sin θ)."""
    cos, sin = abs(np.cos(np.radians(angle_deg))), abs(np.sin(np.radians(angle_deg)))

    def ramp(u: np.ndarray) -> np.ndarray:
        return np.maximum(u, 0.0) ** 2 / 2

    d, wide, narrow = distances(angle_deg), (cos + sin) / 2, abs(cos - sin) / 2
    cover = (ramp(d + wide) - ramp(d + narrow) - ramp(d - narrow) + ramp(d - wide)) / (cos * sin)
    frequency, sfr = below_nyquist(DARK + (LIGHT - DARK) * cover)
    assert np.abs(sfr - np.sinc(frequency * cos) * np.sinc(frequency * sin)).max() < 0.002  # a little aliasing


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


@pytest.mark.parametrize(
    ("layout", "place", "pitch_um"),
    [("GR/BG", np.s_[0::2, 0::2], 6), ("RG/GB", np.s_[0::2, 1::2], 6), ("R+G+B", np.s_[0:320], 3)],
    ids=str,
)
def test_frame_of_a_colour_sensor_is_refused_with_a_way_to_one_channel(
    layout: str, place: object, pitch_um: float, tmp_path: Path
) -> None:
    """Channels differ in their signal: mixed, they look like noise. The hint leads to the edge that one channel sees."""
    frame = np.rint(100 * gaussian_edge())
    frame = np.concatenate([frame, frame, frame]) if "+" in layout else np.rint(frame * np.tile([[1.0, 0.5], [0.5, 1]], (160, 160)))
    raw = RawFrame(frame.astype(np.uint32), pitch_um=3.0, layout=Layout.of_text(layout))
    write_frame(tmp_path / "raw.exr", raw)
    with pytest.raises(PixsimError, match=r"one channel\. Save one of them") as caught:
        read_edge_picture(tmp_path / "raw.exr")
    text = re.search(r"dn(\[.*?\])\), and measure that file, with --pitch-um (\S+)\.$", str(caught.value))
    assert text is not None
    assert float(text[2]) == pitch_um
    found = eval(f"dn{text[1]}", {"dn": read_frame(tmp_path / "raw.exr").dn})
    assert (found == frame[place]).all()


def test_read_edge_picture_all_formats_agree(tmp_path: Path) -> None:
    edge = np.rint(gaussian_edge())
    header = {"unit": "DN", "bits": 10, "black_level_dn": 20.0, "pitch_um": 5.3}
    write_channels(tmp_path / "raw.exr", {"DN": edge}, header)
    np.save(tmp_path / "edge.npy", edge.astype(np.uint16))
    np.savez(tmp_path / "edge.npz", edge)
    Image.fromarray(edge.astype(np.uint16)).save(tmp_path / "edge.png")
    for name in ("raw.exr", "edge.npy", "edge.npz", "edge.png"):
        assert np.array_equal(read_edge_picture(tmp_path / name).data, edge)
    raw = read_edge_picture(tmp_path / "raw.exr")
    assert (raw.pitch_um, raw.black_level_dn, raw.top) == (5.3, 20.0, 1023.0)
    assert read_edge_picture(tmp_path / "edge.png").top == 65535


def test_sfr_command_writes_files(tmp_path: Path) -> None:
    write_channels(tmp_path / "raw.exr", {"DN": np.rint(gaussian_edge())}, {"bits": 10, "black_level_dn": 20.0, "pitch_um": 5.0})
    code, out, err = command(f"sfr {tmp_path}/raw.exr --out {tmp_path}/o --json")
    assert (code, err) == (0, "")
    result = json.loads(out)
    assert result == json.loads((tmp_path / "o/summary.json").read_text(encoding="utf-8"))
    assert result["mtf50_cy_per_mm"] == pytest.approx(200 * result["mtf50_cy_per_px"])
    assert {path.name for path in (tmp_path / "o").iterdir()} == {
        "sfr.csv", "sfr.svg", "edge_spread.csv", "edge_spread.svg", "summary.json", "provenance.json"
    }  # fmt: skip
    first = (tmp_path / "o/sfr.csv").read_text(encoding="utf-8").splitlines()
    assert first[0] == "frequency_cy_per_px,sfr,frequency_cy_per_mm"
    assert float(first[1].split(",")[1]) == 1.0
    code, out, _ = command(f"sfr {tmp_path}/raw.exr --out {tmp_path}/o --region 60,40,260,280")
    assert code == 0
    assert out.startswith("MTF50 0.31")


def test_sfr_summary_without_pitch_has_no_millimetres() -> None:
    result = summary(edge_response(gaussian_edge(sigma_px=0.1)), None)
    assert "mtf50_cy_per_mm" not in result
    assert "above 1 cy/px" in sfr_line(result)


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
def test_sfr_command_invalid_file_raises(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, line: str, message: str) -> None:
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
