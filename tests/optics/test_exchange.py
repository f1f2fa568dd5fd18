"""Files that OpenEXR, NumPy and SPy write, read as irradiance; ambiguous files are errors."""

from __future__ import annotations

import math
import zipfile
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from spectral.io import envi

import pixsim
from pixsim.base.errors import PixsimError
from pixsim.light.foreign import parse_light_unit
from pixsim.light.spectral import OUTLIERS, RINGS, SpectralImage, bands_last_hint, find_outliers
from pixsim.optics.exchange import read_irradiance

CASES = Path(__file__).parents[1] / "data/cases"
UNIT = "W.m^-2.nm^-1"
RADIANCE = "W.m^-2.sr^-1.nm^-1"
NM = [500.0, 510.0, 520.0]
CAMERA = pixsim.Camera(
    focal_length_mm=4.0, f_number=2.0, die_mm=0.05, object_distance_m=0.5, transmittance=0.9
)


def light(shape: tuple[int, ...] = (4, 5, 3), seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0.1, 1, shape).astype(np.float32)


def bits(values: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(values, np.float32).view(np.uint32)


def exr(path: Path, channels: dict[str, np.ndarray], **header: object) -> Path:
    top = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **header}
    with OpenEXR.File(
        top, {name: np.ascontiguousarray(plane) for name, plane in channels.items()}
    ) as file:
        file.write(str(path))
    return path


def stokes(
    data: np.ndarray, names: tuple[str, ...] = ("S0.500nm", "S0.510nm", "S0.520nm")
) -> dict[str, np.ndarray]:
    return {name: data[:, :, band] for band, name in enumerate(names)}


def npz(path: Path, **arrays: object) -> Path:
    given = {"data": light(), "wavelength_nm": NM, "units": UNIT, "pitch_um": 2.5} | arrays
    np.savez(path, **{name: value for name, value in given.items() if value is not None})
    return path


def cube(
    path: Path, data: np.ndarray, interleave: str = "bil", byte_order: int = 0, **fields: object
) -> Path:
    fields_of_file = {"wavelength": NM, "wavelength units": "Nanometers", "data units": UNIT} | {
        name.replace("_", " "): value for name, value in fields.items()
    }
    metadata = {name: value for name, value in fields_of_file.items() if value is not None}
    envi.save_image(
        str(path),
        data,
        dtype=data.dtype,
        interleave=interleave,
        byteorder=byte_order,
        metadata=metadata,
        ext="raw",
    )
    return path


def written(kind: str, path: Path, data: np.ndarray, units: str | None) -> Path:
    """Write a file of a format, without the pitch; `units` may be left out."""
    if kind == "exr":
        return exr(
            path.with_suffix(".exr"), stokes(data), **({"emissiveUnits": units} if units else {})
        )
    if kind == "npz":
        return npz(path.with_suffix(".npz"), data=data, units=units, pitch_um=None)
    return cube(path.with_suffix(".hdr"), data, data_units=units)


def refused(path: Path, *parts: str, **options: object) -> None:
    with pytest.raises(PixsimError) as caught:
        pixsim.read_irradiance(path, **{"pitch_um": 2.5, **options})
    assert all(part in str(caught.value) for part in (path.name, *parts)), caught.value
    assert "; allowed: " in str(caught.value)


# --- Files of pixsim ---


def own_image() -> SpectralImage:
    spectra, pictures = light((2, 46)), light((2, 4, 5))
    nm = np.arange(370.0, 821.0, 10.0)
    return SpectralImage(
        nm, 10.0, 1 / 3, factors=(spectra, pictures), header={"luminance_cd_per_m2": 1000.0}
    )


def test_read_irradiance_pixsim_exr_is_bit_identical(tmp_path):
    image = own_image()
    pixsim.write_exr(tmp_path / "own.exr", image)
    back = pixsim.read_irradiance(tmp_path / "own.exr")
    assert np.array_equal(bits(back.data), bits(image.data))
    assert np.array_equal(back.factors[0], image.factors[0])
    assert (back.pitch_um, back.header) == (image.pitch_um, image.header)
    refused(
        tmp_path / "own.exr",
        "W.m^-2.um^-1 stated",
        "the same unit",
        units="W.m^-2.um^-1",
        pitch_um=None,
    )
    refused(tmp_path / "own.exr", "0.333333333 µm by the file, 2.5 µm by pitch_um")
    dark = SpectralImage(NM, 10.0, 1.0, data=np.zeros((2, 2, 3)))
    pixsim.write_exr(tmp_path / "dark.exr", dark)
    refused(tmp_path / "dark.exr", "a black picture", pitch_um=None)
    dark.data[1, 0, 2] = np.nan
    pixsim.write_exr(tmp_path / "nan.exr", dark)
    refused(tmp_path / "nan.exr", "nan at row 1, column 0 of the band at 520 nm", pitch_um=None)


def test_write_npz_image_reads_back_bit_for_bit(tmp_path):
    image = own_image()
    image.data.flat[:3] = 0.0, 1e-42, 3e38
    pixsim.write_npz(tmp_path / "image.npz", image)
    with pytest.warns(UserWarning, match="isolated samples"):
        back = pixsim.read_irradiance(tmp_path / "image.npz")
    assert back.header.pop(OUTLIERS) == [[0, 0]]
    assert np.array_equal(bits(back.data), bits(image.data))
    assert np.array_equal(back.wavelength_nm, image.wavelength_nm)
    assert np.array_equal(back.band_width_nm, image.band_width_nm)
    assert back.pitch_um == image.pitch_um
    assert back.header == {
        "source": "image.npz",
        "units": UNIT,
        "pixsim": pixsim.__version__,
        "luminance_cd_per_m2": 1000.0,
    }
    assert [path.name for path in tmp_path.iterdir()] == ["image.npz"]
    with pytest.raises(
        PixsimError,
        match=r"output file: got '.*image\.npz' .*; allowed: a path that can be written",
    ):
        pixsim.write_npz(tmp_path / "nowhere" / "image.npz", image)


def test_light_that_rings_before_the_blur_of_a_real_lens_is_read_back_and_other_negative_light_is_refused(
    tmp_path,
):
    data = light()
    data[1, 2, 0] = -0.3
    image = SpectralImage(NM, 10.0, 2.5, data=data, header={RINGS: True})
    image.validate()
    pixsim.write_exr(tmp_path / "rings.exr", image)
    back = read_irradiance(tmp_path / "rings.exr")
    assert np.array_equal(bits(back.data), bits(data))
    back.validate()
    pixsim.write_npz(tmp_path / "rings.npz", image)
    assert np.array_equal(
        bits(read_irradiance(tmp_path / "rings.npz").data), bits(np.maximum(data, 0))
    )
    pixsim.write_exr(tmp_path / "plain.exr", SpectralImage(NM, 10.0, 2.5, data=data))
    refused(tmp_path / "plain.exr", " at row 1, column 2 of the band at 500 nm", pitch_um=None)
    data[1, 2, 0] = -2.0  # more than a spline rings
    deeper = SpectralImage(NM, 10.0, 2.5, data=data, header={RINGS: True})
    pixsim.write_exr(tmp_path / "deeper.exr", deeper)
    refused(
        tmp_path / "deeper.exr", "got -2.0 at row 1, column 2 of the band at 500 nm", pitch_um=None
    )
    with pytest.raises(
        PixsimError, match=r"irradiance: got values from -2 to .*; allowed: 0 or more"
    ):
        deeper.validate()


# --- Units ---


# (factor, whether it is a radiance): spellings. The fourth radiance is of ENVI's radiometric
# calibration, the sixth of NERC-ARF.
SPELLINGS = {
    (
        1,
        False,
    ): "W.m^-2.nm^-1,W m-2 nm-1,W/m2/nm,W·m⁻²·nm⁻¹,W*m**-2*nm**-1,W.m^{-2}.nm^{-1},kW m^-2 um^-1",
    (1e-3, False): "mW.m^-2.nm^-1",
    (1e-9, False): "W.m^-3",
    (1e-2, False): "uW.cm^-2.nm^-1",
    (1, True): "W.m^-2.sr^-1.nm^-1,W/(m^2 sr nm)",
    (1e-3, True): "W/(m2.sr.µm),W m^-2 sr^-1 um^-1",
    (1e-2, True): "uW/cm^2/SR/nm",
    (1e-5, True): "nW/(cm)^2/(nm)/(sr)",
    (1e-9, True): "W/m^3/sr",
}


@pytest.mark.parametrize(
    ("text", "key"), [(text, key) for key, texts in SPELLINGS.items() for text in texts.split(",")]
)
def test_parse_light_unit_spellings_have_equal_factor(text, key):
    unit = parse_light_unit(text)
    assert (unit.factor, unit.radiance, unit.spectral) == (*key, True)


WRONG = """lx,DN,Reflectance,uW/cm2*nm*sr,W/m2 nm,W//m^2,W/(m^2 nm,W/m^2 nm),W/m^2/nm),W.m^-2.Hz^-1,J.m^-2,W^2.m^-6,W^2.m^-3,\
W.m^-4,W.m^-3.sr,W.m^9999999999999999999"""


@pytest.mark.parametrize(
    "text",
    [
        *WRONG.split(","),
        "W.m^-2.nm^-1 twice",
        "3 W.m^-3",
        "(" * 5000,
        "W" * 5000,
        "W.m^" + "5" * 5000,
    ],
)
def test_parse_light_unit_other_text_raises(tmp_path, text):
    hint = 'State them: units="W.m^-2.nm^-1" in Python, --units W.m^-2.nm^-1 on the command line.'
    refused(
        npz(tmp_path / "a.npz", units=text),
        f"got a text of {len(text)} characters; allowed",
        "allowed: spectral irradiance or radiance, as",
        hint,
    )


@pytest.mark.parametrize("make", ["exr", "npz", "hdr"])
def test_read_irradiance_missing_units_raises(tmp_path, make):
    path = written(make, tmp_path / "a", light(), None)
    refused(path, "units of '", "none in the file", 'units="W.m^-2.nm^-1" in Python', "--units")
    back = pixsim.read_irradiance(path, pitch_um=2.5, units="mW/m^2/nm")
    np.testing.assert_allclose(back.data, 1e-3 * light(), rtol=1e-6)
    assert back.header["units"] == "mW/m^2/nm"


def test_read_irradiance_contradicting_units_raises(tmp_path):
    path = npz(tmp_path / "a.npz", units="mW/m2/nm")
    refused(
        path,
        "mW/m2/nm in the file, but W.m^-2.nm^-1 stated",
        "Leave units (--units) out",
        units=UNIT,
    )
    refused(path, "in the file", units="mW/m2/sr/nm", camera=CAMERA)
    same = pixsim.read_irradiance(path, units="W m^-2 um^-1")  # the same, spelled otherwise
    np.testing.assert_allclose(same.data, 1e-3 * light(), rtol=1e-6)
    # A unit that is not per wavelength may be completed, but stays a radiance; other text is
    # ignored.
    half = npz(tmp_path / "half.npz", units="W.m^-2.sr^-1", pitch_um=None)
    refused(
        half,
        "W.m^-2.sr^-1, which is not per wavelength",
        "State them",
        pitch_um=None,
        camera=pixsim.Camera(),
    )
    refused(half, "the same unit", pitch_um=None, camera=CAMERA, units=UNIT)
    spelled = pixsim.read_irradiance(half, pixsim.Camera(die_mm=0.0125), units="W.m^-2.sr^-1.um^-1")
    assert spelled.header["units"] == "W.m^-2.sr^-1.um^-1"
    assert (
        pixsim.read_irradiance(npz(tmp_path / "dn.npz", units="DN"), units=UNIT).header["units"]
        == UNIT
    )


# --- Fichet's layout ---

# 16 buckets over 360-830 nm, three decimals: the channels that pbrt-v4's issue 310 lists.
PBRT = [f"{360 + 470 * (bucket + 0.5) / 16:.3f}".replace(".", ",") for bucket in range(16)]
assert PBRT[:3] == ["374,688", "404,062", "433,438"]
assert PBRT[15] == "815,312"


def test_read_irradiance_pbrt_film_is_radiance_per_nm(tmp_path):
    radiance = light((2, 2, 16)).astype(np.float16)
    channels = stokes(radiance, tuple(f"S0.{nm}nm" for nm in PBRT)) | dict.fromkeys(
        "RGB", np.ones((2, 2), np.float16)
    )
    path = exr(
        tmp_path / "pbrt.exr", channels, spectralLayoutVersion="1.0", emissiveUnits="W.m^-2.sr^-1"
    )
    camera = pixsim.Camera(f_number=4.0, object_distance_m=1e9, focal_length_mm=1000.0, die_mm=0.01)
    image = pixsim.read_irradiance(path, camera)
    # Infinity focus, all but on axis: π/(4N²+1). Read per m it would be 1e-9 of it, per band 1/30;
    # half of it without π.
    np.testing.assert_allclose(image.data, radiance.astype(float) * (math.pi / 65), rtol=1e-6)
    assert image.pitch_um == 5.0
    assert image.wavelength_nm[0] == 374.688
    np.testing.assert_allclose(
        image.band_width_nm, 470 / 16, rtol=1e-4
    )  # names have three decimals
    assert image.band_width_nm.sum() == pytest.approx(470, rel=1e-4)
    assert image.header["camera"] == camera.model_dump()
    assert image.header["units"] == "W.m^-2.sr^-1"
    refused(path, "radiance (W.m^-2.sr^-1) without a camera", "--camera.f-number")
    refused(path, "W.m^-2.nm^-1 stated", units=UNIT, camera=camera, pitch_um=None)
    flux = exr(tmp_path / "flux.exr", channels, emissiveUnits="W.m^-2")  # not the layout's unit
    refused(flux, "W.m^-2, which is not per wavelength")


def test_read_spectral_exr_channel_names_give_sorted_wavelengths(tmp_path):
    # A frequency is c/λ; 1000 nm sorts before 380 nm as text.
    names = (
        "S0.1000nm",
        "S0.380,5nm",
        "S0.0,55um",
        "S0.4,5E-7m",
        "S0.6e2nm",
        "S0.499654,0966666667GHz",
        "S0.0,7e-3mm",
    )
    expected = [1000, 380.5, 550, 450, 600, 600.0000000001, 700]
    data = light((3, 4, 6))
    names, expected = names[:4] + names[5:], expected[:4] + expected[5:]
    image = pixsim.read_irradiance(
        exr(tmp_path / "a.exr", stokes(data, names), emissiveUnits=UNIT), pitch_um=1.0
    )
    order = np.argsort(expected)
    np.testing.assert_allclose(image.wavelength_nm, np.array(expected)[order], rtol=1e-12)
    assert {380.5, 450.0, 550.0, 700.0, 1000.0} < set(image.wavelength_nm)  # to the last bit
    assert np.array_equal(bits(image.data), bits(data[:, :, order]))
    doubled = exr(tmp_path / "b.exr", stokes(data, ("S0.0,55um", "S0.550,0nm")), emissiveUnits=UNIT)
    refused(doubled, "550.0, 550.0 nm for 2 bands", "increasing")


def test_read_spectral_exr_polarised_reflectance_or_rgb_raises(tmp_path):
    data, dark = light(), np.zeros((4, 5), np.float32)
    units = {"emissiveUnits": UNIT}
    zeros = dict.fromkeys(("S1.500nm", "S2.500nm", "S3.500nm"), dark)
    image = pixsim.read_irradiance(
        exr(tmp_path / "a.exr", stokes(data) | zeros | {"A": dark + 1}, **units), pitch_um=1.0
    )
    assert np.array_equal(bits(image.data), bits(data))
    refused(
        exr(tmp_path / "b.exr", stokes(data) | zeros | {"S2.500nm": dark - 1}, **units),
        "polarised light",
        "S2.500nm",
    )
    refused(
        exr(tmp_path / "c.exr", {"T.500nm": dark + 1, **stokes(data)}, **units),
        "reflectances",
        "T.500nm",
        "Render",
    )
    rgb = exr(tmp_path / "d.exr", dict.fromkeys("RGB", dark + 1), **units)
    refused(
        rgb,
        "the channels B, G, R",
        "S0.550,0nm",
        "RGB is not a spectrum",
        'Film "spectral"',
        "of a Mitsuba scene pixsim takes the XML",
    )
    many = exr(tmp_path / "e.exr", {f"layer.{index:02}": dark for index in range(40)})
    refused(many, "layer.11 … in")


def test_read_spectral_exr_crop_or_oblong_pixels_raise(tmp_path):
    def box(right: int) -> tuple[np.ndarray, np.ndarray]:
        return np.array([0, 0], np.int32), np.array([right, 3], np.int32)

    crop = exr(
        tmp_path / "a.exr",
        stokes(light()),
        emissiveUnits=UNIT,
        dataWindow=box(4),
        displayWindow=box(9),
    )
    refused(crop, "a crop", "a full image")
    oblong = exr(tmp_path / "b.exr", stokes(light()), emissiveUnits=UNIT, pixelAspectRatio=2.0)
    refused(oblong, "non-square pixels", "with square pixels")


def test_read_irradiance_published_files(tmp_path):
    """Files of Fichet et al. and of ART in colour-science's tests, if they are installed."""
    import colour

    folder = Path(colour.__file__).parent / "io" / "tests" / "resources"
    if not (folder / "D65.exr").is_file():
        pytest.skip("this colour-science has no test files")
    image = pixsim.read_irradiance(folder / "D65.exr", pixsim.Camera(f_number=1e3, die_mm=1e-3))
    relative = image.data[0, 0] / image.data[0, 0, 52]
    expected = colour.SDS_ILLUMINANTS["D65"][image.wavelength_nm] / 100  # 560 nm is band 52
    np.testing.assert_allclose(relative, expected, rtol=2e-3)  # float16
    assert set(image.band_width_nm) == {5.0}
    refused(folder / "Polarised.exr", "polarised light")
    refused(folder / "BiSpectral.exr", "reflectances")
    refused(folder / "CMS_Test_Pattern.exr", "RGB is not a spectrum")


# --- Radiance to irradiance ---


@pytest.mark.parametrize("make", ["exr", "npz", "hdr"])
def test_read_irradiance_radiance_becomes_irradiance(tmp_path, make):
    data = np.full((41, 81, 3), 2.0, np.float32)
    data[0, 0] = 4.0
    scale, units = {
        "exr": (1, "W.m^-2.sr^-1"),
        "npz": (1e3, "W/m2/sr/um"),
        "hdr": (100, "uW/cm^2/sr/nm"),
    }[make]
    camera = pixsim.Camera(
        focal_length_mm=4.0, f_number=2.0, die_mm=6.0, object_distance_m=0.1, transmittance=0.9
    )
    image = pixsim.read_irradiance(written(make, tmp_path / "a", scale * data, units), camera)
    m = 4.0 / (100.0 - 4.0)
    on_axis = 2 * 0.9 * math.pi / (1 + 4 * 2.0**2 * (1 + m) ** 2)
    # float32: 6e-8. Without |m| it is 8 % more, with π/(4N²) 6 % more.
    np.testing.assert_allclose(image.data[20, 40], on_axis, rtol=2e-7)
    pitch_mm, v_mm = 6.0 / 81, 4.0 * (1 + m)
    assert image.pitch_um == pytest.approx(1e3 * pitch_mm, rel=1e-15)
    for row, column, radiance in ((0, 0, 4.0), (40, 80, 2.0), (20, 80, 2.0)):
        tan2 = ((row - 20) ** 2 + (column - 40) ** 2) * (pitch_mm / v_mm) ** 2
        a = (4.0 / (2 * 2.0) / v_mm) ** 2
        root = math.sqrt(tan2**2 + 2 * tan2 * (1 - a) + (1 + a) ** 2)
        foote = math.pi / 2 * (1 - (1 + tan2 - a) / root)
        # cos⁴ instead of Foote is 2 % off in the corner, no fall-off a factor of 2.
        np.testing.assert_allclose(image.data[row, column], radiance * 0.9 * foote, rtol=5e-7)
    assert image.header["camera"]["transmittance"] == 0.9


def test_read_irradiance_with_camera_is_unchanged(tmp_path):
    image = pixsim.read_irradiance(npz(tmp_path / "a.npz", pitch_um=None), CAMERA)
    assert np.array_equal(bits(image.data), bits(light()))
    assert "camera" not in image.header


def test_read_irradiance_row_0_is_top(tmp_path):
    downwards = exr(
        tmp_path / "b.exr", stokes(light()), emissiveUnits=UNIT, lineOrder=OpenEXR.DECREASING_Y
    )
    for path in (
        downwards,
        *(written(kind, tmp_path / "a", light(), UNIT) for kind in ("npz", "hdr")),
    ):
        assert np.array_equal(bits(pixsim.read_irradiance(path, pitch_um=2.5).data), bits(light()))


def test_evaluate_irradiance_of_file_runs(tmp_path):
    nm = np.arange(400.0, 701.0, 10.0)
    shape = 64, 96, nm.size
    path = npz(
        tmp_path / "a.npz",
        data=light(shape),
        wavelength_nm=nm,
        units=RADIANCE,
        pitch_um=None,
        white_cd_per_m2=6e4,
    )
    camera = pixsim.Camera(die_mm=0.48)
    image = pixsim.read_irradiance(path, camera)
    assert image.pitch_um == 5.0
    score = pixsim.evaluate(image, camera, pixsim.Pixel(pitch_um=10.0))
    assert score.frame.dn.shape == (32, 48)
    assert 1 < score.mean_delta_e < 100  # of coarse pixels on noise of one sample


# --- Bands and pitch ---


def test_read_irradiance_band_widths(tmp_path):
    uneven = [400.0, 410.0, 430.0]
    cells = pixsim.read_irradiance(npz(tmp_path / "a.npz", wavelength_nm=uneven))
    assert cells.band_width_nm.tolist() == [10, 15, 20]  # edges 395, 405, 420, 440
    explicit = pixsim.read_irradiance(
        npz(tmp_path / "b.npz", wavelength_nm=uneven, band_width_nm=[1, 2, 3.5])
    )
    assert explicit.band_width_nm.tolist() == [1, 2, 3.5]
    nowhere = npz(
        tmp_path / "nan.npz", data=light((4, 5, 1)), wavelength_nm=[np.nan], band_width_nm=1.0
    )
    refused(nowhere, "nan nm for 1 bands")
    one = npz(tmp_path / "c.npz", data=light((4, 5, 1)), wavelength_nm=[633.0])
    refused(one, "none, for a single band", "band_width_nm", "fwhm")
    assert pixsim.read_irradiance(
        npz(one, data=light((4, 5, 1)), wavelength_nm=[633.0], band_width_nm=2)
    ).band_width_nm == [2]
    line = exr(
        tmp_path / "d.exr", {"S0.633nm": light()[:, :, 0]}, emissiveUnits=UNIT, band_width_nm=2.0
    )
    assert pixsim.read_irradiance(line, pitch_um=1.0).band_width_nm == [2]
    for widths in (
        [1.0, 2.0],
        [1.0, 2.0, 0.0],
        [1.0, np.nan, 1.0],
        ["a", "b", "c"],
        [1.0, np.inf, 1.0],
    ):
        refused(
            npz(tmp_path / "e.npz", band_width_nm=widths),
            "band widths",
            "one or 3 positive numbers, in nm",
        )


@pytest.mark.parametrize(
    "nm",
    [
        [500, 510],
        [520, 500, 510],
        [500, 500, 510],
        [299, 510, 520],
        [500, 510, 1201],
        [500, 510, np.nan],
    ],
)
def test_read_irradiance_invalid_wavelengths_raise(tmp_path, nm):
    got = ", ".join(str(float(item)) for item in nm)
    refused(
        npz(tmp_path / "a.npz", wavelength_nm=nm),
        f"{got} nm for 3 bands",
        "increasing, from 300 to 1200 nm",
        "Remove",
    )


def test_band_names_of_other_renderers(tmp_path):
    """Mitsuba 0.6 writes the edges of its bands; a plain wavelength is a centre."""
    image = pixsim.read_irradiance(CASES / "17-exr-mitsuba06-names/names.exr", CAMERA)
    assert image.wavelength_nm.tolist() == [410.0 + 20 * band for band in range(16)]
    assert image.band_width_nm.tolist() == [20.0] * 16
    same = exr(
        tmp_path / "a.exr",
        stokes(light(), ("500.0nm", "Radiance.510nm", "520,0 nm")),
        emissiveUnits=UNIT,
    )
    assert pixsim.read_irradiance(same, pitch_um=1.0).wavelength_nm.tolist() == NM
    other = exr(
        tmp_path / "b.exr", stokes(light(), ("band1", "band2", "band3")), emissiveUnits=UNIT
    )
    with pytest.raises(
        PixsimError, match=r"names such as S0\.550,0nm, 550nm or 540\.00-560\.00nm\.$"
    ):
        pixsim.read_irradiance(other, pitch_um=1.0)


def test_few_wide_bands_are_noted():
    with pytest.warns(UserWarning, match=r"has 3 bands of up to 100 nm: they stand for 400-655 nm"):
        pixsim.read_irradiance(CASES / "20-exr-sparse/rgb3.exr", CAMERA)


def test_outlier_of_one_sample_is_named_and_does_not_set_the_exposure():
    """The rest is uniform: the exposure is that of the picture without the outlier, but for its
    halo.
    """
    camera = pixsim.Camera(focal_length_mm=4.0, die_mm=0.2)
    with pytest.warns(
        UserWarning, match=r"isolated samples, more than 100 times all others \(row 3, column 4\)"
    ):
        image = pixsim.read_irradiance(CASES / "18-exr-nan-inf/firefly.exr", camera)
    pixel, display = (
        pixsim.Pixel(technology="4t-bsi", pitch_um=5.0),
        pixsim.Display(white_cd_per_m2=800),
    )
    found = pixsim.evaluate(image, camera, pixel, display=display).frame.integration_s
    data = image.data.copy()
    data[3, 4] = data[3, 5]
    header = {name: value for name, value in image.header.items() if name != OUTLIERS}
    clean = SpectralImage(
        image.wavelength_nm, image.band_width_nm, image.pitch_um, data=data, header=header
    )
    right = pixsim.evaluate(clean, camera, pixel, display=display).frame.integration_s
    assert found == pytest.approx(
        right, rel=2e-3
    )  # cos⁴ of neighbours; by the brightest pixel it was 2e-5 of it


def test_star_and_highlight_are_no_outliers():
    picture = np.zeros((40, 40))
    picture[3, 4] = 1.0
    assert find_outliers(picture) == []  # dark beside it
    picture += 1e-6
    picture[3, 5] = 0.5
    assert find_outliers(picture) == []  # a highlight of several samples
    picture[3, 5] = 1e-6
    assert find_outliers(picture) == [(3, 4)]


def test_factors_whose_sum_is_negative_are_refused(tmp_path):
    spectra, pictures = (
        np.array([[1.0, 1.0, 1.0], [0.0, -2.0, 0.0]]),
        np.full((2, 4, 5), 1.0, np.float32),
    )
    image = SpectralImage(NM, 10.0, 2.5, factors=(spectra, pictures))
    pixsim.write_exr(tmp_path / "a.exr", image)
    refused(tmp_path / "a.exr", "got a mean of -1 W/m²/nm in the band at 510 nm")
    small = SpectralImage(
        NM, 10.0, 2.5, factors=(np.array([[1.0, 1.0, 1.0], [0.0, -0.9, 0.0]]), pictures)
    )
    pixsim.write_exr(tmp_path / "b.exr", small)
    assert pixsim.read_irradiance(tmp_path / "b.exr").band(1)[0, 0] == pytest.approx(0.1, rel=1e-6)


def test_bands_in_descending_order_are_turned_round(tmp_path):
    data = light()
    path = npz(
        tmp_path / "a.npz",
        data=data[:, :, ::-1],
        wavelength_nm=NM[::-1],
        band_width_nm=[3.0, 2.0, 1.0],
    )
    image = pixsim.read_irradiance(path)
    assert (image.wavelength_nm.tolist(), image.band_width_nm.tolist()) == (NM, [1, 2, 3])
    assert np.array_equal(image.data, data)
    turned = cube(tmp_path / "b.hdr", data, wavelength=NM[::-1], fwhm=[8.0, 8.0, 8.0])
    assert np.array_equal(pixsim.read_irradiance(turned, pitch_um=1.0).data, data[:, :, ::-1])
    assert pixsim.read_irradiance(turned, pitch_um=1.0).band_width_nm.tolist() == [8, 8, 8]


def test_unit_that_wavelengths_seem_to_have_is_named(tmp_path):
    """In an npz, which states nm by a name, and in an ENVI header, whose label may be wrong."""
    refused(
        npz(tmp_path / "a.npz", wavelength_nm=[0.5, 0.51, 0.52]),
        "These seem to be in µm. Multiply wavelengths in µm by 1000",
    )
    label = {"wavelength_units": "Micrometers"}
    refused(
        cube(tmp_path / "b.hdr", light(), **label),
        "These seem to be in nm, though the header says µm",
    )
    right = cube(
        tmp_path / "c.hdr",
        light(),
        wavelength=[5000.0, 5100.0, 5200.0],
        wavelength_units="Angstroms",
    )
    assert pixsim.read_irradiance(right, pitch_um=1.0).wavelength_nm.tolist() == NM


def test_envi_header_without_byte_order_and_in_latin_1_is_read(tmp_path):
    path = cube(tmp_path / "a.hdr", light())
    text = path.read_text()
    path.write_text("".join(line for line in text.splitlines(True) if "byte order" not in line))
    with pytest.warns(UserWarning, match=r"'a\.hdr' states no byte order: it is read as 0"):
        image = pixsim.read_irradiance(path, pitch_um=1.0)
    assert np.array_equal(image.data, light())
    path.write_text(
        text.replace("Nanometers", "µm")
        .replace("500.0", "0.5")
        .replace("510.0", "0.51")
        .replace("520.0", "0.52"),
        "latin-1",
    )
    assert pixsim.read_irradiance(path, pitch_um=1.0).wavelength_nm.tolist() == NM


def test_read_irradiance_contradicting_pitch_raises(tmp_path):
    path = npz(tmp_path / "a.npz", pitch_um=None)
    refused(path, "none in the file", "Give pitch_um, or a camera", pitch_um=None)
    assert pixsim.read_irradiance(path, pitch_um=7.0).pitch_um == 7
    assert pixsim.read_irradiance(path, CAMERA).pitch_um == 10
    refused(
        path,
        "10 µm by camera.die_mm / 5 columns, 7 µm by pitch_um",
        "camera.die_mm = 0.035",
        pitch_um=7,
        camera=CAMERA,
    )
    pitched = npz(tmp_path / "b.npz", pitch_um=10.1)
    refused(pitched, "10.1 µm by the file", "--camera.die-mm 0.0505", pitch_um=None, camera=CAMERA)
    attribute = exr(
        tmp_path / "c.exr", stokes(light()), emissiveUnits=UNIT, pitch_um=1.7
    )  # a float32
    assert pixsim.read_irradiance(attribute).pitch_um == pytest.approx(1.7, rel=1e-7)
    exact = pixsim.Camera(die_mm=5 * 1.7e-3)
    assert pixsim.read_irradiance(attribute, exact, pitch_um=1.7).pitch_um == 1e3 * exact.die_mm / 5
    for pitch in (0.0, -1.0, np.nan, "wide", [1.0, 2.0]):
        refused(
            npz(tmp_path / "d.npz", pitch_um=pitch),
            "pitch_um of",
            "a positive number",
            pitch_um=None,
        )


def test_read_irradiance_white_is_in_header(tmp_path):
    image = pixsim.read_irradiance(npz(tmp_path / "a.npz", white_cd_per_m2=250))
    assert image.header["luminance_cd_per_m2"] == 250.0
    refused(
        npz(tmp_path / "b.npz", white_cd_per_m2=-1.0),
        "white_cd_per_m2 of",
        "-1",
        "a positive number",
    )


# --- Values and damage ---


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, -1e-30, 1e300])
def test_read_irradiance_invalid_value_raises_with_position(tmp_path, value):
    data = light().astype(float)
    data[2, 3, 1] = value
    refused(
        npz(tmp_path / "a.npz", data=data),
        f"got {value} at row 2, column 3 of the band at 510 nm",
        "0 to 3.4e+38",
    )
    refused(npz(tmp_path / "dark.npz", data=np.zeros((4, 5, 3))), "a black picture", "some light")


def test_read_npz_numeric_types_are_converted(tmp_path):
    for kind in (np.uint8, np.int16, np.uint64, np.float16, np.float64, ">f4"):
        data = np.arange(60).reshape(4, 5, 3).astype(kind)
        assert np.array_equal(
            pixsim.read_irradiance(npz(tmp_path / "a.npz", data=data)).data,
            np.arange(60).reshape(4, 5, 3),
        )


@pytest.mark.parametrize(
    "arrays",
    [
        {"data": np.ones((4, 5))},
        {"data": np.ones((4, 5, 3), complex)},
        {"data": np.full((4, 5, 3), "a")},
        {"wavelength_nm": 500.0},
    ],
)
def test_read_npz_wrong_arrays_raise(tmp_path, arrays):
    refused(
        npz(tmp_path / "a.npz", **arrays),
        "real numbers: data (rows, columns, bands) and wavelength_nm (bands,)",
    )


def test_read_npz_wrong_names_raise(tmp_path):
    listed = (
        "allowed: data, wavelength_nm, units; optional: band_width_nm, pitch_um, white_cd_per_m2"
    )
    refused(npz(tmp_path / "a.npz", data=None), "got wavelength_nm, units, pitch_um", listed)
    refused(npz(tmp_path / "b.npz", pitch_mm=1.0), "pitch_mm", listed)
    refused(
        npz(tmp_path / "c.npz", units=np.array({}, object)),
        "readable file from numpy.savez without pickled objects",
    )


def test_read_irradiance_absurd_size_raises(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as file:
        for name, shape in (("data", (1 << 20, 1 << 20, 3)), ("wavelength_nm", (3,))):
            with file.open(f"{name}.npy", "w") as member:
                np.lib.format.write_array_header_1_0(
                    member, {"descr": "<f4", "fortran_order": False, "shape": shape}
                )
    refused(tmp_path / "a.npz", "more memory than is available", "a readable file from numpy.savez")
    whole = exr(tmp_path / "b.exr", stokes(light()), emissiveUnits=UNIT).read_bytes()
    window = np.array([0, 0, 4, 3], "<i4").tobytes()
    assert whole.count(window) == 2  # of the data and of the display
    (tmp_path / "b.exr").write_bytes(
        whole.replace(window, np.array([0, 0, 99999, 99999], "<i4").tobytes())
    )
    refused(tmp_path / "b.exr", "100000 × 100000 × 3 values")
    cube(tmp_path / "c.hdr", light())
    text = (tmp_path / "c.hdr").read_text()
    (tmp_path / "c.hdr").write_text(text.replace("lines = 4", "lines = 1000000000"))
    refused(tmp_path / "c.hdr", "1000000000 × 5 × 3 values")
    (tmp_path / "c.hdr").write_text(text.replace("lines = 4", "lines = 0"))
    refused(tmp_path / "c.hdr", "0 × 5 × 3 values")


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9, 0.99])
@pytest.mark.parametrize("kind", ["exr", "npz", "raw"])
def test_read_irradiance_truncated_file_raises(tmp_path, kind, share):
    path = written(kind, tmp_path / "a", light((32, 32, 3)), UNIT)
    torn = path.with_suffix(f".{kind}")
    whole = torn.read_bytes()
    torn.write_bytes(whole[: int(share * len(whole))])
    refused(path)


def test_read_envi_truncated_header_raises_or_is_complete(tmp_path):
    path = cube(tmp_path / "a.hdr", light(), wavelength=NM, fwhm=[5.0] * 3)
    text = path.read_text()
    for end in range(len(text)):
        path.write_text(text[:end])
        try:
            image = pixsim.read_irradiance(path, units=UNIT, pitch_um=1.0)
        except PixsimError:
            continue
        assert np.array_equal(image.data, light())


@pytest.mark.parametrize("name", ["a.png", "nowhere.npz", "nowhere.hdr", "nowhere.exr"])
def test_read_irradiance_other_path_raises(tmp_path, name):
    refused(
        tmp_path / name,
        "a name that ends in .exr, .npz or .hdr" if name == "a.png" else "which does not exist",
    )


# --- ENVI ---


@pytest.mark.parametrize("interleave", ["bsq", "bil", "bip"])
@pytest.mark.parametrize("byte_order", [0, 1])
@pytest.mark.parametrize("kind", [np.uint8, np.int16, np.uint16, np.int32, np.float32, np.float64])
def test_read_envi_interleave_and_byte_order(tmp_path, interleave, byte_order, kind):
    data = np.arange(60).reshape(4, 5, 3).astype(kind)
    image = pixsim.read_irradiance(
        cube(tmp_path / "a.hdr", data, interleave, byte_order), pitch_um=1.0
    )
    assert np.array_equal(image.data, np.arange(60).reshape(4, 5, 3))
    assert image.wavelength_nm.tolist() == NM
    assert image.band_width_nm.tolist() == [10, 10, 10]


def test_read_envi_handwritten_header(tmp_path):
    (tmp_path / "scan.img").write_bytes(b"skip" + np.arange(1, 13, dtype=">f4").tobytes())
    (tmp_path / "scan.hdr").write_text(
        "ENVI\ndescription = { Radiance }\nsamples = 3\nlines = 2\nbands = 2\nheader offset ="
        " 4\nfile type = ENVI Standard\ndata type = 4\ninterleave = bsq\nbyte order = 1\nwavelength"
        " units = Micrometers\nwavelength = { 0.5,\n 0.55 }\nfwhm = { 0.01, 0.02 }\ndata gain"
        " values = {1.0, 1.0}\nData Units = W m^-2 um^-1\npitch_um = 4\ndata ignore value = -9999\n"
    )
    image = pixsim.read_irradiance(tmp_path / "scan.hdr")
    np.testing.assert_allclose(
        image.data, 1e-3 * np.arange(1, 13).reshape(2, 2, 3).transpose(1, 2, 0), rtol=1e-7
    )
    np.testing.assert_allclose(image.wavelength_nm, [500, 550], rtol=1e-15)
    np.testing.assert_allclose(image.band_width_nm, [10, 20], rtol=1e-15)
    assert image.pitch_um == 4
    assert image.header["units"] == "W m^-2 um^-1"


def test_read_envi_fwhm_of_overlapping_bands_is_ignored(tmp_path):
    for fwhm, width in ((4.0, 4.0), (9.95, 9.95), (10.0, 10.0), (10.05, 10.0), (25.0, 10.0)):
        image = pixsim.read_irradiance(
            cube(tmp_path / f"{fwhm}.hdr", light(), fwhm=[fwhm] * 3), pitch_um=1.0
        )
        assert image.band_width_nm.tolist() == [width] * 3


@pytest.mark.parametrize(
    ("fields", "parts"),
    [
        ({"data_gain_values": [1, 2, 1]}, ("'data gain values'", "Apply it")),
        ({"data_offset_values": [0, 0, 0.5]}, ("'data offset values'", "none, or 0 for each band")),
        (
            {"reflectance_scale_factor": 10000},
            ("'reflectance scale factor'", "10000", "none, or 1"),
        ),
        ({"calibration_scale_factor": 0.1}, ("'calibration scale factor'", "0.1")),
        ({"bbl": [1, 0, 1]}, ("'bbl'", "leave bad bands out")),
        (
            {"data_ignore_value": float(light()[1, 2, 0])},
            ("no data", "at row 1, column 2, band 0", "Fill the gaps"),
        ),
        (
            {"wavelength_units": "Unknown"},
            ("wavelength units", "Unknown", "Nanometers, Micrometers or Angstroms"),
        ),
        (
            {"wavelength_units": None},
            ("wavelength units", "got none", "Nanometers, Micrometers or Angstroms"),
        ),
        ({"wavelength": None}, ("without wavelength",)),
        ({"wavelength": ["a", "b", "c"]}, ("an ENVI header with its raw file in the same folder",)),
        ({"data_units": "Reflectance"}, ("got a text of 11 characters", "--units")),
    ],
)
def test_read_envi_scaling_fields_raise(tmp_path, fields, parts):
    refused(cube(tmp_path / "a.hdr", light(), **fields), *parts)


@pytest.mark.parametrize(
    ("old", "new", "part"),
    [
        ("ENVI\n", "#?RADIANCE\n", "an ENVI header"),
        ("interleave = bil", "interleave = tiles", "interleave = tiles"),
        ("byte order = 0", "byte order = 2", "byte order = 2"),
        ("data type = 4", "data type = 6", "real numbers"),
        ("data type = 4", "data type = 99", "an ENVI header"),
        ("lines = 4", "lines = four", "an ENVI header"),
        ("bands = 3", "", '"bands"'),
        ("lines = 4", "lines = 40", "240 bytes in"),
    ],
)
def test_read_envi_invalid_header_raises(tmp_path, old, new, part):
    path = cube(tmp_path / "a.hdr", light())
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    refused(path, part)


def test_read_envi_missing_raw_file_or_spy_raises(tmp_path, monkeypatch):
    path = cube(tmp_path / "a.hdr", light())
    (tmp_path / "a.raw").rename(tmp_path / "b.raw")
    refused(path, "an ENVI header with its raw file in the same folder")
    monkeypatch.setitem(__import__("sys").modules, "spectral", None)
    refused(path, "SPy is not installed", "pip install 'pixsim[envi]'")


@pytest.mark.parametrize(("shape", "axis"), [((3, 8, 9), 0), ((8, 3, 9), 1), ((3, 3, 9), 0)])
def test_cube_bands_not_last_raises_with_line_that_turns_it(shape, axis, tmp_path):
    """From a file and in Python; the line of the message works."""
    nm, data, path = np.array([450.0, 550.0, 650.0]), np.ones(shape), tmp_path / "cube.npz"
    more = {"wavelength_nm": nm, "units": "W.m^-2.nm^-1", "pitch_um": 5.0}
    np.savez(path, data=data, **more)
    with pytest.raises(PixsimError, match="rows, columns, bands") as of_file:
        read_irradiance(path)
    with pytest.raises(PixsimError, match="rows, columns, bands") as of_image:
        SpectralImage(nm, 100.0, 5.0, data=data)
    for raised in (of_file, of_image):
        line = str(raised.value).rpartition(": ")[2]
        assert line == f"data = np.moveaxis(data, {axis}, 2)"
    np.savez(path, data=np.moveaxis(data, axis, 2), **more)
    assert read_irradiance(path).data.shape[2] == 3


def test_cube_without_axis_of_the_bands_gives_no_line(tmp_path):
    np.savez(
        tmp_path / "cube.npz",
        data=np.ones((4, 5, 6)),
        wavelength_nm=[450.0, 550.0],
        units="W.m^-2.nm^-1",
        pitch_um=5.0,
    )
    with pytest.raises(PixsimError) as raised:
        read_irradiance(tmp_path / "cube.npz")
    assert "moveaxis" not in str(raised.value)
    assert bands_last_hint((2, 5, 2), 2) == "", "the last axis fits"
