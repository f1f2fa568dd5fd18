"""Charts against their definitions: frequencies, contrasts, luminances, angles, and the errors of
textures.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import pixsim
from pixsim.base.errors import PixsimError
from pixsim.light.exr import read_channels
from pixsim.scene import charts

SHIPPED = Path(__file__).parents[2] / "scenes" / "charts"


# --- The CSF chart ---


def test_csf_frequency_ends_at_nyquist_of_15_um():
    np.testing.assert_allclose(charts.csf_frequency_lp_per_mm([0, 1]), [1.0, 1000 / 30], rtol=1e-14)
    # Exponential: equal ratios.
    assert charts.csf_frequency_lp_per_mm(0.5) == pytest.approx(np.sqrt(1000 / 30), rel=1e-12)


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


def bilinear(texels: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Interpolate texels at x, y in [0, 1] as a renderer does: centres at (i + ½)/n, clamped."""
    height, width = texels.shape
    column, row = x * width - 0.5, y * height - 0.5
    left, upper = (
        np.clip(np.floor(v).astype(int), 0, n - 2) for v, n in ((column, width), (row, height))
    )
    u, v = np.clip(column - left, 0, 1), np.clip(row - upper, 0, 1)
    t = texels.astype(float)
    above = t[upper, left] * (1 - u) + t[upper, left + 1] * u
    return above * (1 - v) + (t[upper + 1, left] * (1 - u) + t[upper + 1, left + 1] * u) * v


@pytest.mark.parametrize("y", [0.004, 0.25, 0.6, 0.996])
@pytest.mark.parametrize("frequency_lp_per_mm", [1.2, 4.0, 12.0, 20.0, 32.5])
def test_csf_texture_keeps_contrast(frequency_lp_per_mm, y):
    middle = np.log(frequency_lp_per_mm) / np.log(1000 / 30)
    x = np.clip(middle + np.linspace(-0.015, 0.015, 20_001), 0.001, 0.999)
    exact = charts.csf_value(x, y) - 0.5125
    read = bilinear(charts.csf(), x, np.full_like(x, y)) - 0.5125
    # The wave that is read, in units of the one that should be: linear interpolation takes (π f
    # Δx)²/3 of it, 0.04 % at 33 lp/mm, on average; rows and rounding add 0.005 %.
    assert (read * exact).sum() / (exact * exact).sum() == pytest.approx(1.0, abs=1e-3)
    # Point by point: measured 0.084 % on crests at 33 lp/mm where the contrast is 1 %, of which
    # rounding is 0.04 %.
    assert np.abs(read - exact).max() < 1e-3 * 0.5125 * charts.csf_contrast(y)


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


def test_siemens_star_is_symmetric():
    texels = charts.siemens_star(256, 256).astype(float)
    # 72 cycles: a quarter turn is 18 of them, a mirror exchanges bright and dark. Points that lie
    # exactly on a sector's border (the diagonals) may fall to either side: 8 of 64 a texel.
    one_diagonal = 0.975 / 8 + 1e-6
    assert np.abs(texels - np.rot90(texels)).max() < one_diagonal
    y, x = np.indices(texels.shape) - 127.5
    disc = np.hypot(x, y) < 0.44 * 256
    assert np.abs(texels + texels[::-1] - 1.025)[disc].max() < one_diagonal
    assert np.all(texels[np.hypot(x, y) > 0.46 * 256] == 1.0)


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


@pytest.mark.parametrize("kind", list(charts.CHARTS))
def test_make_chart_texels_are_valid(kind):
    texels = charts.make_chart(kind, 64, 32)
    assert texels.shape == (32, 64)
    assert texels.dtype == np.float32
    # A NaN or a negative texel would spoil its neighbours without a word.
    assert np.all((texels >= (1 if kind == "flat" else 0.0249)) & (texels <= 1))


def test_make_chart_target_has_its_size_on_the_die():
    texels = charts.make_chart(
        "target", 400, 400, 4.0, shape="bar", size_um=100, contrast=0.5, direction="horizontal"
    )
    expected = np.ones((400, 400), np.float32)
    expected[195:205, 175:225] = 1.5  # 0.1 × 0.5 mm in texels of 10 µm
    np.testing.assert_allclose(texels, expected, atol=1e-7)


def test_make_chart_other_die_keeps_frequencies():
    # The first half of the phase of a die twice as wide runs at twice the cycles per width.
    narrow, wide = (
        charts.make_chart("csf", 4096, 4, die_mm)[3].astype(float) for die_mm in (2.0, 4.0)
    )
    crossings = [np.count_nonzero(np.diff(np.sign(line - 0.5125))) for line in (narrow, wide)]
    assert crossings[1] == pytest.approx(2 * crossings[0], abs=2)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            {"kind": "nope"},
            r"chart: got 'nope'; allowed: csf, flat, siemens_star, slanted_edge, target",
        ),
        ({"kind": "csf", "width": 1}, r"chart size: got .*1.*2 to 32768"),
        (
            {"kind": "flat", "height": 40_000},
            r"height: got 40000; allowed: a whole number from 1 to 32768",
        ),
        ({"kind": "csf", "die_mm": 0.0}, r"die_mm: got 0.0; allowed: a number from 1e-05 to 1000"),
        ({"kind": "flat", "die_mm": 2.0}, r"die_mm: got 2 for flat.*for csf and target only"),
        (
            {"kind": "flat", "contrast": 0.1},
            r"chart contrast: got a value for flat; allowed: a value for target only",
        ),
        (
            {"kind": "target", "size_mm": 3},
            r"target: got Target\(.*; allowed: a size on the sensor, size_um",
        ),
        (
            {"kind": "target", "size_um": 3000},
            r"size of the target: got 3 × 3 mm .* in a field of 2\.714 × 2\.714 mm",
        ),
    ],
)
def test_make_chart_invalid_arguments_raise(arguments, message):
    with pytest.raises(PixsimError, match=message):
        pixsim.charts.make_chart(**arguments)


def test_write_chart_other_ending_raises(tmp_path):
    with pytest.raises(PixsimError, match=r"chart\.png.*\.exr"):
        charts.write_chart(tmp_path / "chart.png", charts.flat())


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


def test_csf_frequency_on_sensor_other_scenes_have_none():
    assert charts.csf_frequency_on_sensor({"scene": "flat.xml"}, 2.0) is None
    assert (
        charts.csf_frequency_on_sensor(
            {"scene": "csf.xml", "parameters": {"chart": "mine.exr"}}, 2.0
        )
        is None
    )
    assert charts.csf_frequency_on_sensor({"scene": "csf.xml", "parameters": None}, 2.7136)(
        1.0
    ) == pytest.approx(100 / 3)


def test_csf_file_below_its_lowest_frequency_raises():
    with pytest.raises(
        PixsimError, match=r"max_lp_per_mm: got 0\.3; allowed: at least 0\.373 on a die of 8 mm"
    ):
        charts.csf_file(0.3, 8.0)


def test_texture_file_on_full_disk_is_temporary(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """The disk of the cache is full, that of temporary files is not; where both are, the error
    names the file.
    """
    monkeypatch.setenv("PIXSIM_CACHE_DIR", str(tmp_path))
    write, full = charts.write_channels, [tmp_path]

    def write_if_room(path: Path, *content: dict[str, object], named: bool = True) -> None:
        if any(path.is_relative_to(folder) for folder in full):
            raise PixsimError(f"output file: got '{path}' (No space left on device)")
        write(path, *content, named=named)

    monkeypatch.setattr(charts, "write_channels", write_if_room)
    path = charts.texture_file(["full"], lambda: np.ones((2, 2), np.float32))
    assert path.is_file()
    assert not path.is_relative_to(tmp_path)
    full.append(path.parent)
    with pytest.raises(PixsimError, match=r"\.exr' \(No space left"):
        charts.texture_file(["other"], lambda: np.ones((2, 2), np.float32))
