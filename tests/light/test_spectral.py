"""Spectral images: bit-identical files, other readers of the files, and light units against
colour-science.
"""

from __future__ import annotations

import json
import struct
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest

import pixsim
from pixsim.base import mapped
from pixsim.base.errors import PixsimError
from pixsim.light import exr, spectral
from pixsim.light.exr import _merged, read_channels, read_header, reduced_to_fit, write_channels
from pixsim.light.spectral import VISIBLE, SpectralImage, Spectrum
from pixsim.optics.diffraction import diffract_sum
from pixsim.optics.exchange import read_irradiance
from pixsim.scene.bands import band_edges_nm
from pixsim.scene.mitsuba import import_mitsuba
from pixsim.scene.variants import variant

BANDS_NM = np.arange(370.0, 821.0, 10.0)
D65_TEXT = "S0.550,000000nm"
MIB = 1 << 20


def any_float32(shape: tuple[int, ...], seed: int = 0) -> np.ndarray:
    """Return finite float32 values of all kinds: all exponents, denormals, both zeros, 1e30."""
    bits = np.random.default_rng(seed).integers(0, 2**32, shape, np.uint32)
    values = bits.view(np.float32)
    values[~np.isfinite(values)] = 1e30
    values.flat[:4] = 0.0, -0.0, np.float32(1e-42), 1e30
    return values


def bits(values: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(values, np.float32).view(np.uint32)


def general(shape: tuple[int, int] = (5, 7)) -> SpectralImage:
    return SpectralImage(
        BANDS_NM,
        10.0,
        2.65,
        data=any_float32((*shape, BANDS_NM.size)),
        header={"seed": 7, "µ": [1.5, None]},
    )


def factored(shape: tuple[int, int] = (5, 7)) -> SpectralImage:
    spectra = np.random.default_rng(1).uniform(0, 1, (2, BANDS_NM.size)) * 1e-3
    return SpectralImage(
        BANDS_NM, 10.0, 1 / 3, factors=(spectra, any_float32((2, *shape)) * np.float32(1e-6))
    )


# --- Files ---


def assert_comes_back(image: SpectralImage, path: Path) -> None:
    """Check that an image is the same bit for bit after writing and reading."""
    pixsim.write_exr(path, image)
    back = pixsim.read_exr(path)
    assert np.array_equal(bits(back.data), bits(image.data))
    assert (back.factors is None) == (image.factors is None)
    if image.factors:
        assert np.array_equal(back.factors[0], image.factors[0])  # float64
        assert np.array_equal(bits(back.factors[1]), bits(image.factors[1]))
    for name in ("wavelength_nm", "band_width_nm", "within"):
        assert np.array_equal(getattr(back, name), getattr(image, name))
    assert (back.pitch_um, back.header) == (image.pitch_um, image.header)


@pytest.mark.parametrize("spread", [False, True])
@pytest.mark.parametrize("make", [general, factored])
def test_write_exr_image_reads_back_bit_for_bit(make, spread, tmp_path):
    image, rng = make(), np.random.default_rng(3)
    if spread:  # over its bands
        image.within = (
            image.wavelength_nm[:, None] + rng.uniform(-5, 5, (46, 3)),
            rng.dirichlet(np.ones(3), 46),
        )
    assert_comes_back(image, tmp_path / "image.exr")


def fine_bands(seed: int) -> SpectralImage:
    """Return an image with 10 nm bands that are randomly halved up to three times, and spectra of
    both signs.
    """
    rng = np.random.default_rng(seed)
    edges = band_edges_nm(VISIBLE)
    for _ in range(3):
        halved = np.flatnonzero(rng.random(edges.size - 1) < rng.uniform(0.1, 0.6))
        edges = np.sort(np.concatenate([edges, (edges[halved] + edges[halved + 1]) / 2]))
    width_nm = np.diff(edges)
    nodes_nm = edges[:-1, None] + width_nm[:, None] * np.sort(
        rng.random((width_nm.size, 10)), axis=1
    )
    shares = rng.dirichlet(np.ones(10), width_nm.size)
    factors = rng.normal(0.3, 1, (8, width_nm.size)), rng.uniform(0, 1, (8, 3, 5))
    return SpectralImage(
        (shares * nodes_nm).sum(axis=1), width_nm, 2.65, factors=factors, within=(nodes_nm, shares)
    )


@pytest.mark.parametrize("seed", range(12))
def test_write_exr_factors_with_fine_bands_read_back_bit_for_bit(seed, tmp_path):
    image = fine_bands(seed)
    assert image.band_width_nm.min() < 5
    assert image.band_width_nm.size > 60
    assert_comes_back(image, tmp_path / "image.exr")
    # For other readers: at most one channel for each of the 48 bands of 10 nm and less.
    channels, _ = read_channels(tmp_path / "image.exr")
    shown = {
        float(name[3:-2].replace(",", ".")): plane
        for name, plane in channels.items()
        if name.startswith("S0.")
    }
    assert len(shown) <= 48
    assert len(channels) == len(shown) + 8
    # Every band is in one channel: energies add up to those of all bands, and so do first moments
    # (float32 of 8 terms).
    merged = _merged(image)
    assert sorted(shown) == pytest.approx(merged.wavelength_nm.tolist(), abs=1e-6)
    assert merged.band_width_nm.max() <= 10
    assert merged.band_width_nm.sum() == pytest.approx(470, rel=1e-13)
    energy = sum(
        width * shown[nm].astype(float)
        for nm, width in zip(sorted(shown), merged.band_width_nm, strict=True)
    )
    np.testing.assert_allclose(
        energy, image.weighted(image.band_width_nm), atol=1e-5 * np.abs(energy).max()
    )


def test_merged_narrow_bands_are_means_over_10_nm():
    width_nm = np.array([5, 5, 2.5, 2.5, 1.25, 1.25, 2.5, 10, 15, 5, 5])
    nm = np.cumsum(width_nm) - width_nm / 2
    image = SpectralImage(nm, width_nm, 1.0, factors=(np.arange(11.0), np.ones((1, 1, 1))))
    merged = _merged(image)
    np.testing.assert_array_equal(merged.band_width_nm, [10, 10, 10, 15, 10])
    np.testing.assert_allclose(merged.wavelength_nm, [5, 15, 25, 37.5, 50], rtol=1e-14)
    middle = (2 * 2.5 + 3 * 2.5 + 4 * 1.25 + 5 * 1.25 + 6 * 2.5) / 10
    np.testing.assert_allclose(merged.factors[0][0], [0.5, middle, 7, 8, 9.5], rtol=1e-14)


@pytest.mark.parametrize("make", [general, factored])
def test_write_exr_channels_have_fichets_layout(make, tmp_path):
    image = make()
    pixsim.write_exr(tmp_path / "image.exr", image)
    with OpenEXR.File(str(tmp_path / "image.exr"), separate_channels=True) as file:
        header, channels = file.header(), file.channels()
        assert header["spectralLayoutVersion"] == "1.0"
        assert header["emissiveUnits"] == "W.m^-2.nm^-1"
        names = [name for name in channels if name.startswith("S0.")]
        assert names == [f"S0.{nm},000000nm" for nm in range(370, 821, 10)]
        assert np.array_equal(bits(channels[D65_TEXT].pixels), bits(image.data[:, :, 18]))
    pixsim.write_exr(
        tmp_path / "image.exr", SpectralImage([632.8, 1064.25], 0.1, 1.0, data=np.ones((1, 1, 2)))
    )
    assert sorted(read_header(tmp_path / "image.exr")["channels"]) == [
        "S0.1064,250000nm",
        "S0.632,800000nm",
    ]
    assert pixsim.read_exr(tmp_path / "image.exr").wavelength_nm.tolist() == [632.8, 1064.25]


@pytest.mark.parametrize("blocks", [1, 4, 5])
def test_write_exr_block_size_does_not_change_bytes(blocks, tmp_path, monkeypatch):
    image = factored((23, 7))
    pixsim.write_exr(tmp_path / "whole.exr", image)
    monkeypatch.setattr(exr, "BLOCK_BYTES", blocks * (8 + 48 * 7 * 4))
    monkeypatch.setattr(spectral, "STRIP_VALUES", blocks * 7 * 48)
    pixsim.write_exr(tmp_path / "blocks.exr", image)
    assert (tmp_path / "blocks.exr").read_bytes() == (tmp_path / "whole.exr").read_bytes()
    lux = image.illuminance_lx()
    monkeypatch.undo()
    assert np.array_equal(lux, image.illuminance_lx())
    assert np.array_equal(
        image.weighted_part(image.luminous_weight(), np.s_[3:17, 2:5]), lux[3:17, 2:5]
    )


@pytest.mark.parametrize("make", [general, factored])
def test_weighted_large_image_needs_memory_of_result_only(make, monkeypatch):
    monkeypatch.setattr(spectral, "STRIP_VALUES", 1 << 12)
    image = make((256, 256))
    weight = image.luminous_weight()
    tracemalloc.start()
    total = image.weighted(weight)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert total.nbytes < most < 1.3 * total.nbytes


def ramps(shape: tuple[int, int], bands: int = 2, factored: bool = False) -> SpectralImage:
    """Planes in x and y, of which the mean over any area is the value at its centre."""
    y, x = (np.arange(n) + 0.5 for n in shape)
    planes = np.stack([1 + x + 2 * y[:, None], 5 + 3 * x - y[:, None] / shape[0]]).astype(
        np.float32
    )
    nm = np.linspace(400, 700, bands)
    if factored:
        return SpectralImage(
            nm,
            5.0,
            2.0,
            factors=(np.linspace(1, 2, 2 * bands).reshape(2, bands), planes),
            header={"seed": 1},
        )
    return SpectralImage(
        nm, 5.0, 2.0, data=planes[np.arange(bands) % 2].transpose(1, 2, 0), header={"seed": 1}
    )


@pytest.mark.parametrize("factored", [False, True])
@pytest.mark.parametrize(
    ("shape", "columns"), [((12, 18), 6), ((12, 18), 7), ((13, 17), 5), ((64, 64), 64), ((9, 5), 1)]
)
def test_box_reduced_plane_keeps_centres(shape, columns, factored):
    """A plane stays a plane; the die's width and centre stay, and less than a sample of its height
    is cut off.
    """
    image = ramps(shape, factored=factored)
    reduced = image.box_reduced(columns)
    rows, ratio = reduced.shape[0], shape[1] / columns
    assert reduced.shape[1] == columns
    assert reduced.pitch_um * columns == pytest.approx(image.pitch_um * shape[1], rel=1e-12)
    assert 0 <= shape[0] - rows * ratio < ratio * (1 + 1e-9)
    x, y = (
        (np.arange(columns) + 0.5) * ratio,
        shape[0] / 2 + (np.arange(rows)[:, None] + 0.5 - rows / 2) * ratio,
    )
    planes = reduced.factors[1] if factored else reduced.data.transpose(2, 0, 1)
    for plane, expected in zip(planes, (1 + x + 2 * y, 5 + 3 * x - y / shape[0]), strict=True):
        # Values are constant in each sample: an area with parts of samples errs by up to a quarter
        # of a step of 3.
        assert plane == pytest.approx(
            expected, rel=1e-6, abs=0 if ratio.is_integer() else 0.75 / ratio
        )
    assert reduced.header == {
        "seed": 1,
        "reduced": {"samples": list(shape), "factor": pytest.approx(ratio)},
    }


@pytest.mark.parametrize(("shape", "columns"), [((12, 18), 6), ((14, 21), 6)])
def test_box_reduced_keeps_mean_and_range(shape, columns):
    """Where the height is a whole number of samples; noise of great contrast, so that no mean
    leaves the values' range.
    """
    values = np.random.default_rng(2).lognormal(0, 3, (*shape, 1)).astype(np.float32) * (
        np.arange(shape[1])[:, None] > 4
    )
    image = SpectralImage([550.0], 10.0, 1.0, data=values)
    reduced = image.box_reduced(columns)
    assert reduced.data.mean(dtype=float) == pytest.approx(values.mean(dtype=float), rel=1e-6)
    assert reduced.data.min() == 0


def test_box_reduced_twice_states_first_samples():
    twice = ramps((12, 24)).box_reduced(12).box_reduced(4)
    assert twice.header["reduced"] == {"samples": [12, 24], "factor": 6.0}
    assert twice.data == pytest.approx(ramps((12, 24)).box_reduced(4).data, rel=1e-6)


@pytest.mark.parametrize("columns", [0, 5, -1])
def test_box_reduced_other_columns_raise(columns):
    with pytest.raises(PixsimError, match="columns"):
        ramps((4, 4)).box_reduced(columns)


@pytest.mark.parametrize(
    ("shape", "bands", "columns"),
    [
        ((64, 64), 40, 64),  # fits: the same image
        ((4, 2048), 2, 1024),  # too wide
        ((30, 3000), 2, 1000),  # the largest number with whole samples in each mean
        ((80, 80), 2500, 40),  # 4 × 40² × 2500 bytes are 16 MB; 80² samples would take 64 MB
        ((101, 1999), 2, 970),  # prime: 49.01 rows
        ((1, 3000), 2, 3000),  # every coarser sampling would cut off the only row
        ((2, 3000), 2, 3000),
    ],
)
def test_reduced_to_fit_holds_limits(shape, bands, columns):
    image = ramps(shape, bands)
    reduced = reduced_to_fit(image)
    assert reduced.shape[1] == columns
    assert (reduced is image) == (columns == shape[1])
    rows = reduced.shape[0]
    assert 0.99 * shape[0] <= rows * shape[1] / columns <= shape[0] * (1 + 1e-9)
    if reduced is not image:
        assert columns <= 1024
        assert 4 * bands * rows * columns <= 60_000_000


def test_write_exr_reduced_reads_back_bit_for_bit(tmp_path):
    """With its header, and as a picture of the larger pitch."""
    for factored_too in (False, True):
        image = ramps((128, 2048), 20, factored_too)
        reduced = reduced_to_fit(image)
        assert reduced.pitch_um == 4.0
        assert_comes_back(reduced, tmp_path / "image.exr")
        with pytest.warns(UserWarning, match="means over 2 × 2 samples of the render, 4 µm wide"):
            again = read_irradiance(tmp_path / "image.exr")
        assert again.shape == (64, 1024)


def test_write_exr_factors_only_reads_back_bit_for_bit(tmp_path):
    image, path = ramps((30, 40), 20, factored=True), tmp_path / "image.exr"
    pixsim.write_exr(path, image, factors_only=True)
    back = pixsim.read_exr(path)
    assert set(read_channels(path)[0]) == {"factor.0", "factor.1"}
    assert np.array_equal(bits(back.data), bits(image.data))
    assert (back.pitch_um, back.header) == (image.pitch_um, image.header)


@pytest.mark.parametrize(
    "reduced",
    [{"factor": 0.5, "samples": [4, 4]}, {"factor": "2", "samples": [4, 4]}, {"factor": 2}, 7],
)
def test_read_exr_damaged_reduction_raises(reduced, tmp_path):
    image = ramps((4, 4))
    image.header["reduced"] = reduced
    pixsim.write_exr(tmp_path / "image.exr", image)
    with pytest.raises(PixsimError, match="damaged header"):
        pixsim.read_exr(tmp_path / "image.exr")


def test_write_exr_too_many_band_bytes_writes_illuminance(tmp_path, monkeypatch):
    image = factored()
    monkeypatch.setattr(exr, "MAX_BAND_BYTES", 4 * 46 * 5 * 7)
    pixsim.write_exr(tmp_path / "bands.exr", image)
    assert len(read_header(tmp_path / "bands.exr")["channels"]) == 46 + 2
    monkeypatch.setattr(exr, "MAX_BAND_BYTES", 4 * 46 * 5 * 7 - 1)
    assert_comes_back(image, tmp_path / "image.exr")
    channels, header = read_channels(tmp_path / "image.exr")
    assert sorted(channels) == ["Y", "factor.0", "factor.1"]
    assert header["illuminanceUnits"] == "lx"
    assert np.array_equal(channels["Y"], image.illuminance_lx().astype(np.float32))
    pixsim.write_exr(tmp_path / "general.exr", general())  # no other channel determines its bands
    assert len(read_header(tmp_path / "general.exr")["channels"]) == 46


@pytest.mark.parametrize("make", [general, factored])
def test_write_exr_file_is_read_by_mitsuba(make, tmp_path):
    image = make()
    pixsim.write_exr(tmp_path / "image.exr", image)
    variant.choose(None)
    bitmap = import_mitsuba("scalar_spectral").Bitmap(str(tmp_path / "image.exr"))
    names = [field.name for field in bitmap.struct_()]
    pixels = np.array(bitmap)
    for band, nm in enumerate(range(370, 821, 10)):
        assert np.array_equal(
            pixels[:, :, names.index(f"S0.{nm},000000nm")], image.data[:, :, band]
        )
    for number, picture in enumerate(image.factors[1] if image.factors else ()):
        assert np.array_equal(pixels[:, :, names.index(f"factor.{number}")], picture)


def test_write_exr_strided_arrays_are_written_correctly(tmp_path):
    whole = any_float32((12, 14, 2 * BANDS_NM.size))
    image = SpectralImage(BANDS_NM, 10.0, 1.0, data=whole[::-2, ::2, 1::2])
    pixsim.write_exr(tmp_path / "image.exr", image)
    assert np.array_equal(
        bits(pixsim.read_exr(tmp_path / "image.exr").data), bits(whole[::-2, ::2, 1::2])
    )
    plane = whole[:, :, 0].T[1:, ::3]
    write_channels(tmp_path / "plane.exr", {"Y": plane, "Z": plane.astype(float)[::-1]}, {})
    channels, _ = read_channels(tmp_path / "plane.exr")
    assert np.array_equal(bits(channels["Y"]), bits(plane))
    assert np.array_equal(bits(channels["Z"]), bits(plane[::-1]))


DAMAGED = struct.pack("<II", 20000630, 2) + b"\xff" * 400


@pytest.mark.parametrize(
    ("content", "got"),
    [(b"not an EXR", "not start like an EXR file"), (DAMAGED, "damaged"), (None, "does not exist")],
)
def test_read_exr_other_file_raises(tmp_path, content, got):
    if content:
        (tmp_path / "image.exr").write_bytes(content)
    with pytest.raises(PixsimError, match=rf"{got}.*; allowed: a readable OpenEXR file"):
        pixsim.read_exr(tmp_path / "image.exr")
    with pytest.raises(PixsimError, match="a folder; allowed: a readable OpenEXR file"):
        pixsim.read_exr(tmp_path)


OWN = {"wavelength_nm": [550.0], "band_width_nm": [10.0], "pitch_um": 1.0, "header": {}}


@pytest.mark.parametrize(
    "header",
    [
        {},
        {"emissiveUnits": "W.m^-2.nm^-1"},
        {"emissiveUnits": "W.m^-2.sr^-1.nm^-1", "pixsim": json.dumps(OWN)},
        {"emissiveUnits": "W.m^-2.nm^-1", "pixsim": "{torn"},
        {"emissiveUnits": "W.m^-2.nm^-1", "pixsim": json.dumps({"pitch_um": 1.0})},
        {"emissiveUnits": "W.m^-2.nm^-1", "pixsim": json.dumps(OWN | {"wavelength_nm": [560.0]})},
        {
            "emissiveUnits": "W.m^-2.nm^-1",
            "pixsim": json.dumps(OWN | {"spectra_w_per_m2_nm": [[1.0]]}),
        },
    ],
    ids=[
        "plain",
        "no header",
        "radiance",
        "torn header",
        "half a header",
        "no such channel",
        "no such factor",
    ],
)
def test_read_exr_foreign_header_raises(tmp_path, header):
    write_channels(tmp_path / "image.exr", {D65_TEXT: np.ones((2, 2))}, header)
    with pytest.raises(PixsimError, match=r"image\.exr"):
        pixsim.read_exr(tmp_path / "image.exr")


def test_read_exr_of_another_program_names_its_reader(tmp_path):
    write_channels(
        tmp_path / "image.exr",
        dict.fromkeys(("540nm", "550nm"), np.ones((2, 2))),
        {"emissiveUnits": "W.m^-2.nm^-1"},
    )
    with pytest.raises(
        PixsimError,
        match=r"no pixsim header.* pixsim\.read_irradiance reads light of another program",
    ):
        pixsim.read_exr(tmp_path / "image.exr")
    assert pixsim.read_irradiance(tmp_path / "image.exr", pitch_um=1.0).data.shape == (2, 2, 2)


@pytest.mark.parametrize("where", ["no/such/folder/image.exr", "a_file/image.exr", "a_folder"])
def test_write_exr_unwritable_path_raises_and_leaves_files(tmp_path, where):
    (tmp_path / "a_file").write_text("kept")
    (tmp_path / "a_folder").mkdir()
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(
        PixsimError,
        match=(
            r"output file: got '.*'( \(.*\); allowed: a path that can be written|, a folder;"
            r" allowed: a file)"
        ),
    ):
        pixsim.write_exr(tmp_path / where, general())
    assert sorted(tmp_path.rglob("*")) == before
    assert (tmp_path / "a_file").read_text() == "kept"


def test_write_exr_interrupted_leaves_old_file(tmp_path, monkeypatch):
    path = tmp_path / "image.exr"
    pixsim.write_exr(path, factored())
    before = path.read_bytes()

    def full_disk(name, *_):
        name.write_bytes(b"half")
        raise OSError("no space left on device")

    monkeypatch.setattr(exr, "write_rows", full_disk)
    with pytest.raises(PixsimError, match="no space left on device"):
        pixsim.write_exr(path, general())
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_write_exr_equal_images_give_equal_files(tmp_path):
    for name in ("a.exr", "b.exr"):
        pixsim.write_exr(tmp_path / name, general())
    assert (tmp_path / "a.exr").read_bytes() == (tmp_path / "b.exr").read_bytes()


# --- Light ---


def test_photometric_tables_match_cie():
    import colour

    nm = np.arange(360.0, 781.0)
    y_bar = (
        colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
        .copy()
        .align(colour.SpectralShape(360, 780, 1))
        .values[:, 1]
    )
    np.testing.assert_allclose(spectral.photopic_efficiency(nm), y_bar, rtol=1e-9)
    # CIE 15 tabulates D65 every 5 nm and prescribes linear interpolation.
    d65 = colour.SDS_ILLUMINANTS["D65"]
    np.testing.assert_allclose(spectral.d65(nm[::5]), d65[nm[::5]], rtol=1e-9)
    np.testing.assert_allclose(
        spectral.d65(nm), np.interp(nm, nm[::5], d65[nm[::5]]), rtol=1e-5
    )  # six digits
    assert spectral.d65(560.0) == 100
    assert spectral.d65(np.array([359.0, 831.0])).tolist() == [0, 0]
    assert spectral.photopic_efficiency(np.array([359.0, 831.0])).tolist() == [0, 0]


@pytest.mark.parametrize("name", ["E", "D65", "A"])
def test_illuminance_of_standard_lamps_matches_colour_science(name):
    import colour

    # colour-science sums at 1 nm, pixsim knows ten-nanometre means only.
    shape = colour.SpectralShape(365, 825, 1)
    lamp = colour.SDS_ILLUMINANTS[name].copy().align(shape, interpolator=colour.LinearInterpolator)
    edges = (lamp.values[:-1] + lamp.values[1:]) / 2
    image = SpectralImage(BANDS_NM, 10.0, 1.0, data=edges.reshape(46, 10).mean(axis=1)[None, None])
    # Measured 1 to 5e-5. ȳ shifted by 1 nm is .2 % off for D65 and .7 % for A, 683 instead of
    # 683.002 lm/W 3e-6.
    assert image.illuminance_lx()[0, 0] == pytest.approx(
        colour.colorimetry.luminous_flux(lamp), rel=1e-4
    )


def test_band_mean_uses_band_centre_by_default():
    centred = SpectralImage([550.0, 600.0], 10.0, 1.0, data=np.ones((1, 1, 2)))
    np.testing.assert_array_equal(centred.band_mean(lambda nm: nm**2), [550.0**2, 600.0**2])
    np.testing.assert_array_equal(
        centred.luminous_weight(), spectral.luminous_weight([550.0, 600.0], 10.0)
    )
    # Two lines of one to three in the first band, three in the second.
    nodes_nm, shares = (
        [[546.0, 553.0, 550.0], [596.0, 600.0, 604.0]],
        [[0.25, 0.75, 0.0], [0.25, 0.5, 0.25]],
    )
    image = SpectralImage(
        [550.0, 600.0], 10.0, 1.0, data=np.ones((1, 1, 2)), within=(nodes_nm, shares)
    )
    np.testing.assert_allclose(image.band_mean(lambda nm: nm), [551.25, 600], rtol=1e-15)
    np.testing.assert_allclose(
        image.band_mean(lambda nm: nm**2) - [551.25**2, 600**2], [49 * 3 / 16, 8], rtol=1e-9
    )


def test_illuminance_of_laser_is_683_lm_per_w():
    image = SpectralImage([555.0], 1.0, 1.0, data=np.full((2, 3, 1), 2.0))
    # 2 W/m² where the eye is best: 683 lm/W by the SI, for 555.016 nm in air.
    np.testing.assert_allclose(image.illuminance_lx(), np.full((2, 3), 2 * 683), rtol=1e-5)
    # Off the centre of its band: 2 W/m² in a band of 10 nm. CIE tabulates ȳ = .8849624 at 532 nm
    # and .8620 at 530 nm.
    data = np.full((1, 1, 1), 0.2)
    image = SpectralImage([530.0], 10.0, 1.0, data=data, within=([[532.0]], [[1.0]]))
    assert image.illuminance_lx()[0, 0] == pytest.approx(2 * 683.002 * 0.8849624, rel=1e-6)
    assert SpectralImage([530.0], 10.0, 1.0, data=data).illuminance_lx()[0, 0] == pytest.approx(
        2 * 683.002 * 0.862, rel=1e-6
    )


def test_photons_per_joule_matches_si_constants():
    import scipy.constants as si

    assert spectral.photons_per_joule(555.0) == pytest.approx(555e-9 / (si.h * si.c), rel=1e-15)
    # A lumen of 555 nm is 4.09e15 photons a second, as the handbooks have it.
    assert spectral.photons_per_joule(555.0) / 683 == pytest.approx(4.09e15, rel=1e-3)
    assert spectral.photons_per_joule([400, 800]) == pytest.approx(
        np.array([1, 2]) * spectral.photons_per_joule(400.0)
    )


def test_spectral_image_factors_equal_their_data():
    rng = np.random.default_rng(0)
    spectra, pictures = rng.uniform(0, 1, (3, BANDS_NM.size)), rng.uniform(0, 1, (3, 6, 9))
    image = SpectralImage(BANDS_NM, 10.0, 1.0, factors=(spectra, pictures))
    expected = np.einsum("rb,ryx->yxb", spectra, pictures)
    assert image.shape == (6, 9)
    np.testing.assert_allclose(image.data, expected, rtol=1e-6)  # float32
    weight = rng.uniform(0, 1, BANDS_NM.size)
    np.testing.assert_allclose(image.weighted(weight), expected @ weight, rtol=1e-6)
    whole = SpectralImage(BANDS_NM, 10.0, 1.0, data=expected)
    np.testing.assert_allclose(image.illuminance_lx(), whole.illuminance_lx(), rtol=1e-6)
    for item in (image, whole):
        np.testing.assert_allclose(item.mean_spectrum(), expected.mean(axis=(0, 1)), rtol=1e-6)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({}, "give either data or factors, not both or neither"),
        (
            {"data": np.ones((2, 2, 1)), "factors": (np.ones(1), np.ones((1, 2, 2)))},
            "not both or neither",
        ),
        (
            {"data": np.ones((2, 2))},
            r"data: got \(2, 2\); allowed: \(rows, columns, bands\), here \(H, W, 1\)",
        ),
        (
            {"data": np.ones((2, 2, 3))},
            r"data: got \(2, 2, 3\); allowed: \(rows, columns, bands\), here \(H, W, 1\)",
        ),
        (
            {"factors": (np.ones((2, 1)), np.ones((1, 2, 2)))},
            r"factors: got \(2, 1\) and \(1, 2, 2\)",
        ),
        (
            {"data": np.ones((2, 2, 1)), "pitch_um": 0.0},
            "pitch_um: got 0.0; allowed: a number above 0",
        ),
        (
            {"data": np.ones((2, 2, 1)), "band_width_nm": -1.0},
            "band_width_nm: got -1.0; .* above 0",
        ),
        *(
            ({"data": np.ones((2, 2, 1)), "wavelength_nm": [nm]}, "wavelength_nm: got .*above 0")
            for nm in (0.0, -550.0, np.nan)
        ),
        (
            {"data": np.ones((2, 2, 1)), "within": ([[550.0]], [[0.5, 0.5]])},
            r"within: got \(1, 1\) and \(1, 2\); .*\(B, n\)",
        ),
        (
            {"data": np.ones((2, 2, 1)), "within": ([[550.0], [560.0]], [[0.5], [0.5]])},
            r"within: got \(2, 1\) and \(2, 1\)",
        ),
    ],
)
def test_spectral_image_wrong_shapes_raise(arguments, message):
    with pytest.raises(PixsimError, match=message):
        SpectralImage(
            **{"wavelength_nm": [550.0], "band_width_nm": 10.0, "pitch_um": 1.0, **arguments}
        )


NO_TABLES = [
    ([], []),
    ([500], [1]),
    ([500, 400, 600], [1, 0, 0]),
    ([400, 500], [1, 2, 3]),
    ([400, np.nan], [1, 2]),
]
INFINITE = [([400, 500], [1.0, np.nan]), ([400, 500], [np.inf, 1.0])]


@pytest.mark.parametrize(("nodes", "values"), NO_TABLES + INFINITE)
def test_spectrum_invalid_table_raises(nodes, values):
    got = (
        "two nodes or more, in increasing order"
        if (nodes, values) in NO_TABLES
        else "NaN or infinity"
    )
    with pytest.raises(PixsimError, match=rf"spectrum: got .*{got}"):
        Spectrum(np.array(nodes, float), np.array(values, float))


@pytest.mark.parametrize("kind", ["factors", "data"])
def test_light_in_a_file_is_the_same_and_not_in_memory(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Twelve planes of 1 MiB: every sum over them holds at most two planes of float64 and the
    strips.
    """
    values = np.random.default_rng(1).random((12, 512, 512), np.float32)
    nm, spectra = np.linspace(450.0, 650.0, 12), np.random.default_rng(2).random((12, 12))
    images = []
    for most in (mapped.MAX_MEMORY_BYTES, MIB):
        monkeypatch.setattr(mapped, "MAX_MEMORY_BYTES", most)
        planes = mapped.zeros(values.shape, np.float32)
        planes[:] = values
        content: dict[str, Any] = (
            {"factors": (spectra, planes)}
            if kind == "factors"
            else {"data": np.moveaxis(planes, 0, 2)}
        )
        images.append(SpectralImage(nm, 20.0, 4.0, **content))
    weight, camera = np.linspace(1.0, 2.0, 12), pixsim.Camera()

    def sums(image: SpectralImage) -> list[np.ndarray]:
        image.validate()
        rate = diffract_sum(
            ((plane, weight) for plane in image.planes),
            image.shape,
            4.0,
            nm,
            camera.effective_f_number,
        )
        return [
            rate,
            image.weighted(weight),
            image.band(3),
            image.mean_spectrum(),
            image.box_reduced(64).planes,
        ]

    in_memory = sums(images[0])
    assert mapped.is_mapped(images[1].planes)
    tracemalloc.start()
    try:
        in_file = sums(images[1])
        peak_mib = tracemalloc.get_traced_memory()[1] / MIB
    finally:
        tracemalloc.stop()
    for one, other in zip(in_memory, in_file, strict=True):
        if one.shape == (12,):  # a mean over another order of the same numbers
            np.testing.assert_allclose(one, other, rtol=1e-12)
        else:
            np.testing.assert_array_equal(one, other)
    assert (
        4 < peak_mib < 10
    )  # two planes of 2 MiB, the results before them, tables; all planes in float64 would have 24
