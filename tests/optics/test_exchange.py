"""Files of OpenEXR, NumPy and SPy read as irradiance on the sensor, or refused by their cause."""

import math
import re
import zipfile
from collections.abc import Callable
from pathlib import Path

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
from pixsim.light.foreign import parse_light_unit
from pixsim.light.spectral import OUTLIERS, RINGS, SpectralImage, bands_last_hint

CASES = Path(__file__).parents[1] / "data/cases"
CAMERA = pixsim.Camera(
    focal_length_mm=4.0, f_number=2.0, die_mm=0.05, object_distance_m=0.5, transmittance=0.9
)


def bits(values: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(values, np.float32).view(np.uint32)


# Files of pixsim


def test_files_read_back_bit_for_bit(tmp_path: Path) -> None:
    factors = light((2, 46)), light((2, 4, 5))
    header = {"luminance_cd_per_m2": 1000.0}
    image = SpectralImage(
        np.arange(370.0, 821.0, 10.0), 10.0, 1 / 3, factors=factors, header=header
    )
    pixsim.write_exr(tmp_path / "own.exr", image)
    assert pixsim.read_irradiance(tmp_path / "own.exr").digest() == image.digest()
    image.data.flat[:2] = 0.0, 1e-42
    pixsim.write_npz(tmp_path / "image.npz", image)
    back = pixsim.read_irradiance(tmp_path / "image.npz")
    assert np.array_equal(bits(back.data), bits(image.data))
    for field in ("wavelength_nm", "band_width_nm", "pitch_um"):
        assert np.array_equal(getattr(back, field), getattr(image, field)), field
    written = {"source": "image.npz", "units": UNIT, "pixsim": pixsim.__version__}
    assert back.header == written | header
    with pytest.raises(pixsim.PixsimError, match="output file: got"):
        pixsim.write_npz(tmp_path / "nowhere" / "image.npz", image)
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
    image = SpectralImage(NM, 10.0, 2.5, data=data, header={RINGS: True} if rings else {})
    pixsim.write_exr(tmp_path / "rings.exr", image)
    if not is_read:
        with pytest.raises(pixsim.PixsimError, match="row 1, column 2 of the band at 500 nm"):
            pixsim.read_irradiance(tmp_path / "rings.exr")
        with pytest.raises(pixsim.PixsimError, match="irradiance: got values from"):
            image.validate()
        return
    assert np.array_equal(bits(pixsim.read_irradiance(tmp_path / "rings.exr").data), bits(data))
    pixsim.write_npz(tmp_path / "rings.npz", image)
    assert np.array_equal(pixsim.read_irradiance(tmp_path / "rings.npz").data, np.maximum(data, 0))


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


def envi_text(path: Path, *changes: str, encoding: str = "utf-8") -> Path:
    """Write an ENVI file with changes `old|new` of its header; each must be there."""
    text = write_envi(path).read_text()
    for change in changes:
        old, _, new = change.partition("|")
        assert old in text, old
        text = text.replace(old, new)
    path.write_text(text, encoding)
    return path


CHANNELS = {
    "names of other renderers": stokes(light(), ("500.0nm", "Radiance.510nm", "520,0 nm")),
    "other units of names": stokes(light(), ("S0.0,50um", "S0.5.1E-7m", "S0.520000pm")),
    "without polarisation": stokes(light())
    | dict.fromkeys(("S1.500nm", "S3.500nm"), 0 * light()[..., 0]),
}
LAYOUTS = {
    **{
        kind: lambda path, kind=kind: write_light(kind, path / "a", light(), UNIT)
        for kind in ("exr", "npz", "hdr")
    },
    "from below": lambda path: write_exr(
        path / "a.exr", stokes(light()), emissiveUnits=UNIT, lineOrder=OpenEXR.DECREASING_Y
    ),
    "another origin": lambda path: write_exr(
        path / "a.exr",
        stokes(light()),
        emissiveUnits=UNIT,
        **dict.fromkeys(("dataWindow", "displayWindow"), tuple(np.int32([[-9, -9], [-5, -6]]))),
    ),
    **{
        name: lambda path, planes=planes: write_exr(path / "a.exr", planes, emissiveUnits=UNIT)
        for name, planes in CHANNELS.items()
    },
    "descending npz": lambda path: write_npz(
        path / "a.npz", data=light()[:, :, ::-1], wavelength_nm=NM[::-1], pitch_um=None
    ),
    "descending ENVI": lambda path: write_envi(
        path / "a.hdr", light()[:, :, ::-1], wavelength=NM[::-1]
    ),
    "angstroms": lambda path: write_envi(
        path / "a.hdr", wavelength=[5000.0, 5100.0, 5200.0], wavelength_units="Angstroms"
    ),
    "Latin-1": lambda path: envi_text(
        path / "a.hdr",
        *("Nanometers|µm", "500.0|0.5", "510.0|0.51", "520.0|0.52"),
        encoding="latin-1",
    ),
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
    image = pixsim.read_irradiance(LAYOUTS[name](tmp_path), pitch_um=2.5)
    assert np.array_equal(bits(image.data), bits(light()))
    check("wavelengths", image.wavelength_nm, NM, rtol=1e-15, why="decimal")
    assert image.band_width_nm.tolist() == [10, 10, 10]


def test_envi_without_byte_order_is_noted(tmp_path: Path) -> None:
    path = envi_text(tmp_path / "a.hdr", "byte order = 0\n|")
    with pytest.warns(UserWarning, match=r"'a\.hdr' states no byte order"):
        assert np.array_equal(pixsim.read_irradiance(path, pitch_um=1.0).data, light())


@pytest.mark.parametrize("kind", ["u1", "i2", "u8", "f2", "f8", ">f4"])
def test_numbers_of_any_type_are_read(kind: str, tmp_path: Path) -> None:
    values = np.arange(60).reshape(4, 5, 3)
    path = write_npz(tmp_path / "a.npz", data=values.astype(kind))
    assert np.array_equal(pixsim.read_irradiance(path).data, values)
    if kind in ("u1", "i2", "f8"):
        path = write_envi(tmp_path / "a.hdr", values.astype(kind))
        assert np.array_equal(pixsim.read_irradiance(path, pitch_um=1.0).data, values)


# Numbers of a file

UNEVEN = [400.0, 410.0, 430.0]
# A frequency is c/λ; 1000 nm sorts before 380 nm as text.
NAMED = stokes(
    light((3, 4, 5)),
    ("S0.1000nm", "S0.380,5nm", "S0.4,5E-7m", "S0.499654,0966666667GHz", "S0.0,7e-3mm"),
)
SCAN = np.arange(1, 13)
HANDWRITTEN = (
    "ENVI\ndescription = { Radiance }\nsamples = 3\nlines = 2\nbands = 2\nheader offset ="
    " 4\nfile type = ENVI Standard\ndata type = 4\ninterleave = bsq\nbyte order = 1\nwavelength"
    " units = Micrometers\nwavelength = { 0.5,\n 0.55 }\nfwhm = { 0.01, 0.02 }\ndata gain"
    " values = {1.0, 1.0}\nData Units = W m^-2 um^-1\npitch_um = 4\ndata ignore value = -9999\n"
)
# 16 buckets over 360-830 nm, three decimals: the channels that pbrt-v4's issue 310 lists.
PBRT_NM = np.round(360 + 470 * (np.arange(16) + 0.5) / 16, 3)
RADIANCE = light((2, 2, 16)).astype(np.float16)
FILM = dict.fromkeys("RGB", np.ones((2, 2), np.float16)) | stokes(
    RADIANCE, tuple("S0." + f"{nm:.3f}nm".replace(".", ",") for nm in PBRT_NM)
)
FAR = pixsim.Camera(f_number=4.0, object_distance_m=1e9, focal_length_mm=1000.0, die_mm=0.01)


def handwritten(folder: Path) -> Path:
    (folder / "scan.img").write_bytes(b"skip" + SCAN.astype(">f4").tobytes())
    (folder / "scan.hdr").write_text(HANDWRITTEN)
    return folder / "scan.hdr"


def own(path: Path, spectra: object = None, **content: object) -> Path:
    """Write a file of pixsim: data, or two factors of these spectra."""
    if spectra is not None:
        content["factors"] = spectra, np.ones((2, 4, 5))
    pixsim.write_exr(path, SpectralImage(NM, 10.0, 1.0, **content))
    return path


def npz(**fields: object) -> Callable[[Path], Path]:
    return lambda folder: write_npz(folder / "a.npz", **fields)


def exr(channels: dict[str, np.ndarray], **fields: object) -> Callable[[Path], Path]:
    return lambda folder: write_exr(folder / "a.exr", channels, **fields)


OF_UNIT = {"emissiveUnits": UNIT}
FREE = {"pitch_um": 2.5}
# name: file, options, attribute of the image, expected
NUMBERS: dict[str, tuple[Callable[[Path], Path], dict[str, object], str, object]] = {
    "widths halfway between neighbours": (npz(wavelength_nm=UNEVEN), {}, "band_width_nm", [10, 15, 20]),
    "a mean of -0.9 % of the largest": (lambda path: own(path / "a.exr", spectra=[[1.0, 1.0, 1.0], [0.0, -1.009, 0.0]]), {"pitch_um": 1.0}, "wavelength_nm", NM),
    "stated widths": (npz(wavelength_nm=UNEVEN, band_width_nm=[1, 2, 3.5]), {}, "band_width_nm", [1, 2, 3.5]),
    "descending widths": (npz(wavelength_nm=NM[::-1], band_width_nm=[3.0, 2.0, 1.0]), {}, "band_width_nm", [1, 2, 3]),
    "one width": (npz(band_width_nm=2), {}, "band_width_nm", [2, 2, 2]),
    "width of one band": (npz(data=light((4, 5, 1)), wavelength_nm=[633.0], band_width_nm=2), {}, "band_width_nm", [2]),
    "an attribute": (exr({"S0.633nm": light()[:, :, 0]}, **OF_UNIT, band_width_nm=2.0), FREE, "band_width_nm", [2]),
    **{
        f"fwhm {fwhm}": (lambda path, fwhm=fwhm: write_envi(path / "a.hdr", fwhm=[fwhm] * 3), FREE, "band_width_nm", [min(fwhm, 10.0)] * 3)
        for fwhm in (4.0, 9.95, 10.05, 25.0)
    },
    "unequal widths that adjoin": (lambda path: write_envi(path / "a.hdr", fwhm=[11.0, 9.0, 11.0]), FREE, "band_width_nm", [11, 9, 11]),
    "light is uniform in a band": (npz(), {}, "within", [np.array(NM)[:, None] + np.arange(-4.5, 5.0), np.full((3, 10), 0.1)]),
    "bands named by their edges": (lambda _: CASES / "17-exr-mitsuba06-names/names.exr", {"camera": CAMERA}, "wavelength_nm", 410.0 + 20 * np.arange(16)),
    "widths of these": (lambda _: CASES / "17-exr-mitsuba06-names/names.exr", {"camera": CAMERA}, "band_width_nm", np.full(16, 20.0)),
    "sorted names": (exr(NAMED, **OF_UNIT), FREE, "wavelength_nm", [380.5, 450.0, 600.0000000001, 700.0, 1000.0]),
    "bands of sorted names": (exr(NAMED, **OF_UNIT), FREE, "data", light((3, 4, 5))[:, :, [1, 2, 3, 4, 0]]),
    "values of a header by hand": (handwritten, {}, "data", 1e-3 * SCAN.reshape(2, 2, 3).transpose(1, 2, 0)),
    "its wavelengths": (handwritten, {}, "wavelength_nm", [500, 550]),
    "its widths": (handwritten, {}, "band_width_nm", [10, 20]),
    "its pitch": (handwritten, {}, "pitch_um", 4.0),
    "factors that cancel in a band": (lambda path: own(path / "a.exr", [[1.0, 1.0, 1.0], [0.0, -0.9, 0.0]]), {}, "data", np.tile([1.0, 0.1, 1.0], (4, 5, 1))),
    "a stated pitch": (npz(pitch_um=None), {"pitch_um": 7.0}, "pitch_um", 7.0),
    "pitch of the die": (npz(pitch_um=None), {"camera": CAMERA}, "pitch_um", 10.0),
    "irradiance needs no camera": (npz(pitch_um=None), {"camera": CAMERA}, "data", light()),
    "pitch of a file in float32": (exr(stokes(light()), **OF_UNIT, pitch_um=1.7), {}, "pitch_um", 1.7),
    "and of the die": (exr(stokes(light()), **OF_UNIT, pitch_um=1.7), {"camera": pixsim.Camera(die_mm=5 * 1.7e-3), "pitch_um": 1.7}, "pitch_um", 1.7),
    **{
        f"units of a {kind} file": (lambda path, kind=kind: write_light(kind, path / "a", light(), None), FREE | {"units": "mW/m^2/nm"}, "data", 1e-3 * light())
        for kind in ("exr", "npz", "hdr")
    },
    **{
        f"stated units complete {in_file}": (npz(units=in_file), {"units": stated}, "data", factor * light())
        for in_file, stated, factor in (("mW/m2/nm", "W m^-2 um^-1", 1e-3), ("DN", UNIT, 1.0), ("W.m^-2", UNIT, 1.0))
    },
    # All but on the axis: π/(4N²+1).
    "a film of pbrt is radiance per nm": (exr(FILM, emissiveUnits="W.m^-2.sr^-1"), {"camera": FAR}, "data", RADIANCE.astype(float) * (math.pi / 65)),
    "widths of its buckets": (exr(FILM, emissiveUnits="W.m^-2.sr^-1"), {"camera": FAR}, "band_width_nm", np.gradient(PBRT_NM)),
}  # fmt: skip


@pytest.mark.parametrize("name", NUMBERS)
def test_numbers_of_a_file(name: str, tmp_path: Path) -> None:
    make, options, attribute, expected = NUMBERS[name]
    image = pixsim.read_irradiance(make(tmp_path), **options)
    check(name, getattr(image, attribute), np.array(expected), rtol=1e-6, why="float32")


def test_few_wide_bands_are_noted() -> None:
    with pytest.warns(UserWarning, match="up to 100 nm: they represent 400-655 nm"):
        pixsim.read_irradiance(CASES / "20-exr-sparse/rgb3.exr", CAMERA)


# Radiance


def test_published_files_of_the_layout() -> None:
    """Of its authors, in the tests of colour-science: D65 in float16."""
    import colour

    folder = Path(colour.__file__).parent / "io" / "tests" / "resources"
    if not (folder / "D65.exr").is_file():
        pytest.skip("this colour-science has no test files")
    image = pixsim.read_irradiance(folder / "D65.exr", pixsim.Camera(f_number=1e3, die_mm=1e-3))
    expected = colour.SDS_ILLUMINANTS["D65"][image.wavelength_nm] / 100  # 560 nm is band 52
    check("D65", image.data[0, 0] / image.data[0, 0, 52], expected, rtol=2e-3, why="float16")
    assert set(image.band_width_nm) == {5.0}
    for name, words in (("Polarised", "polarised light"), ("BiSpectral", "reflectances")):
        with pytest.raises(pixsim.PixsimError, match=words):
            pixsim.read_irradiance(folder / f"{name}.exr")


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
    image = pixsim.read_irradiance(write_light(kind, tmp_path / "a", scale * data, units), camera)
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
        image = pixsim.read_irradiance(CASES / "18-exr-nan-inf/firefly.exr", camera)
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
            image = pixsim.read_irradiance(path, units=UNIT, pitch_um=1.0)
        except pixsim.PixsimError:
            continue
        assert np.array_equal(image.data, light())


# Files that are refused

WRONG_UNITS = (
    "lx,DN,Reflectance,uW/cm2*nm*sr,W/m2 nm,W//m^2,W/(m^2 nm,W/m^2 nm),W.m^-2.Hz^-1,J.m^-2,W^2.m^-6,"
    "W.m^-4,W.m^-3.sr,W.m^9999999999999999999,W.m^-2.nm^-1 twice,3 W.m^-3"
)


@pytest.mark.parametrize(
    "text", [*WRONG_UNITS.split(","), "(" * 5000, "W" * 5000, "W.m^" + "5" * 5000]
)
def test_units(text: str) -> None:
    with pytest.raises(
        pixsim.PixsimError, match=rf"units: got .*{len(text)} characters.*State them"
    ):
        parse_light_unit(text, typed=False)


def value_at(value: float) -> np.ndarray:
    data = light().astype(float)
    data[2, 3, 1] = value
    return data


def huge_npz(path: Path) -> Path:
    with zipfile.ZipFile(path, "w") as file:
        for name, shape in (("data", (1 << 20, 1 << 20, 3)), ("wavelength_nm", (3,))):
            with file.open(f"{name}.npy", "w") as member:
                header = {"descr": "<f4", "fortran_order": False, "shape": shape}
                np.lib.format.write_array_header_1_0(member, header)
    return path


START, END, WIDE = (np.array(corner, np.int32) for corner in ([0, 0], [4, 3], [9, 3]))
DARK = np.zeros((4, 5), np.float32)
ANY_PITCH = {"pitch_um": None}
# name, writer of a file with this ending, options of the reader, words
LIGHT = [
    *((kind, f".{kind}", lambda path, kind=kind: write_light(kind, path.with_suffix(""), light(), None), {}, "none in the file") for kind in ("exr", "npz", "hdr")),
    ("other units", ".npz", lambda path: write_npz(path, units="mW/m2/nm"), {"units": UNIT}, "the same unit"),
    ("other kind", ".npz", lambda path: write_npz(path, units="mW/m2/nm"), {"units": "W/m2/sr/nm", "camera": CAMERA}, "the same unit"),
    ("per area", ".npz", lambda path: write_npz(path, units="W.m^-2.sr^-1"), {}, "not per wavelength"),
    ("flux", ".exr", lambda path: write_exr(path, stokes(light()), emissiveUnits="W.m^-2"), {}, "not per wavelength"),
    ("radiance", ".npz", lambda path: write_npz(path, units="W/m2/sr/nm"), {}, "without a camera"),
    ("own units", ".exr", lambda path: own(path, data=light()), {"units": "W.m^-2.um^-1", **ANY_PITCH}, "the same unit"),
    ("own pitch", ".exr", lambda path: own(path, data=light()), {}, "1 µm by the file, 2.5 µm by pitch_um"),
    ("own black", ".exr", lambda path: own(path, data=0 * light()), ANY_PITCH, "a black picture"),
    ("own NaN", ".exr", lambda path: own(path, data=value_at(np.nan)), ANY_PITCH, "nan at row 2, column 3 of the band at 510 nm"),
    ("own factors", ".exr", lambda path: own(path, spectra=[[1.0, 1.0, 1.0], [0.0, -1.011, 0.0]]), ANY_PITCH, "mean of -0.011 W/m²/nm in the band at 510 nm"),
    ("twice", ".exr", lambda path: write_exr(path, stokes(light(), ("S0.0,55um", "S0.550,0nm")), emissiveUnits=UNIT), {}, "550.0, 550.0 nm for 2 bands"),
    ("polarised", ".exr", lambda path: write_exr(path, stokes(light()) | {"S2.500nm": DARK - 1}, emissiveUnits=UNIT), {}, "polarised light"),
    ("reflectance", ".exr", lambda path: write_exr(path, {"T.500nm": DARK + 1}, emissiveUnits=UNIT), {}, "reflectances"),
    ("RGB", ".exr", lambda path: write_exr(path, dict.fromkeys("RGB", DARK + 1)), {}, "RGB is not a spectrum"),
    ("layers", ".exr", lambda path: write_exr(path, {f"layer.{index:02}": DARK for index in range(40)}), {}, "layer.11 …"),
    ("crop", ".exr", lambda path: write_exr(path, stokes(light()), dataWindow=(START, END), displayWindow=(START, WIDE)), {}, "a crop"),
    ("oblong", ".exr", lambda path: write_exr(path, stokes(light()), pixelAspectRatio=2.0), {}, "non-square pixels"),
    *((f"{nm} nm", ".npz", lambda path, nm=nm: write_npz(path, wavelength_nm=nm), {}, "nm for 3 bands")
      for nm in ([500, 510], [520, 500, 510], [500, 500, 510], [299, 510, 520], [500, 510, 1201], [500, 510, np.nan])),
    ("micrometres", ".npz", lambda path: write_npz(path, wavelength_nm=[0.5, 0.51, 0.52]), {}, "seem to be in µm"),
    ("nanometres", ".hdr", lambda path: write_envi(path, wavelength_units="Micrometers"), {}, "in nm, though the header says µm"),
    ("one band", ".npz", lambda path: write_npz(path, data=light((4, 5, 1)), wavelength_nm=[633.0]), {}, "none, for a single band"),
    *((f"widths {widths}", ".npz", lambda path, widths=widths: write_npz(path, band_width_nm=widths), {}, "band widths")
      for widths in ([1.0, 2.0], [1.0, 2.0, 0.0], [1.0, np.nan, 1.0], ["a", "b", "c"], [1.0, np.inf, 1.0])),
    ("no pitch", ".npz", lambda path: write_npz(path, pitch_um=None), ANY_PITCH, "none in the file"),
    ("two pitches", ".npz", lambda path: write_npz(path, pitch_um=None), {"pitch_um": 7.0, "camera": CAMERA}, r"10 µm by camera.die_mm / 5 columns, 7 µm .*die_mm = 0\.035 "),
    *((f"pitch {pitch}", ".npz", lambda path, pitch=pitch: write_npz(path, pitch_um=pitch), ANY_PITCH, "pitch_um of")
      for pitch in (0.0, -1.0, np.nan, "wide", [1.0, 2.0])),
    ("white", ".npz", lambda path: write_npz(path, white_cd_per_m2=-1.0), {}, "white_cd_per_m2 of"),
    *((f"value {value}", ".npz", lambda path, value=value: write_npz(path, data=value_at(value)), {}, rf"got {re.escape(str(value))} at row 2, column 3")
      for value in (np.nan, np.inf, -np.inf, -1e-30, 1e300)),
    ("black", ".npz", lambda path: write_npz(path, data=np.zeros((4, 5, 3))), {}, "a black picture"),
    *((f"array {index}", ".npz", lambda path, arrays=arrays: write_npz(path, **arrays), {}, "real numbers")
      for index, arrays in enumerate(({"data": np.ones((4, 5))}, {"data": np.ones((4, 5, 3), complex)}, {"data": np.full((4, 5, 3), "a")}, {"wavelength_nm": 500.0}))),
    ("no data", ".npz", lambda path: write_npz(path, data=None), {}, "got wavelength_nm, units, pitch_um"),
    ("another name", ".npz", lambda path: write_npz(path, pitch_mm=1.0), {}, "pitch_mm"),
    ("pickle", ".npz", lambda path: write_npz(path, units=np.array({}, object)), {}, "without pickled objects"),
    ("bands first", ".npz", lambda path: write_npz(path, data=np.ones((3, 8, 9))), {}, r"np\.moveaxis\(data, 0, 2\)"),
    ("bands in the middle", ".npz", lambda path: write_npz(path, data=np.ones((8, 3, 9))), {}, r"np\.moveaxis\(data, 1, 2\)"),
    ("huge npz", ".npz", huge_npz, {}, "more memory than is available"),
    ("huge ENVI", ".hdr", lambda path: envi_text(path, "lines = 4|lines = 1000000000"), {}, "60000000000 bytes, for 1000000000 × 5 × 3 values"),
    ("empty ENVI", ".hdr", lambda path: envi_text(path, "lines = 4|lines = 0"), {}, "0 × 5 × 3 values"),
    ("a PNG", ".png", lambda path: path, {}, "a name that ends in"),
    *((f"no {suffix}", suffix, lambda path: path, {}, "does not exist") for suffix in (".npz", ".hdr", ".exr")),
    *((f"{name} {value}", ".hdr", lambda path, name=name, value=value: write_envi(path, **{name: value}), {}, words)
      for name, value, words in (
          ("data_gain_values", [1, 2, 1], "'data gain values'"),
          ("data_offset_values", [0, 0, 0.5], "'data offset values'"),
          ("reflectance_scale_factor", 10000, "'reflectance scale factor'"),
          ("calibration_scale_factor", 0.1, "'calibration scale factor'"),
          ("bbl", [1, 0, 1], "'bbl'"),
          ("data_ignore_value", float(light()[1, 2, 0]), "no data .*row 1, column 2, band 0"),
          ("wavelength_units", "Unknown", "wavelength units .*Unknown"),
          ("wavelength_units", None, "wavelength units .*none"),
          ("wavelength", None, "without wavelength"),
          ("wavelength", ["a", "b", "c"], "ENVI header"),
          ("data_units", "Reflectance", "got .*11 characters"),
      )),
    *((change, ".hdr", lambda path, change=change: envi_text(path, change), {}, words)
      for change, words in (
          ("ENVI\n|#?RADIANCE\n", "an ENVI header"),
          ("interleave = bil|interleave = tiles", "interleave = tiles"),
          ("byte order = 0|byte order = 2", "byte order = 2"),
          ("data type = 4|data type = 6", "real numbers"),
          ("data type = 4|data type = 99", "an ENVI header"),
          ("lines = 4|lines = four", "an ENVI header"),
          ("bands = 3|", '"bands"'),
          ("lines = 4|lines = 40", "240 bytes in"),
      )),
]  # fmt: skip


@pytest.mark.parametrize(
    ("suffix", "write", "options", "words"),
    [row[1:] for row in LIGHT],
    ids=[str(row[0]) for row in LIGHT],
)
def test_light_is_refused_by_its_cause(
    suffix: str, write, options: dict[str, object], words: str, tmp_path: Path
) -> None:
    path = write(tmp_path / f"a{suffix}")
    with pytest.raises(pixsim.PixsimError, match=words) as caught:
        pixsim.read_irradiance(path, **{"pitch_um": 2.5} | options)
    assert path.name in str(caught.value)


@pytest.mark.parametrize("kind", ["exr", "npz", "raw"])
def test_truncated_light(kind: str, tmp_path: Path) -> None:
    path = write_light(kind, tmp_path / "a", light((32, 32, 3)), UNIT)
    whole = path.with_suffix(f".{kind}").read_bytes()
    for share in (0.0, 0.1, 0.5, 0.9, 0.99):
        path.with_suffix(f".{kind}").write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(pixsim.PixsimError, match=path.name):
            pixsim.read_irradiance(path, pitch_um=2.5)


def test_envi_without_its_raw_file_or_reader(tmp_path: Path, monkeypatch) -> None:
    path = write_envi(tmp_path / "a.hdr")
    (tmp_path / "a.raw").unlink()
    with pytest.raises(pixsim.PixsimError, match="raw file in the same folder"):
        pixsim.read_irradiance(path)
    monkeypatch.setitem(__import__("sys").modules, "spectral", None)
    with pytest.raises(pixsim.PixsimError, match="SPy is not installed"):
        pixsim.read_irradiance(path)


def test_no_axis_has_the_bands() -> None:
    assert bands_last_hint((4, 5, 6), 2) == ""
    assert bands_last_hint((2, 5, 2), 2) == "", "the last axis fits"
