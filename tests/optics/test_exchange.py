"""Files of OpenEXR, NumPy and SPy read as irradiance on the sensor; what is refused stands in
test_refusals.py.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest
from helpers.claims import check
from helpers.foreign_light import (
    NM,
    UNIT,
    light,
    stokes,
    write_envi,
    write_exr,
    write_light,
    write_npz,
)

import pixsim
from pixsim.base.errors import PixsimError
from pixsim.light.foreign import parse_light_unit
from pixsim.light.spectral import OUTLIERS, RINGS, SpectralImage
from pixsim.optics.exchange import read_irradiance

CASES = Path(__file__).parents[1] / "data/cases"
CAMERA = pixsim.Camera(
    focal_length_mm=4.0, f_number=2.0, die_mm=0.05, object_distance_m=0.5, transmittance=0.9
)


def bits(values: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(values, np.float32).view(np.uint32)


# Files of pixsim


def own_image(**header: object) -> SpectralImage:
    nm = np.arange(370.0, 821.0, 10.0)
    return SpectralImage(nm, 10.0, 1 / 3, factors=(light((2, 46)), light((2, 4, 5))), header=header)


def test_files_read_back_bit_for_bit(tmp_path: Path) -> None:
    image = own_image(luminance_cd_per_m2=1000.0)
    pixsim.write_exr(tmp_path / "own.exr", image)
    assert read_irradiance(tmp_path / "own.exr").digest() == image.digest()
    image.data.flat[:2] = 0.0, 1e-42
    pixsim.write_npz(tmp_path / "image.npz", image)
    back = read_irradiance(tmp_path / "image.npz")
    assert np.array_equal(bits(back.data), bits(image.data))
    for field in ("wavelength_nm", "band_width_nm", "pitch_um"):
        assert np.array_equal(getattr(back, field), getattr(image, field)), field
    written = {"source": "image.npz", "units": UNIT, "pixsim": pixsim.__version__}
    assert back.header == written | {"luminance_cd_per_m2": 1000.0}
    assert {path.name for path in tmp_path.iterdir()} == {"own.exr", "image.npz"}


@pytest.mark.parametrize(
    ("value", "rings", "is_read"),
    [(-0.3, True, True), (-0.3, False, False), (-2.0, True, False)],  # a spline rings by 1.5
)
def test_light_may_ring_before_the_blur_of_a_real_lens(
    value: float, rings: bool, is_read: bool, tmp_path: Path
) -> None:
    data = light()
    data[1, 2, 0] = value
    header = {RINGS: True} if rings else {}
    image = SpectralImage(NM, 10.0, 2.5, data=data, header=header)
    pixsim.write_exr(tmp_path / "rings.exr", image)
    if not is_read:
        with pytest.raises(PixsimError, match="row 1, column 2 of the band at 500 nm"):
            read_irradiance(tmp_path / "rings.exr")
        with pytest.raises(PixsimError, match="irradiance: got values from"):
            image.validate()
        return
    assert np.array_equal(bits(read_irradiance(tmp_path / "rings.exr").data), bits(data))
    pixsim.write_npz(tmp_path / "rings.npz", image)
    assert np.array_equal(read_irradiance(tmp_path / "rings.npz").data, np.maximum(data, 0))


# Units

# (factor, whether it is a radiance): spellings. The third radiance is of ENVI's radiometric
# calibration, the fourth of NERC-ARF.
SPELLINGS = {
    (1, False): (
        "W.m^-2.nm^-1,W m-2 nm-1,W/m2/nm,W·m⁻²·nm⁻¹,W*m**-2*nm**-1,W.m^{-2}.nm^{-1},kW m^-2 um^-1"
    ),
    (1e-3, False): "mW.m^-2.nm^-1",
    (1e-9, False): "W.m^-3",
    (1e-2, False): "uW.cm^-2.nm^-1",
    (1, True): "W.m^-2.sr^-1.nm^-1,W/(m^2 sr nm)",
    (1e-3, True): "W/(m2.sr.µm),W m^-2 sr^-1 um^-1",
    (1e-2, True): "uW/cm^2/SR/nm",
    (1e-5, True): "nW/(cm)^2/(nm)/(sr)",
    (1e-9, True): "W/m^3/sr",
}


@pytest.mark.parametrize(("key", "texts"), SPELLINGS.items())
def test_spellings_of_a_unit_have_one_factor(key: tuple[float, bool], texts: str) -> None:
    for text in texts.split(","):
        unit = parse_light_unit(text)
        assert (unit.factor, unit.radiance, unit.spectral) == (*key, True), text


# Layouts: each has the same cube


def envi_text(folder: Path, *changes: tuple[str, str], encoding: str = "utf-8") -> Path:
    path = write_envi(folder / "a.hdr")
    text = path.read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path.write_text(text, encoding)
    return path


MICRO = [("Nanometers", "µm"), ("500.0", "0.5"), ("510.0", "0.51"), ("520.0", "0.52")]
ANGSTROMS = {"wavelength": [5000.0, 5100.0, 5200.0], "wavelength_units": "Angstroms"}
OTHER_NAMES = ("500.0nm", "Radiance.510nm", "520,0 nm")
STOKES = ("S0.0,50um", "S0.5.1E-7m", "S0.520000pm")
LAYOUTS = {
    **{
        kind: lambda path, kind=kind: write_light(kind, path / "a", light(), UNIT)
        for kind in ("exr", "npz", "hdr")
    },
    "from below": lambda path: write_exr(
        path / "a.exr", stokes(light()), emissiveUnits=UNIT, lineOrder=OpenEXR.DECREASING_Y
    ),
    "names of other renderers": lambda path: write_exr(
        path / "a.exr", stokes(light(), OTHER_NAMES), emissiveUnits=UNIT
    ),
    "other units of names": lambda path: write_exr(
        path / "a.exr", stokes(light(), STOKES), emissiveUnits=UNIT
    ),
    "without polarisation": lambda path: write_exr(
        path / "a.exr",
        stokes(light()) | dict.fromkeys(("S1.500nm", "S3.500nm"), 0 * light()[..., 0]),
        emissiveUnits=UNIT,
    ),
    "descending npz": lambda path: write_npz(
        path / "a.npz", data=light()[:, :, ::-1], wavelength_nm=NM[::-1], pitch_um=None
    ),
    "descending ENVI": lambda path: write_envi(
        path / "a.hdr", light()[:, :, ::-1], wavelength=NM[::-1]
    ),
    "angstroms": lambda path: write_envi(path / "a.hdr", **ANGSTROMS),
    "Latin-1": lambda path: envi_text(path, *MICRO, encoding="latin-1"),
    **{
        f"{interleave} {order}": lambda path, order=order, interleave=interleave: write_envi(
            path / "a.hdr", light(), interleave, order
        )
        for interleave in ("bsq", "bil", "bip")
        for order in (0, 1)
    },
}


@pytest.mark.parametrize("name", LAYOUTS)
def test_layout_of_a_file_means_nothing(name: str, tmp_path: Path) -> None:
    image = read_irradiance(LAYOUTS[name](tmp_path), pitch_um=2.5)
    assert np.array_equal(bits(image.data), bits(light()))
    check("wavelengths", image.wavelength_nm, NM, rtol=1e-15, why="decimal")
    assert image.band_width_nm.tolist() == [10, 10, 10]


def test_envi_without_byte_order_is_noted(tmp_path: Path) -> None:
    path = envi_text(tmp_path, ("byte order = 0\n", ""))
    with pytest.warns(UserWarning, match=r"'a\.hdr' states no byte order"):
        assert np.array_equal(read_irradiance(path, pitch_um=1.0).data, light())


@pytest.mark.parametrize("kind", ["u1", "i2", "u8", "f2", "f8", ">f4"])
def test_numbers_of_any_type_are_read(kind: str, tmp_path: Path) -> None:
    values = np.arange(60).reshape(4, 5, 3)
    path = write_npz(tmp_path / "a.npz", data=values.astype(kind))
    assert np.array_equal(read_irradiance(path).data, values)
    if kind in ("u1", "i2", "f8"):
        path = write_envi(tmp_path / "a.hdr", values.astype(kind))
        assert np.array_equal(read_irradiance(path, pitch_um=1.0).data, values)


# Numbers of a file

UNEVEN = [400.0, 410.0, 430.0]
ONE = {"data": light((4, 5, 1)), "wavelength_nm": [633.0]}
LINE = {"S0.633nm": light()[:, :, 0]}
# A frequency is c/λ; 1000 nm sorts before 380 nm as text.
NAMES = ("S0.1000nm", "S0.380,5nm", "S0.4,5E-7m", "S0.499654,0966666667GHz", "S0.0,7e-3mm")
NAMED = stokes(light((3, 4, 5)), NAMES)
SCAN = np.arange(1, 13)
HANDWRITTEN = (
    "ENVI\ndescription = { Radiance }\nsamples = 3\nlines = 2\nbands = 2\nheader offset ="
    " 4\nfile type = ENVI Standard\ndata type = 4\ninterleave = bsq\nbyte order = 1\nwavelength"
    " units = Micrometers\nwavelength = { 0.5,\n 0.55 }\nfwhm = { 0.01, 0.02 }\ndata gain"
    " values = {1.0, 1.0}\nData Units = W m^-2 um^-1\npitch_um = 4\ndata ignore value = -9999\n"
)
# 16 buckets over 360-830 nm, three decimals: the channels that pbrt-v4's issue 310 lists.
PBRT = [f"{360 + 470 * (bucket + 0.5) / 16:.3f}".replace(".", ",") for bucket in range(16)]
RADIANCE = light((2, 2, 16)).astype(np.float16)
FILM = stokes(RADIANCE, tuple(f"S0.{nm}nm" for nm in PBRT))
FILM |= dict.fromkeys("RGB", np.ones((2, 2), np.float16))
FAR = pixsim.Camera(f_number=4.0, object_distance_m=1e9, focal_length_mm=1000.0, die_mm=0.01)
DIE = pixsim.Camera(die_mm=5 * 1.7e-3)
CANCELLING = [[1.0, 1.0, 1.0], [0.0, -0.9, 0.0]], np.ones((2, 4, 5))


def handwritten(folder: Path) -> Path:
    (folder / "scan.img").write_bytes(b"skip" + SCAN.astype(">f4").tobytes())
    (folder / "scan.hdr").write_text(HANDWRITTEN)
    return folder / "scan.hdr"


def own_exr(folder: Path) -> Path:
    pixsim.write_exr(folder / "a.exr", SpectralImage(NM, 10.0, 2.5, factors=CANCELLING))
    return folder / "a.exr"


def npz(**fields: object) -> Callable[[Path], Path]:
    return lambda folder: write_npz(folder / "a.npz", **fields)


def exr(channels: dict[str, np.ndarray], **fields: object) -> Callable[[Path], Path]:
    return lambda folder: write_exr(folder / "a.exr", channels, **fields)


def widths(image: SpectralImage) -> np.ndarray:
    return image.band_width_nm


def wavelengths(image: SpectralImage) -> np.ndarray:
    return image.wavelength_nm


def values(image: SpectralImage) -> np.ndarray:
    return image.data


def pitch(image: SpectralImage) -> float:
    return image.pitch_um


OF_UNIT = {"emissiveUnits": UNIT}
FREE = {"pitch_um": 2.5}
# name: file, options, number, expected
NUMBERS: dict[str, tuple[Callable[[Path], Path], dict[str, object], Callable[..., Any], Any]] = {
    "widths halfway between neighbours": (npz(wavelength_nm=UNEVEN), {}, widths, [10, 15, 20]),
    "stated widths": (npz(wavelength_nm=UNEVEN, band_width_nm=[1, 2, 3.5]), {}, widths, [1, 2, 3.5]),
    "descending widths": (npz(wavelength_nm=NM[::-1], band_width_nm=[3.0, 2.0, 1.0]), {}, widths, [1, 2, 3]),
    "one width": (npz(band_width_nm=2), {}, widths, [2, 2, 2]),
    "width of one band": (npz(**ONE, band_width_nm=2), {}, widths, [2]),
    "an attribute": (exr(LINE, **OF_UNIT, band_width_nm=2.0), FREE, widths, [2]),
    **{
        f"fwhm {fwhm}": (lambda path, fwhm=fwhm: write_envi(path / "a.hdr", fwhm=[fwhm] * 3), FREE, widths, [min(fwhm, 10.0)] * 3)
        for fwhm in (4.0, 9.95, 10.05, 25.0)
    },
    "bands named by their edges": (lambda _: CASES / "17-exr-mitsuba06-names/names.exr", {"camera": CAMERA}, wavelengths, 410.0 + 20 * np.arange(16)),
    "widths of these": (lambda _: CASES / "17-exr-mitsuba06-names/names.exr", {"camera": CAMERA}, widths, np.full(16, 20.0)),
    "sorted names": (exr(NAMED, **OF_UNIT), FREE, wavelengths, [380.5, 450.0, 600.0000000001, 700.0, 1000.0]),
    "bands of sorted names": (exr(NAMED, **OF_UNIT), FREE, values, light((3, 4, 5))[:, :, [1, 2, 3, 4, 0]]),
    "values of a header by hand": (handwritten, {}, values, 1e-3 * SCAN.reshape(2, 2, 3).transpose(1, 2, 0)),
    "its wavelengths": (handwritten, {}, wavelengths, [500, 550]),
    "its widths": (handwritten, {}, widths, [10, 20]),
    "its pitch": (handwritten, {}, pitch, 4.0),
    "factors that cancel in a band": (own_exr, {}, lambda image: image.band(1), np.full((4, 5), 0.1)),
    "a stated pitch": (npz(pitch_um=None), {"pitch_um": 7.0}, pitch, 7.0),
    "pitch of the die": (npz(pitch_um=None), {"camera": CAMERA}, pitch, 10.0),
    "irradiance needs no camera": (npz(pitch_um=None), {"camera": CAMERA}, values, light()),
    "pitch of a file in float32": (exr(stokes(light()), **OF_UNIT, pitch_um=1.7), {}, pitch, 1.7),
    "and of the die": (exr(stokes(light()), **OF_UNIT, pitch_um=1.7), {"camera": DIE, "pitch_um": 1.7}, pitch, 1.7),
    **{
        f"units of a {kind} file": (lambda path, kind=kind: write_light(kind, path / "a", light(), None), FREE | {"units": "mW/m^2/nm"}, values, 1e-3 * light())
        for kind in ("exr", "npz", "hdr")
    },
    **{
        f"stated units complete {in_file}": (npz(units=in_file), {"units": stated}, values, factor * light())
        for in_file, stated, factor in (("mW/m2/nm", "W m^-2 um^-1", 1e-3), ("DN", UNIT, 1.0), ("W.m^-2", UNIT, 1.0))
    },
    # All but on the axis: π/(4N²+1).
    "a film of pbrt is radiance per nm": (exr(FILM, emissiveUnits="W.m^-2.sr^-1"), {"camera": FAR}, values, RADIANCE.astype(float) * (math.pi / 65)),
    "widths of its buckets": (exr(FILM, emissiveUnits="W.m^-2.sr^-1"), {"camera": FAR}, lambda image: np.round(image.band_width_nm, 1), np.full(16, 29.4)),
}  # fmt: skip


@pytest.mark.parametrize("name", NUMBERS)
def test_numbers_of_a_file(name: str, tmp_path: Path) -> None:
    make, options, number, expected = NUMBERS[name]
    image = read_irradiance(make(tmp_path), **options)
    check(name, number(image), np.array(expected), rtol=1e-6, why="float32")


def test_few_wide_bands_are_noted() -> None:
    with pytest.warns(UserWarning, match=r"has 3 bands of up to 100 nm"):
        read_irradiance(CASES / "20-exr-sparse/rgb3.exr", CAMERA)


# Radiance


def test_published_files_of_the_layout() -> None:
    """Of its authors, in the tests of colour-science: D65 in float16."""
    import colour

    folder = Path(colour.__file__).parent / "io" / "tests" / "resources"
    if not (folder / "D65.exr").is_file():
        pytest.skip("this colour-science has no test files")
    image = read_irradiance(folder / "D65.exr", pixsim.Camera(f_number=1e3, die_mm=1e-3))
    expected = colour.SDS_ILLUMINANTS["D65"][image.wavelength_nm] / 100  # 560 nm is band 52
    relative = image.data[0, 0] / image.data[0, 0, 52]
    check("D65", relative, expected, rtol=2e-3, why="float16")
    assert set(image.band_width_nm) == {5.0}
    for name, words in (("Polarised", "polarised light"), ("BiSpectral", "reflectances")):
        with pytest.raises(PixsimError, match=words):
            read_irradiance(folder / f"{name}.exr")


@pytest.mark.parametrize(
    ("kind", "scale", "units"),
    [("exr", 1, "W.m^-2.sr^-1"), ("npz", 1e3, "W/m2/sr/um"), ("hdr", 100, "uW/cm^2/sr/nm")],
)
def test_radiance_becomes_irradiance(kind, scale, units, tmp_path: Path) -> None:
    """By Foote's formula at each sample, the pupil at v = f (1 + m) and its radius f/2N."""
    data = np.full((41, 81, 3), 2.0, np.float32)
    data[0, 0] = 4.0
    camera = pixsim.Camera(
        focal_length_mm=4.0, f_number=2.0, die_mm=6.0, object_distance_m=0.1, transmittance=0.9
    )
    image = read_irradiance(write_light(kind, tmp_path / "a", scale * data, units), camera)
    v_mm = 4.0 * (1 + 4.0 / 96.0)
    row, column = np.mgrid[:41, :81]
    tan2 = ((row - 20) ** 2 + (column - 40) ** 2) * (6.0 / 81 / v_mm) ** 2
    a = (4.0 / (2 * 2.0) / v_mm) ** 2
    root = np.sqrt(tan2**2 + 2 * tan2 * (1 - a) + (1 + a) ** 2)
    foote = math.pi / 2 * (1 - (1 + tan2 - a) / root)
    check("E", image.data, data * 0.9 * foote[..., None], rtol=5e-7, why="float32")
    assert image.pitch_um == pytest.approx(6e3 / 81, rel=1e-15)


# Values


def test_firefly_does_not_set_the_exposure() -> None:
    """With its neighbour's light in its place, the integration time is the same."""
    camera = pixsim.Camera(focal_length_mm=4.0, die_mm=0.2)
    with pytest.warns(UserWarning, match=r"isolated samples, .*\(row 3, column 4\)"):
        image = read_irradiance(CASES / "18-exr-nan-inf/firefly.exr", camera)
    data = image.data.copy()
    data[3, 4] = data[3, 5]
    plain = SpectralImage(image.wavelength_nm, image.band_width_nm, image.pitch_um, data=data)
    pixel = pixsim.Pixel(technology="4t-bsi", pitch_um=5.0)
    display = pixsim.Display(white_cd_per_m2=800)
    assert image.header[OUTLIERS] == [[3, 4]]
    times_s = [
        pixsim.evaluate(picture, camera, pixel, display=display).frame.integration_s
        for picture in (image, plain)
    ]
    assert times_s[0] == pytest.approx(times_s[1], rel=2e-3)  # cos⁴ of neighbours


def test_truncated_envi_header_is_refused_or_complete(tmp_path: Path) -> None:
    path = write_envi(tmp_path / "a.hdr", fwhm=[5.0] * 3)
    text = path.read_text()
    for end in range(0, len(text), 3):
        path.write_text(text[:end])
        try:
            image = read_irradiance(path, units=UNIT, pitch_um=1.0)
        except PixsimError:
            continue
        assert np.array_equal(image.data, light())
