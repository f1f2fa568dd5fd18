"""The CSF chart in colour: its primaries, its constant channels, and the light that its scene
gives.
"""

from __future__ import annotations

import math
from pathlib import Path

import colour
import numpy as np
import pytest
from helpers.chains import imaging_chain

import pixsim
from pixsim.light.exr import read_channels
from pixsim.light.spectral import colour_matching, photopic_efficiency
from pixsim.optics.camera_light import camera_factor
from pixsim.scene import charts
from pixsim.scene.colour_chart import (
    MEAN,
    PRIMARIES,
    PROJECTOR_M,
    modulation,
    primaries,
    primaries_xyz,
    slide,
    write_colour_chart,
)
from pixsim.viewer.develop import xyz_weights
from pixsim.viewer.noise_budget import noiseless_frame
from pixsim.viewer.scielab import OPPONENT_FROM_XYZ, XYZ_FROM_OPPONENT

RED_GREEN, BLUE_YELLOW = modulation(-XYZ_FROM_OPPONENT[:, 1]), modulation(XYZ_FROM_OPPONENT[:, 2])


def test_primaries_are_a_display_whose_white_is_d65() -> None:
    """1000 cd/m² of D65 within the 5 nm table, and chromaticities by colour-science: a red, a green
    and a blue.
    """
    nm, radiance = primaries()
    assert 683.002 * 5 * (photopic_efficiency(nm) @ radiance).sum() == pytest.approx(1000, rel=2e-3)
    xyz = primaries_xyz()
    white = xyz.sum(axis=1)
    assert white[:2] / white.sum() == pytest.approx([0.3127, 0.3290], abs=1e-4)
    expected = colour.MSDS_DISPLAY_PRIMARIES["Apple Studio Display"]
    for index, column in enumerate(xyz.T):
        theirs = expected.values[:, index] @ colour_matching(expected.wavelengths)
        assert column[:2] / column.sum() == pytest.approx(theirs[:2] / theirs.sum(), abs=2e-3)
    assert (xyz[0] / xyz.sum(axis=0) > [0.6, 0.2, 0.1]).all()
    assert (xyz[1] / xyz.sum(axis=0) < [0.4, 0.7, 0.15]).all()


@pytest.mark.parametrize(("change", "channel", "first"), [(RED_GREEN, 1, 0), (BLUE_YELLOW, 2, 2)])
def test_slides_change_one_opponent_channel_within_the_gamut(
    change, channel: int, first: int
) -> None:
    """The two others are constant to the float32 of the slides, and one slide has the contrast of
    the grey chart.
    """
    grey = charts.csf(512, 64)
    slides = np.stack([slide(share, grey) for share in change.tolist()])
    assert 0 <= slides.min() < 0.06
    assert 0.94 < slides.max() <= 1
    assert slides[first] == pytest.approx(grey, abs=1e-7)
    opponent = np.einsum("ij,jyx->iyx", OPPONENT_FROM_XYZ @ primaries_xyz(), slides.astype(float))
    for other in {0, 1, 2} - {channel}:
        assert np.ptp(opponent[other]) < 1e-6
    wave = opponent[channel] - opponent[channel].mean()
    assert np.abs(np.corrcoef(wave.ravel(), (grey - grey.mean()).ravel())[0, 1]) > 1 - 1e-6
    below = charts.csf_contrast(1 - 0.5 / 64) / charts.csf_contrast(
        1.0
    )  # in the middle of the lowest row
    assert change[first] * charts.csf_contrast(1.0) * below == pytest.approx(
        np.ptp(slides[first][-1]) / (2 * MEAN), rel=1e-3
    )


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A red-green chart of few cycles, which 64 samples resolve; its name would be markup."""
    path = tmp_path_factory.mktemp("charts") / "a & 'b'.xml"
    slides = write_colour_chart(path, RED_GREEN, "red-green", width=256, height=64, die_mm=0.2)
    assert [file.name for file in slides] == [f"a & 'b'_{name}.exr" for name in PRIMARIES]
    return path


@pytest.mark.parametrize("die_height_mm", [None, 1.3568])
def test_scene_gives_three_spectra_times_three_slides(
    written: Path, die_height_mm: float | None
) -> None:
    """Upright, on dies of two shapes, to 1 % of the mean: the texture between its texels, and the
    noise of 16 samples.

    A picture that is mirrored or upside down errs by half.
    """
    camera = pixsim.Camera(die_height_mm=die_height_mm)
    image = pixsim.render(
        pixsim.load_scene(written, resolution=64, variant="scalar_spectral"), camera
    )
    assert image.factors is not None
    assert image.shape == (64 if die_height_mm is None else 32, 64)
    spectra, pictures = image.factors
    assert len(spectra) == 3
    lens = camera_factor(camera, image.shape, image.pitch_um) * camera.transmittance
    nm, radiance = primaries()
    luminance = 683.002 * 5 * photopic_efficiency(nm) @ radiance
    for light, picture, full, name in zip(
        spectra @ image.luminous_weight(), pictures, luminance, PRIMARIES, strict=True
    ):
        texels = read_channels(written.with_name(f"{written.stem}_{name}.exr"))[0]["Y"]
        expected = texels.reshape(image.shape[0], -1, 64, 4).mean(axis=(1, 3))
        seen = picture * light / (full * lens)
        assert seen == pytest.approx(expected, abs=0.01 * MEAN)
    assert np.abs(expected - expected[:, ::-1]).max() > 0.05 * MEAN  # blue, which changes least


def test_white_of_the_chart_is_that_of_its_lamps(written: Path) -> None:
    """A camera that is no observer shows even slides as the grey they are; balanced for D65, which
    they look like, it would not.

    The white of the file is 1000 cd/m², with the chromaticity of D65, to the 6 digits of the scene
    and CIE's steps of 5 nm.
    """
    camera = pixsim.Camera(die_mm=0.2)
    image = pixsim.render(
        pixsim.load_scene(written, resolution=16, variant="scalar_spectral"), camera
    )
    assert image.header["white_lamps"] == list(PRIMARIES)
    assert image.white_spectrum is not None
    full = 1 / (
        math.pi * PROJECTOR_M**2
    )  # of a screen, by a lamp of intensity 1 through a slide of 1
    xyz = full * 683.002 * xyz_weights(image) @ image.white_spectrum
    assert xyz[1] == pytest.approx(1000, rel=1e-4)
    assert xyz[:2] / xyz.sum() == pytest.approx([0.3127, 0.3290], abs=1e-4)
    even = image.with_planes(np.full((3, 16, 16), full * MEAN, np.float32))
    pixel = pixsim.Pixel(
        technology="4t-bsi",
        pitch_um=5.0,
        prnu=0,
        stack={"enabled": False},
        colour={"sensitivities": "Nikon_D810", "peak_quantum_efficiency": 0.5},
    )

    def shown(light: pixsim.SpectralImage) -> np.ndarray:
        chain = imaging_chain(light, camera, pixel, pixsim.Exposure(), pixsim.Display(dots=8))
        return chain.development.light(noiseless_frame(chain, 0.01)).mean(axis=(1, 2))

    assert shown(even) == pytest.approx([MEAN] * 3, rel=1e-4)
    assert np.ptp(shown(even)) < 1e-6
    del even.header["lamp_w_per_m2_sr_nm"], even.header["white_lamps"]
    assert np.ptp(shown(even)) > 0.02
