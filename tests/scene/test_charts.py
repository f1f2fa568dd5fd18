"""Charts against their definitions: frequencies, contrasts, luminances, angles, and the errors of
textures.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pixsim.base.errors import PixsimError
from pixsim.light.exr import read_channels
from pixsim.scene import charts

SHIPPED = Path(__file__).parents[2] / "scenes" / "charts"


@pytest.mark.parametrize("die_mm", [2.7136, 5.0])
def test_csf_value_phase_derivative_is_frequency(die_mm):
    x = np.linspace(0, 1, 400_001)
    wave = charts.csf_value(x, 1.0, die_mm) - 0.5125
    before = np.flatnonzero(np.diff(np.sign(wave[1:]))) + 1
    zeros = x[before] + np.diff(x)[before] * wave[before] / (wave[before] - wave[before + 1])
    # Half a cycle between neighbouring zeros.
    result = 0.5 / (np.diff(zeros) * die_mm)
    middle = (zeros[1:] + zeros[:-1]) / 2
    # f(middle) is the mean of an exponential but for (3.5 Δx)²/24, 1.2 % in the first half cycle,
    # 1e-5 in the last.
    bound = (np.log(1000 / 30) * np.diff(zeros)) ** 2 / 24 + 1e-5
    assert result.size > 48 * die_mm / 2.7136
    assert np.all(np.abs(result / charts.csf_frequency_lp_per_mm(middle) - 1) < 1.1 * bound)


def test_csf_contrast_and_luminance_match_paper():
    top, bottom = (charts.csf_value(np.linspace(0, 1, 200_001), y) * 1000 for y in (0.0, 1.0))
    # 25 to 1000 cd/m², mean 512.5, largest Michelson contrast 975/1025; 1 % of it on top.
    assert (bottom.min(), bottom.max()) == pytest.approx((25, 1000), abs=1e-4)
    assert (top.min() + top.max()) / 2 == pytest.approx(512.5, abs=1e-4)
    assert np.ptp(bottom) / (bottom.max() + bottom.min()) == pytest.approx(0.951, abs=5e-4)
    assert np.ptp(top) / np.ptp(bottom) == pytest.approx(0.01, rel=1e-6)
    assert charts.csf_contrast(0.5) == pytest.approx(0.1 * 975 / 1025, rel=1e-12)


# --- Other charts ---
def test_slanted_edge_is_5_degrees():
    texels = charts.slanted_edge(400, 400)
    # Where the edge crosses each row, from the row's dark area; coverage is counted in 8 × 8
    # points: 1/16 texel.
    crossing = 400 * (1 - (texels.astype(float) - 0.1).mean(axis=1) / 0.9)
    slope, _ = np.polyfit(np.arange(400), crossing, 1)
    assert np.degrees(np.arctan(-slope)) == pytest.approx(5.0, abs=0.01)
    assert crossing.mean() == pytest.approx(200, abs=0.1)
    assert (texels[200, 0], texels[200, -1]) == pytest.approx((0.1, 1.0))
    # One edge only: every row rises all the way.
    assert np.diff(texels, axis=1).min() >= 0


def test_siemens_star_has_72_cycles():
    texels = read_channels(SHIPPED / "siemens_star.exr")[0]["Y"]
    angle = np.radians(np.arange(0, 360, 0.05) + 0.02)
    row, column = (
        np.floor(512 - 400 * np.sin(angle)).astype(int),
        np.floor(512 + 400 * np.cos(angle)).astype(int),
    )
    bright = texels[row, column] > 0.5125
    assert np.count_nonzero(bright != np.roll(bright, 1)) == 2 * 72
    # The first sector above the positive x axis is bright.
    assert texels[511 - 10, 512 + 400] == 1.0
    assert texels[512 + 10, 512 + 400] == pytest.approx(0.025)


# --- Files and sizes ---
SLOW_CHARTS = {"siemens_star": pytest.mark.slow}  # 64 points for each of a million texels


@pytest.mark.parametrize(
    "kind", [pytest.param(kind, marks=SLOW_CHARTS.get(kind, ())) for kind in charts.CHARTS]
)
def test_packaged_textures_equal_make_chart(kind):
    channels, _ = read_channels(SHIPPED / f"{kind}.exr")
    assert list(channels) == ["Y"]
    np.testing.assert_array_equal(channels["Y"], charts.make_chart(kind))


def test_make_chart_target_has_its_size_on_the_die():
    texels = charts.make_chart(
        "target", 400, 400, 4.0, shape="bar", size_um=100, contrast=0.5, direction="horizontal"
    )
    expected = np.ones((400, 400), np.float32)
    expected[195:205, 175:225] = 1.5  # 0.1 × 0.5 mm in texels of 10 µm
    np.testing.assert_allclose(texels, expected, atol=1e-7)


# --- A CSF chart with a highest frequency of its own ---
@pytest.mark.parametrize(("highest_lp_per_mm", "die_mm"), [(145.0, 8.5), (40.0, 2.0), (20.0, 36.0)])
def test_csf_file_begins_at_2_7_cycles_and_ends_at_its_frequency(
    highest_lp_per_mm, die_mm, tmp_path, monkeypatch
):
    monkeypatch.setenv("PIXSIM_CACHE_DIR", str(tmp_path))
    path = charts.csf_file(highest_lp_per_mm, die_mm)
    assert charts.csf_file(highest_lp_per_mm, die_mm) == path, "the same content has the same file"
    assert list(tmp_path.rglob("*.exr")) == [path]
    texels = next(iter(read_channels(path)[0].values())).astype(float)
    width = texels.shape[1]
    assert 8192 <= width <= 32768
    assert width >= min(32 * highest_lp_per_mm * die_mm, 32768) - 1
    wave = texels[-1] - 0.5125
    before = np.flatnonzero(np.diff(np.sign(wave)))
    zeros = (before + 0.5 + wave[before] / (wave[before] - wave[before + 1])) / width
    x, frequency = (zeros[1:] + zeros[:-1]) / 2, 0.5 / np.diff(zeros) / die_mm
    header = {"scene": "csf.xml", "parameters": {"max_lp_per_mm": repr(highest_lp_per_mm)}}
    expected = charts.csf_frequency_on_sensor(header, die_mm)
    assert expected([0.0, 1.0]) == pytest.approx([2.7136 / die_mm, highest_lp_per_mm], rel=1e-12)
    # Half cycles from linear zeros of texels: 1 % where a cycle has 26 of them, and of curvature in
    # the long first ones.
    assert np.abs(frequency[3:] / expected(x[3:]) - 1).max() < 0.01


def test_texture_file_on_full_disk_is_temporary(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """The disk of the cache is full, that of temporary files is not; where both are, the error
    names the file.
    """
    monkeypatch.setenv("PIXSIM_CACHE_DIR", str(tmp_path))
    write = charts.write_channels
    full = [tmp_path]

    def write_if_room(path: Path, *content: dict[str, object], named: bool = True) -> None:
        if any(path.is_relative_to(folder) for folder in full):
            raise PixsimError(f"output file: got '{path}' (No space left on device)")
        write(path, *content, named=named)

    monkeypatch.setattr(charts, "write_channels", write_if_room)
    path = charts.texture_file(["full"], charts.flat)
    assert path.is_file()
    assert not path.is_relative_to(tmp_path)
    full.append(path.parent)
    with pytest.raises(PixsimError, match=r"\.exr' \(No space left"):
        charts.texture_file(["other"], charts.flat)
