"""`pixsim lens`: its numbers against closed forms and rays, its files, and its self-contained page."""

from __future__ import annotations

import itertools
import json
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.browser import assert_fits, needs_browser
from helpers.commands import command
from helpers.looks import Elements, text_of

import pixsim
from pixsim.optics.diffraction import diffraction_otf
from pixsim.report.lens import FIGURES, LensData, lens_data, lens_plates, line_mtf, ray_spreads, spot_points


@cache
def triplet() -> LensData:
    return lens_data(pixsim.load_lens("cooke_triplet"), [550.0], 4.0)


def test_mtf_of_a_lens_without_aberrations_is_that_of_diffraction() -> None:
    """The singlet at f/40: .006 waves are left, and its plane is in focus."""
    lens = pixsim.load_lens("singlet").stopped_down(40.0).refocused("paraxial")
    data = lens_data(lens, [587.56])
    want = diffraction_otf(data.frequency_lp_per_mm, 587.56, 40.0)
    assert np.abs(data.mtf[0] - want).max() < 2e-3
    assert data.spots[0].rms_um < 0.1
    assert data.rms_waves[0] < 0.01


def test_mtf_at_low_frequencies_is_that_of_the_spot() -> None:
    """Where aberrations are much larger than diffraction: |mean of exp(2πi f y)| over rays, tangential along y."""
    data = triplet()
    index = 6
    spot = data.spots[index]
    assert spot.rms_um > 5 * 1.22 * 0.55 * 5 / 2
    for axis, off_um in enumerate((spot.y_um[0], spot.x_um[0])):
        geometric = abs(np.exp(2j * np.pi * 10e-3 * off_um).mean())
        assert data.mtf_at(10.0)[index, axis] == pytest.approx(geometric, abs=0.03)
    assert data.mtf_at(10.0)[index, 0] < data.mtf_at(10.0)[index, 1] - 0.05


def test_large_aberrations_take_the_mtf_of_rays() -> None:
    """The triplet ten times as large: one lens by both ways, at low frequencies, where they agree."""
    large = lens_data(pixsim.load_lens("cooke_triplet").scaled(10.0), [550.0])
    assert large.geometric
    assert not triplet().geometric
    assert large.as_dict()["mtf_of"].startswith("rays")
    # Ten times the size at a tenth of the frequency: the same rays.
    small = triplet()
    rays = ray_spreads(small.lens, small.field_deg, np.array([550.0]), 1.0, np.array([0.0, 5.0]))[1][:, :, 1]
    waves = np.array([[line_mtf(psf.sum(axis=1 - axis), small.psf_pitch_um, np.array([5.0]))[0] for axis in (0, 1)]
                      for psf in small.psfs])  # fmt: skip
    assert np.abs(rays - waves).max() < 0.01
    assert (rays < 0.95).any()
    assert all(psf.sum() == pytest.approx(1.0, abs=0.05) for psf in large.psfs)


def test_mtf_beyond_the_limit_of_diffraction_is_nothing() -> None:
    """A pixel far smaller than the lens resolves: 1/(λN) is 364 lp/mm."""
    data = lens_data(triplet().lens, [550.0], 0.1)
    assert data.asked_lp_per_mm[-1] == 5000.0
    assert (data.mtf_at(5000.0) == 0).all()
    assert data.mtf_at(30.0) == pytest.approx(triplet().mtf_at(30.0), abs=2e-3)


def test_mtf_of_a_line_is_its_transform() -> None:
    """A Gaussian line of σ has the MTF exp(-2π²σ²f²)."""
    at_um = (np.arange(200) - 100) * 0.5
    frequency = np.linspace(0, 60, 7)
    found = line_mtf(np.exp(-(at_um**2) / (2 * 4.0**2)), 0.5, frequency)
    assert found == pytest.approx(np.exp(-2 * (np.pi * 4e-3 * frequency) ** 2), abs=1e-9)


def test_spot_points_fill_the_stop_evenly() -> None:
    """The mean of r² over a disc is 1/2."""
    x, y = spot_points()
    assert np.hypot(x, y).max() < 1
    assert np.mean(x**2 + y**2) == pytest.approx(0.5, abs=0.03)
    assert abs(x.mean()) < 1e-15


def test_numbers_are_those_of_the_lens() -> None:
    data = triplet()
    lens, content = data.lens, triplet().as_dict()
    for each in content["fields"]:
        chief = lens.chief_ray(each["field_deg"], 550.0)
        assert each["height_mm"] == pytest.approx(float(chief.height_mm), rel=1e-12)
        assert each["chief_ray_angle_deg"] == pytest.approx(float(chief.angle_deg), abs=1e-9)
        assert each["relative_illumination"] == pytest.approx(float(lens.relative_illumination(each["field_deg"])), rel=1e-9)
        assert [mtf["lp_per_mm"] for mtf in each["mtf"]] == [10.0, 30.0, 60.0, 125.0]
    # README of the reference values: .181 waves on the axis, chief ray at 18.99° unaimed and 19.3° aimed at 20°.
    assert content["fields"][0]["rms_wavefront_waves"] == pytest.approx(0.181, abs=0.01)
    assert content["fresnel_transmittance"] == pytest.approx(0.7058, abs=1e-3)


@pytest.mark.parametrize("name", ["triplet", "singlet", "double_gauss"])
def test_texts_of_figures_lie_inside_and_apart(name: str) -> None:
    """With labels of three digits and a sign, and of three decimals."""
    scale = {"singlet": 1.0, "double_gauss": 0.005}
    data = triplet() if name == "triplet" else lens_data(pixsim.load_lens(name).scaled(scale[name]), [486.1, 656.3])
    for plate in lens_plates(data):
        plate.figure.canvas.draw()
        width, height = plate.figure.canvas.get_width_height()
        inside = plate.figure.get_tightbbox().transformed(plate.figure.dpi_scale_trans)
        assert min(inside.x0, inside.y0) >= 0, plate.name
        assert inside.x1 <= width, plate.name
        assert inside.y1 <= height, plate.name
        labels = []
        for axes in plate.figure.axes:
            view = axes.get_window_extent().padded(1)
            for axis, side in ((axes.xaxis, "intervalx"), (axes.yaxis, "intervaly")):
                boxes = [label.get_window_extent() for label in axis.get_ticklabels() if label.get_text() and label.get_visible()]
                (low, high), middles = getattr(view, side), [np.mean(getattr(box, side)) for box in boxes]
                labels += [
                    box for box, middle in zip(boxes, middles, strict=True) if low <= middle <= high
                ]  # the others are not drawn
        assert len(labels) > 3
        for one, other in itertools.combinations(labels, 2):
            assert not one.overlaps(other), (plate.name, one, other)


def test_first_sentences_are_of_all_fields() -> None:
    """Not of those shown only: the smallest and the largest spot of the table, and the field of the lowest MTF."""
    data = triplet()
    said = {plate.name: plate.caption.partition(". ")[0] for plate in lens_plates(data)}
    rms = [spot.rms_um for spot in data.spots]
    least, most = int(np.argmin(rms)), int(np.argmax(rms))
    assert said["spots"].startswith(f"The spot is smallest at {data.field_deg[least]:.3g}° ({rms[least]:.3g} µm rms)")
    assert said["spots"].endswith(f"largest at {data.field_deg[most]:.3g}° ({rms[most]:.3g} µm rms)")
    ends = [data.frequency_lp_per_mm[np.argmax(mtf < 0.5)] for mtf in data.mtf.min(axis=1)]
    worst = int(np.argmin(ends))
    words = f"at {ends[0]:.3g} lp/mm on the axis, and earliest at {ends[worst]:.3g} lp/mm at {data.field_deg[worst]:.3g}°"
    assert said["mtf"] == f"The lower MTF falls to one half {words}"


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    folder = tmp_path_factory.mktemp("lens") / "out"
    code, out, err = command("lens double_gauss --pitch-um 5 --focal-length-mm 50 --f-number 8 --out", folder)
    assert code == 0, err
    return folder, out


def test_command_writes_page_figures_and_tables(page: tuple[Path, str]) -> None:
    folder, out = page
    content = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    primary = content["first_order"][[each["wavelength_nm"] for each in content["first_order"]].index(content["primary_nm"])]
    assert primary["focal_length_mm"] == pytest.approx(50.0, rel=1e-12)
    assert primary["f_number"] == pytest.approx(8.0, rel=1e-12)
    assert out.startswith("double_gauss: f = 50 mm, f/8, fields to 14°")
    assert f"report: {folder / 'report.html'}" in out
    elements = Elements(text_of(folder))
    assert not [link for link in elements.links if not link.startswith(("data:", "#"))]
    for name in FIGURES:
        assert (folder / f"figures/{name}.svg").stat().st_size > 1000
        head, *rows = (folder / f"figures/{name}.csv").read_text(encoding="utf-8").splitlines()
        assert rows, name
        assert all(len(row.split(",")) == len(head.split(",")) for row in rows), name
    text = text_of(folder)
    assert text.count("<img ") == text.count("alt=") == len(FIGURES)
    for glass in pixsim.load_lens("double_gauss").prescription.glasses:
        assert glass.name in text


@needs_browser
def test_page_fits_phone_and_desk(page: tuple[Path, str], tmp_path: Path) -> None:
    assert_fits(page[0] / "report.html", tmp_path)


def test_json_has_no_nan_and_options_change_the_lens(tmp_path: Path) -> None:
    """Also for a lens whose only field is the axis."""
    line = "lens singlet --object-distance-m 1 --field-deg 0 --wavelength-nm 500 --wavelength-nm 600 --json --out"
    code, out, err = command(line, tmp_path / "out")
    assert code == 0, err

    def refuse(constant: str) -> Any:
        raise AssertionError(constant)

    content = json.loads(out, parse_constant=refuse)
    assert content["object_distance_mm"] == 1000.0
    assert [each["field_deg"] for each in content["fields"]] == [0.0]
    assert [each["wavelength_nm"] for each in content["first_order"]] == [500.0, 600.0]
    focal = pixsim.load_lens("singlet").first_order(587.5618).focal_length_mm
    assert content["image_distance_mm"] == pytest.approx(47.67 + focal**2 / (1000 - focal), abs=1.0), "refocused"
