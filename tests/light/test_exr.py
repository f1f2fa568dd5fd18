"""Files of spectral images: they come back bit for bit, other programs read them, and what is none
is refused.
"""

import json
import struct
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from helpers.claims import check

from pixsim import PixsimError, SpectralImage, read_exr, read_irradiance, write_exr
from pixsim.light import exr, spectral
from pixsim.scene.bands import band_edges_nm

BANDS_NM = np.arange(370.0, 821.0, 10.0)


def any_float32(shape: tuple[int, ...]) -> np.ndarray:
    """Return finite float32 values of all kinds: all exponents, denormals, both zeros, 1e30."""
    values = np.random.default_rng(0).integers(0, 2**32, shape, np.uint32).view(np.float32)
    values[~np.isfinite(values)] = 1e30
    values.flat[:4] = 0.0, -0.0, np.float32(1e-42), 1e30
    return values


def bits(values: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(values, np.float32).view(np.uint32)


def general(shape: tuple[int, int] = (5, 7), **options: object) -> SpectralImage:
    data = any_float32((*shape, BANDS_NM.size))
    options["header"] = {"seed": 7, "µ": [1.5, None]}
    return SpectralImage(BANDS_NM, 10.0, 2.65, data=data, **options)


def factored(shape: tuple[int, int] = (5, 7), **options: object) -> SpectralImage:
    spectra = np.random.default_rng(1).uniform(0, 1e-3, (2, BANDS_NM.size))
    factors = spectra, any_float32((2, *shape)) * np.float32(1e-6)
    return SpectralImage(BANDS_NM, 10.0, 1 / 3, factors=factors, **options)


def fine_bands(seed: int = 0) -> SpectralImage:
    """Return 10 nm bands that are randomly halved up to three times, with light within them."""
    rng = np.random.default_rng(seed)
    edges = band_edges_nm(spectral.VISIBLE)
    for _ in range(3):
        halved = np.flatnonzero(rng.random(edges.size - 1) < rng.uniform(0.1, 0.6))
        edges = np.sort(np.concatenate([edges, (edges[halved] + edges[halved + 1]) / 2]))
    width_nm = np.diff(edges)
    places = np.sort(rng.random((width_nm.size, 10)), axis=1)
    nodes_nm = edges[:-1, None] + width_nm[:, None] * places
    shares = rng.dirichlet(np.ones(10), width_nm.size)
    nm = (shares * nodes_nm).sum(axis=1)
    factors = rng.normal(0.3, 1, (8, width_nm.size)), rng.uniform(0, 1, (8, 3, 5))
    return SpectralImage(nm, width_nm, 2.65, factors=factors, within=(nodes_nm, shares))


IMAGES = {
    "bands": general,
    "factors": factored,
    "light within bands": lambda: general(
        within=(BANDS_NM[:, None] + np.linspace(-4, 4, 3), np.full((46, 3), 1 / 3))
    ),
    "a margin": lambda: factored((9, 8), margin=2),
    "fine bands": fine_bands,
    "other fine bands": lambda: fine_bands(1),
    "strides": lambda: SpectralImage(
        BANDS_NM, 10.0, 1.0, data=any_float32((12, 14, 92))[::-2, ::2, 1::2]
    ),
    "reduced": lambda: exr.reduced_to_fit(factored((4, 2048))),
    "two lines": lambda: SpectralImage([632.8, 1064.25], 0.1, 1.0, data=np.ones((1, 1, 2))),
}


@pytest.mark.parametrize("are_factors_only", [False, True])
@pytest.mark.parametrize("name", IMAGES)
def test_image_reads_back_bit_for_bit(name: str, are_factors_only: bool, tmp_path: Path) -> None:
    image = IMAGES[name]()
    write_exr(tmp_path / "image.exr", image, factors_only=are_factors_only)
    back = read_exr(tmp_path / "image.exr")
    assert np.array_equal(bits(back.whole.data), bits(image.whole.data))
    assert (back.factors is None) == (image.factors is None)
    if image.factors:
        assert np.array_equal(back.factors[0], image.factors[0])  # float64
        assert np.array_equal(bits(back.factors[1]), bits(image.factors[1]))
    for field in ("wavelength_nm", "band_width_nm", "within", "pitch_um", "header", "margin"):
        assert np.array_equal(getattr(back, field), getattr(image, field)), field


def test_channels_of_fine_bands_have_the_energy_of_all(tmp_path: Path) -> None:
    """At most one channel for each of 48 bands of 10 nm, beside the factors."""
    image = fine_bands(2)
    write_exr(tmp_path / "image.exr", image)
    channels, _ = exr.read_channels(tmp_path / "image.exr")
    merged = exr._merged(image)
    planes = [channels[exr._band_channel(nm)].astype(float) for nm in merged.wavelength_nm]
    assert len(channels) == len(planes) + 8 <= 48 + 8
    assert merged.band_width_nm.max() <= 10
    check("width", merged.band_width_nm.sum(), 470.0, rtol=1e-13, why="rounding")
    energy = np.tensordot(merged.band_width_nm, planes, 1)
    wanted = image.weighted(image.band_width_nm)
    check("energy", energy, wanted, atol=1e-5 * np.abs(wanted).max(), why="float32 of 8 terms")


@pytest.mark.parametrize("make", [general, factored, IMAGES["a margin"]])
def test_channels_have_fichets_layout(make, tmp_path: Path) -> None:
    """Read by the library of the format itself; a margin lies outside of the display window."""
    image = make()
    write_exr(tmp_path / "image.exr", image)
    names = [f"S0.{nm},000000nm" for nm in range(370, 821, 10)]
    rows, columns = image.whole.shape
    with OpenEXR.File(str(tmp_path / "image.exr"), separate_channels=True) as file:
        assert file.header()["spectralLayoutVersion"] == "1.0"
        assert file.header()["emissiveUnits"] == "W.m^-2.nm^-1"
        assert np.array_equal(
            file.header()["displayWindow"], [(0, 0), np.subtract(image.shape, 1)[::-1]]
        )
        planes = np.stack([file.channels()[name].pixels for name in names], axis=2)
        line_bytes = 8 + 4 * columns * len(file.channels())  # row and size, and the values
    assert np.array_equal(bits(planes), bits(image.whole.data))
    content = (tmp_path / "image.exr").read_bytes()
    line_at = len(content) - line_bytes * np.arange(rows, 0, -1)  # the lines end the file
    table = np.frombuffer(content[line_at[0] - 8 * rows : line_at[0]], "<u8")
    check("offsets of lines, by which other programs find them", table, line_at, why="exact")


@pytest.mark.parametrize("blocks", [1, 4, 5])
def test_block_size_does_not_change_bytes(blocks: int, tmp_path: Path, monkeypatch) -> None:
    image = factored((23, 7))
    write_exr(tmp_path / "whole.exr", image)
    lux = image.illuminance_lx()
    monkeypatch.setattr(exr, "BLOCK_BYTES", blocks * (8 + 48 * 7 * 4))
    monkeypatch.setattr(spectral, "STRIP_VALUES", blocks * 7 * 48)
    write_exr(tmp_path / "blocks.exr", image)
    assert (tmp_path / "blocks.exr").read_bytes() == (tmp_path / "whole.exr").read_bytes()
    assert np.array_equal(lux, image.illuminance_lx())


def test_too_many_band_bytes_become_illuminance(tmp_path: Path, monkeypatch) -> None:
    image = factored()
    monkeypatch.setattr(exr, "MAX_BAND_BYTES", 4 * 46 * 5 * 7)
    write_exr(tmp_path / "bands.exr", image)
    assert len(exr.read_header(tmp_path / "bands.exr")["channels"]) == 46 + 2
    monkeypatch.setattr(exr, "MAX_BAND_BYTES", 4 * 46 * 5 * 7 - 1)
    write_exr(tmp_path / "image.exr", image)
    channels, header = exr.read_channels(tmp_path / "image.exr")
    assert (sorted(channels), header["illuminanceUnits"]) == (["Y", "factor.0", "factor.1"], "lx")
    assert np.array_equal(channels["Y"], image.illuminance_lx().astype(np.float32))
    assert np.array_equal(bits(read_exr(tmp_path / "image.exr").data), bits(image.data))


def test_reduced_light_is_noted_when_read(tmp_path: Path) -> None:
    image = SpectralImage([550.0], 10.0, 2.0, data=np.ones((2, 2048, 1)))
    write_exr(tmp_path / "image.exr", exr.reduced_to_fit(image))
    with pytest.warns(UserWarning, match="means over 2 × 2 samples of the render"):
        assert read_irradiance(tmp_path / "image.exr").pitch_um == 4.0


HEADER = {"wavelength_nm": [550.0], "band_width_nm": [10.0], "pitch_um": 1.0, "header": {}}
IRRADIANCE = {"emissiveUnits": "W.m^-2.nm^-1"}
FOREIGN = {
    "no header": IRRADIANCE,
    "radiance": {"emissiveUnits": "W.m^-2.sr^-1.nm^-1", "pixsim": json.dumps(HEADER)},
    "torn": IRRADIANCE | {"pixsim": "{torn"},
    "half": IRRADIANCE | {"pixsim": json.dumps({"pitch_um": 1.0})},
    **{
        name: IRRADIANCE | {"pixsim": json.dumps(HEADER | entry)}
        for name, entry in {
            "no such channel": {"wavelength_nm": [560.0]},
            "no such factor": {"spectra_w_per_m2_nm": [[1.0]]},
            "two widths": {"band_width_nm": [10.0, 10.0]},
            "camera": {"header": {"camera": 1}},
            "scene": {"header": {"scene": 1}},
            "lamps": {"header": {"white_lamps": "sun"}},
            "plate": {"header": {"diffuser": [1]}},
            "dark plate": {"header": {"diffuser": {"distance_m": -1.0}}},
            "luminance": {"header": {"luminance_cd_per_m2": 0.0}},
            "finer": {"header": {"reduced": {"factor": 0.5, "samples": [4, 4]}}},
            "one sample": {"header": {"reduced": {"factor": 2}}},
            "no table": {"header": {"reduced": 7}},
        }.items()
    },
}


@pytest.mark.parametrize("name", FOREIGN)
def test_foreign_and_damaged_headers_are_refused(name: str, tmp_path: Path) -> None:
    exr.write_channels(tmp_path / "image.exr", {"S0.550,000000nm": np.ones((2, 2))}, FOREIGN[name])
    with pytest.raises(PixsimError, match=r"irradiance file: got '.*image\.exr'"):
        read_exr(tmp_path / "image.exr")


def test_interrupted_write_leaves_old_file(tmp_path: Path, monkeypatch) -> None:
    path = tmp_path / "image.exr"
    write_exr(path, factored())
    before = path.read_bytes()

    def full_disk(name: Path, *_: object) -> None:
        name.write_bytes(b"half")
        raise OSError("no space left on device")

    monkeypatch.setattr(exr, "write_rows", full_disk)
    with pytest.raises(PixsimError, match="no space left on device"):
        write_exr(path, general())
    assert (list(tmp_path.iterdir()), path.read_bytes()) == ([path], before)


EXR = struct.pack("<II", 20000630, 2)
ATTRIBUTE = b"a\0b\0" + bytes(4)


def header(*window: int, tile: int = 0) -> bytes:
    """Return the header of a file of two channels with a window of left, top, right and bottom."""
    channels = b"".join(struct.pack("<2siIii", name, 2, 0, 1, 1) for name in (b"a", b"b"))
    return struct.pack("<II", 20000630, 0x202 if tile else 2) + b"".join(
        struct.pack(f"<{len(name) + 1}s2sI", name.encode(), b"t", len(value)) + value
        for name, value in {
            "channels": channels + b"\0",
            "compression": b"\0",
            "dataWindow": struct.pack("<4i", *window),
            "tiles": struct.pack("<2IB", tile, tile, 0),
            "": b"",
        }.items()
    )


FILES = [
    ("no rows", header(5, 7, 9, 6), "5 × 0 values"),
    ("too wide", header(7, 1, 7 + (1 << 20), 1), "1048577 × 1 values"),
    ("much content", header(-4, 3, 8187, 4099), "268500992 bytes of content"),
    ("as much as is allowed", header(-4, 3, 8187, 4098), r"exr' \("),
    ("large tiles", header(0, 0, 9, 9, tile=5793), "tiles of 5793 × 5793"),
    ("and as large as is allowed", header(0, 0, 9, 9, tile=5792), r"exr' \("),
    ("no EXR", b"not an EXR", "does not start like"),
    ("damaged", EXR + b"\xff" * 400, "damaged"),
    ("cut", EXR + b"channels\0chlist\0", "damaged"),
    ("deep", struct.pack("<II", 20000630, 2 | 0x800) + b"\0", "deep"),
    ("no text", header(0, 0, 9, 9).replace(b"a\0\2", b"\xff\0\2"), "damaged header"),
    ("short", EXR + ATTRIBUTE[:4] + struct.pack("<I", 3) + b"\0\0", "'a' of 3 bytes"),
    ("many attributes", EXR + 4096 * ATTRIBUTE + b"\0", "more than 4096 attributes"),
    ("as many as are allowed", EXR + 4095 * ATTRIBUTE + b"\0", "without channels"),
    ("long name", EXR + 255 * b"a" + ATTRIBUTE + b"\0", "damaged header"),
    ("as long as is allowed", EXR + 254 * b"a" + ATTRIBUTE + b"\0", "without channels"),
    ("several parts", struct.pack("<II", 20000630, 2 | 0x1000) + b"\0", "parts"),
    ("no channels", EXR + b"\0", "without channels"),
    ("absent", None, "does not exist"),
]


@pytest.mark.parametrize(("name", "content", "words"), FILES)
def test_files_that_are_no_light(name: str, content, words: str, tmp_path: Path) -> None:
    if content is not None:
        (tmp_path / "image.exr").write_bytes(content)
    with pytest.raises(PixsimError, match=f"EXR file.*: got .*{words}"):
        read_exr(tmp_path / "image.exr")


@pytest.mark.parametrize("place", ["no/such/folder/image.exr", "a_file/image.exr", "a_folder"])
def test_paths_that_cannot_be_written_leave_files(place: str, tmp_path: Path) -> None:
    (tmp_path / "a_file").write_text("unchanged")
    (tmp_path / "a_folder").mkdir()
    with pytest.raises(PixsimError, match="output file: got"):
        write_exr(tmp_path / place, factored())
    assert sorted(tmp_path.rglob("*")) == [tmp_path / "a_file", tmp_path / "a_folder"]
    assert (tmp_path / "a_file").read_text() == "unchanged"
