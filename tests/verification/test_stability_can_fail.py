"""Stability cases fail if a kernel is wrong."""

from __future__ import annotations

import numpy as np
import pytest

from pixsim import optics
from pixsim.light.spectral import SpectralImage
from pixsim.optics.stack import stack_collection
from pixsim.sensor.integration import electrons_per_joule, integrate_pixels, mean_signal_rate, pixel_count
from pixsim.sensor.photodiode import collected_charge_e
from pixsim.sensor.pixel import PixelPhysics
from pixsim.verification import stability
from pixsim.verification.stability import photodiode, sensor


def padded(picture, pitch_um, nm, weight, f_number):
    """Diffraction with black padding."""
    return optics.diffract(np.pad(picture, 8), pitch_um, nm, weight, f_number)[8:-8, 8:-8]


def sampled(rate, sample_um, pitch_um, side_um):
    """Point sampling at the centres of the pixels."""
    at = [
        np.clip((n / 2 + (np.arange(k) - (k - 1) / 2) * pitch_um / sample_um).astype(int), 0, n - 1)
        for n, k in ((n, pixel_count(n * sample_um, pitch_um)) for n in rate.shape)
    ]
    return rate[np.ix_(*at)] * side_um**2


def at_the_middle(lamp, bands):
    """Lamps sampled at the centres of bands."""
    nm, header = bands.wavelength_nm, {"luminance_cd_per_m2": 1000.0}
    return SpectralImage(nm, 10.0, 20.0, factors=(np.interp(nm, lamp.nodes_nm, lamp.values), np.ones((1, 6, 6))), header=header)


LENS, OTF, PIXELS = "optics.irradiance_factor", "optics.diffraction_otf", "integration.integrate_pixels"
WRONG = {
    "cos⁴": (LENS, lambda n, t, m=0.0: np.pi / (4 * np.square(n * (1 + np.abs(m))) * (1 + np.square(t)) ** 2)),
    "1/N² of the engraved f-number": (LENS, lambda n, t, m=0.0: optics.irradiance_factor(n, t, 0 * m)),
    "E/L in single precision": (LENS, lambda n, t, m=0.0: np.float32(optics.irradiance_factor(n, t, m))),
    "an error of 5e-15": (LENS, lambda n, t, m=0.0: optics.irradiance_factor(n, t, m) * (1 + 5e-15)),
    "a linear OTF": (OTF, lambda f, nm, n: np.maximum(1 - np.asarray(f) * nm * n / 1e6, 0)),
    "an OTF above 0 beyond the cut-off": (OTF, lambda f, nm, n: np.maximum(optics.diffraction_otf(f, nm, n), 1e-300)),
    "0.01 % in N": (OTF, lambda f, nm, n: optics.diffraction_otf(np.asarray(f) * 1.0001, nm, n)),
    "black padding": ("optics.diffract", padded),
    "rates in single precision": (PIXELS, lambda r, *lengths: integrate_pixels(r.astype(np.float32).astype(float), *lengths)),
    "a gap of 1e-9 between photodiodes": (PIXELS, lambda r, s, p, d: integrate_pixels(r, s, p, d * (1 - 1e-9))),
    "point sampling": (PIXELS, sampled),
    "0.1 % of QE": ("spectra.electrons_per_joule", lambda physics, image: 1.001 * electrons_per_joule(physics, image)),
    "a signal in the dark": ("spectra.mean_signal_rate", lambda *given: 1e-300 + mean_signal_rate(*given)),
    "lamps sampled at the centres of bands": ("spectra.image_of", at_the_middle),
}


@pytest.mark.parametrize("name", WRONG)
def test_cases_with_wrong_kernel_fail(monkeypatch, name):
    target, wrong = WRONG[name]
    monkeypatch.setattr(f"pixsim.verification.stability.{target}", wrong)
    monkeypatch.setattr("pixsim.verification.stability.integration.LONG", 200)
    failed = {case.name for case in stability.cases_of(target.partition(".")[0]) if not case.passed}
    assert len(failed) > (3 if target.startswith("integration") else 0)
    assert wrong is not padded or "mean of pictures of 1×1 to 24×40 samples behind f/0.5 to a pinhole" in failed


def test_cases_with_wrong_charge_fail(monkeypatch):
    assert all(case.passed for case in photodiode.constant_capacitance())
    monkeypatch.setattr(photodiode, "collected_charge_e", lambda i, t, d: (1 + 1e-7) * collected_charge_e(i, t, d))
    assert not all(case.passed for case in photodiode.constant_capacitance())


def test_cases_of_a_stack_with_a_wrong_pupil_fail(monkeypatch):
    """2 % in the f-number, which collects more than étendue allows."""
    assert all(case.passed for case in sensor.stacks())

    def slower(*sizes, f_number, **more):
        return stack_collection(*sizes, f_number=1.02 * f_number, **more)

    monkeypatch.setattr(sensor, "stack_collection", slower)
    failed = [case.name for case in sensor.stacks() if not case.passed]
    assert len(failed) >= 2
    assert "light beyond étendue at f/0.5, from the lowest microlens on" in failed


def test_cases_of_gain_with_noise_on_the_wrong_side_fail(monkeypatch):
    assert all(case.passed for case in sensor.gains())
    monkeypatch.setattr(
        PixelPhysics, "read_noise_at_gain_e", property(lambda p: np.hypot(p.read_noise_e, p.read_noise_after_gain_e))
    )
    assert not all(case.passed for case in sensor.gains())
