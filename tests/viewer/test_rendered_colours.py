"""Colours of a rendered ColorChecker, and a camera's matrix in the bands of a picture, against
another program.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers import lights

import pixsim
from pixsim import Develop, Display
from pixsim.light.spectral import colour_matching, photons_per_joule
from pixsim.light.standard import CHROMATIC_PATCHES, illuminant, patch_reflectance
from pixsim.optics.camera_light import camera_factor
from pixsim.sensor.pixel import derive
from pixsim.viewer.colour_matrix import colour_errors, fit_matrix, metamerism_index
from pixsim.viewer.develop import measure_colour_chart, xyz_weights
from pixsim.viewer.scielab import delta_e, xyz_to_lab

DATA = Path(__file__).parents[1] / "data" / "colour"
WHITE_CD_PER_M2 = 1000.0
FINE_NM = np.arange(380.0, 780.1, 0.25)


def test_rendered_patches_have_the_colours_of_another_program() -> None:
    """With the stated brightness. ΔE of 0.15 in the mean is left by 16 samples of the render; under
    another lamp it would be above 20.
    """
    with np.load(DATA / "charts_of_lamp_files.npz") as file:
        expected = file["D65/XYZ"]
        white = file["D65/XYZ_white"]
    image = lights.patches()
    weights = xyz_weights(image)
    factor = camera_factor(lights.camera(image), image.shape, image.pitch_um)
    xyz = np.stack([image.weighted(weight) / factor for weight in weights], axis=-1)
    lumens_per_watt = image.luminous_weight().sum() / weights[1].sum()
    middles = xyz.reshape(4, 24, 6, 16, 3)[:, 8:16, :, 5:11].mean(axis=(1, 3)).reshape(24, 3)
    patches = 100 * lumens_per_watt / WHITE_CD_PER_M2 * middles
    errors = delta_e(xyz_to_lab(patches, white), xyz_to_lab(expected, white))
    assert errors.mean() < 0.25
    np.testing.assert_allclose(errors, 0, atol=1.0)


@pytest.mark.parametrize("camera", ["Canon_EOS_R5", "Nikon_D5100", "ARRI_D21"])
def test_matrix_in_the_bands_of_a_picture_is_that_of_integrals(camera: str) -> None:
    """SMI to 0.01 and matrix to 1e-3 of integrals in steps of 0.25 nm under D65."""
    colour = {"sensitivities": camera, "peak_quantum_efficiency": 0.5}
    fields = {"technology": "4t-bsi", "pitch_um": 3.0, "stack": {"enabled": False}}
    channels = derive(pixsim.Pixel(**fields, colour=colour)).channels
    chart = measure_colour_chart(lights.patches(), channels, Display())
    to_display = chart.matrix(Develop())
    matrix = np.linalg.inv(chart.to_display) @ to_display

    power = illuminant("D65", FINE_NM)
    reflectance = patch_reflectance(FINE_NM)[CHROMATIC_PATCHES]
    curves = [
        channel.quantum_efficiency(FINE_NM) * photons_per_joule(FINE_NM) for channel in channels
    ]
    electrons = power[:, None] * np.stack(curves, axis=1)
    observer = power[:, None] * colour_matching(FINE_NM)
    luminance = observer[:, 1].sum()
    xyz = reflectance @ observer / luminance
    white = observer.sum(axis=0) / luminance
    responses = reflectance @ electrons / electrons.sum(axis=0)
    expected = fit_matrix(responses, xyz, white)
    np.testing.assert_allclose(matrix, expected, atol=1e-3)
    index = metamerism_index(colour_errors(expected, responses, xyz, white))
    assert metamerism_index(chart.errors(to_display)) == pytest.approx(index, abs=0.01)
