"""Figures of merit that need no captured frames: MTF, NEQ, noise budgets, sensitivity, and the
frequencies that a picture shows.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from pixsim.base.arrays import Array
from pixsim.light.spectral import SpectralImage
from pixsim.optics.camera import Camera
from pixsim.optics.stack import aperture_side_um
from pixsim.scene.charts import MAX_LP_PER_MM, csf_contrast, csf_frequency_on_sensor
from pixsim.sensor.dynamic_range import (
    DynamicRange,
    levels_of_light_e,
    readout_range,
    readout_snr_db,
)
from pixsim.sensor.integration import (
    M2_PER_UM2,
    collecting_area_um2,
    electrons_per_joule,
    illumination_of,
    pixels_along,
)
from pixsim.sensor.motion import velocity_um_per_s
from pixsim.sensor.noise import signal_at_snr_e, variance_e2
from pixsim.sensor.pixel import PixelPhysics
from pixsim.sensor.reading import Readout
from pixsim.studies.settings import Study, paths_of
from pixsim.viewer.chain import ExpectedFrame, make_chain
from pixsim.viewer.display import picture_size_um, white_cd_per_m2, white_w_per_m2_sr
from pixsim.viewer.imaging import Imaging
from pixsim.viewer.mtf import mtf_terms, terms_to_sensor
from pixsim.viewer.noise_budget import NoiseBudget, noise_budget
from pixsim.viewer.raw_metrics import INFORMATION, neq_along

if TYPE_CHECKING:
    from pixsim.studies.curve import Curve
    from pixsim.studies.result import StudyResult
    from pixsim.studies.run import RunResult

# Widths in µm that are omitted above and below, and left and right, of the rendered picture.
Border = tuple[float, float]
NO_BORDER: Border = (0.0, 0.0)


def extent(
    irradiance: SpectralImage, border_um: Border = NO_BORDER
) -> tuple[float, float, float, float]:
    """Return left, right, bottom, top in mm on the sensor of a picture without its border, row 0 on
    top.
    """
    height_um, width_um = picture_size_um(irradiance)
    down_um, across_um = border_um
    return (
        1e-3 * across_um,
        1e-3 * (width_um - across_um),
        1e-3 * (height_um - down_um),
        1e-3 * down_um,
    )


def csf_range_lp_per_mm(
    irradiance: SpectralImage, border_um: Border = NO_BORDER
) -> tuple[float, float] | None:
    """Return the lowest and highest frequency of the CSF chart within a border.

    Returns None for another scene.
    """
    left, right, _, _ = extent(irradiance, border_um)
    width_mm = extent(irradiance)[1]
    frequency = csf_frequency_on_sensor(irradiance.header, width_mm)
    if frequency is None:
        return None
    return float(frequency(left / width_mm)), float(frequency(right / width_mm))


def csf_contrasts(irradiance: SpectralImage, border_um: Border = NO_BORDER) -> tuple[float, float]:
    """Return the contrast of the CSF chart at the top and at the bottom of a picture of it, within
    a border.
    """
    _, _, bottom, top = extent(irradiance, border_um)
    height_mm = extent(irradiance)[2]
    return float(csf_contrast(top / height_mm)), float(csf_contrast(bottom / height_mm))


def stated_end_lp_per_mm(header: Mapping[str, Any]) -> float | None:
    """Return the highest frequency of the CSF chart that the parameters of a scene state.

    Returns None if they do not state it.

    header : of an irradiance
    """
    parameters = header.get("parameters")
    if not isinstance(parameters, dict) or MAX_LP_PER_MM not in parameters:
        return None
    return float(parameters[MAX_LP_PER_MM])


def varied_view_settings(study: Study) -> list[str]:
    """Return the dotted names of display.dots and of the chart's highest frequency, if an axis or a
    condition of a study sets them.
    """
    varied_paths = {path for axis in study.axis for path in axis.paths} | {
        path for condition in study.condition for path in paths_of(condition.set)
    }
    return [
        ".".join(path)
        for path in (("display", "dots"), ("scene", "parameters", MAX_LP_PER_MM))
        if path in varied_paths
    ]


def columns_on(camera: Camera, pitch_um: float) -> int:
    """Return the columns of pixels on the die. Raises PixsimError if not one pixel fits."""
    return pixels_along(camera.die_um[1], pitch_um)


_MPE30_INTEGRATION_S = 0.030  # of Figure 2 of Chen, Catrysse, El Gamal and Wandell (2000)


def longest_path_um(result: StudyResult, curve: Curve, pitch_um: float) -> float:
    """Return how far the picture moves on the sensor during an exposure, along the axis of more
    motion.

    It is 0 without motion. Between the pitches of a curve the integration time is interpolated.
    """
    motion = result.study.motion
    if not motion.is_on:
        return 0.0
    um_per_s = max(map(abs, velocity_um_per_s(motion, result.camera, pitch_um)))
    return um_per_s * float(np.interp(pitch_um, curve.pitch_um, curve.mean("integration_s")))


def study_mtf_terms(
    result: StudyResult, physics: PixelPhysics, frequency_cy_per_mm: Array, path_um: float = 0.0
) -> dict[str, Array]:
    """Return `mtf_terms` with a study's light, camera and display."""
    study = result.study
    imaging = Imaging(
        result.camera, physics.pixel, physics.technology, study.exposure, study.display
    )
    return mtf_terms(imaging, result.irradiance, frequency_cy_per_mm, path_um=path_um)


def system_mtf(
    result: StudyResult, physics: PixelPhysics, frequency_cy_per_mm: Array, path_um: float = 0.0
) -> Array:
    """Return the MTF from scene to sensor: lens times photodiode, as in the paper's Figure 2b.

    For a pixel with a stack, the terms of the stack take the photodiode's place.
    """
    terms = study_mtf_terms(result, physics, frequency_cy_per_mm, path_um)
    return np.asarray(math.prod(terms_to_sensor(terms).values()))


def scene_to_display_mtf(
    result: StudyResult, physics: PixelPhysics, frequency_cy_per_mm: Array, path_um: float = 0.0
) -> Array:
    """Return the MTF from scene to display: the product of all terms."""
    terms = study_mtf_terms(result, physics, frequency_cy_per_mm, path_um)
    return np.prod(list(terms.values()), axis=0)


def mtf50_cy_per_mm(
    result: StudyResult,
    physics: PixelPhysics,
    mtf: Callable[[StudyResult, PixelPhysics, Array, float], Array] = system_mtf,
    path_um: float = 0.0,
) -> float:
    """Return the lowest frequency at which an MTF falls to one half.

    mtf : `system_mtf` or `scene_to_display_mtf`
    path_um : of light that moves, as in `mtf_terms`
    """
    side_um = physics.aperture_side_um
    if physics.stack is not None:
        light = illumination_of(result.irradiance, result.camera, physics)
        side_um = float(aperture_side_um(physics.stack, light.pupil.at(0.0, 0.0))[0])
    low, high = 0.0, 1e3 / max(side_um, path_um)  # the first zero of the aperture, or of the path
    # 300 steps up to the first zero, then 300 steps within the step that crosses one half.
    for _ in range(2):
        frequency = np.linspace(low, high, 301)
        values = mtf(result, physics, frequency, path_um)
        below = int(np.argmax(values < 0.5))
        low = frequency[below - 1]
        high = frequency[below]
    return float(np.interp(-0.5, -values[below - 1 : below + 1], [low, high]))


def detail_frequency_lp_per_mm(irradiance: SpectralImage, pitch_um: float) -> tuple[float, str]:
    """Return the frequency at which pages state the terms of the MTF, and its name: the highest of
    a CSF chart, or half the Nyquist frequency.
    """
    frequencies = csf_range_lp_per_mm(irradiance)
    if frequencies is not None:
        return frequencies[1], "the highest frequency of the chart"
    return 1e3 / (4 * pitch_um), f"half the Nyquist frequency of {pitch_um:.3g} µm pixels"


def detail_terms(
    imaging: Imaging, irradiance: SpectralImage, path_um: float = 0.0
) -> tuple[float, str, dict[str, float], dict[str, float]]:
    """Return the frequency of `detail_frequency_lp_per_mm` and its name, and the MTF there of each
    term up to the sensor and of each term of the display.
    """
    frequency, name = detail_frequency_lp_per_mm(irradiance, imaging.pixel.pitch_um)
    mtf_of_terms = mtf_terms(imaging, irradiance, np.array(frequency), path_um=path_um)
    terms = {term: float(mtf) for term, mtf in mtf_of_terms.items()}
    sensor_terms = terms_to_sensor(terms)
    display_terms = {term: mtf for term, mtf in terms.items() if term not in sensor_terms}
    return frequency, name, sensor_terms, display_terms


def mpe30_lx_s(
    result: StudyResult, physics: PixelPhysics, integration_s: float = _MPE30_INTEGRATION_S
) -> float:
    """Return the minimum photometric exposure on the sensor for an SNR of 30 dB (eq. 2); inf if it
    exceeds saturation.
    """
    snr = 10 ** (30 / 20)
    readout = Readout.of(physics, result.study.exposure, bin_side=1)  # single pixels
    noise_e2 = (
        float(variance_e2(readout, is_temporal=True)) + readout.dark_current_e_per_s * integration_s
    )
    signal_e = signal_at_snr_e(snr, noise_e2, 0.0)
    if signal_e > readout.saturation_e:
        return np.inf
    area_um2 = collecting_area_um2(result.irradiance, result.camera, physics)
    return float(signal_e / (sensitivity_e_per_lx_s_um2(result, physics) * area_um2))


def sensitivity_e_per_lx_s_um2(result: StudyResult, physics: PixelPhysics) -> float:
    """Return the electrons per lx·s and µm² of photodiode in the scene's light."""
    irradiance = result.irradiance
    spectrum = irradiance.mean_spectrum()
    electrons = (electrons_per_joule(physics, irradiance) * spectrum).sum() * M2_PER_UM2
    return float(electrons / (irradiance.luminous_weight() * spectrum).sum())


@dataclass(frozen=True)
class NeqCurve:
    """The NEQ of a sensor.

    pitch_um : of its pixels
    frequency_cy_per_mm : along an axis of the sensor, (n,)
    neq_per_mm2 : there, (n,)
    """

    pitch_um: float
    frequency_cy_per_mm: Array
    neq_per_mm2: Array

    @classmethod
    def of(cls, frame: ExpectedFrame) -> NeqCurve:
        """Return the NEQ of expected frames of a sensor."""
        return cls(frame.readout.physics.pitch_um, *neq_along(frame))


def run_neq(result: RunResult) -> dict[str, NeqCurve]:
    """Return the NEQ of a run's sensor by the sensor's name; empty without the metric
    information.
    """
    if INFORMATION.name not in result.settings.metrics:
        return {}
    frame = result.chain.expected(result.score.frame.integration_s)
    return {result.settings.pixel.technology: NeqCurve.of(frame)}


def study_neq(result: StudyResult) -> dict[str, NeqCurve]:
    """Return the NEQ of each sensor of a study by its label, at its best size by information.

    Empty without the metric information.
    """
    if INFORMATION.name not in result.study.metrics:
        return {}
    neq_curves: dict[str, NeqCurve] = {}
    for curve in result.curves:
        rendered = result.sensors[curve.technology]
        best = curve.optima.get(INFORMATION.name, curve.optimum)
        chain = make_chain(rendered.imaging.at(best.pitch_um).registered(0), rendered.light())
        neq_curves[curve.label] = NeqCurve.of(chain.expected(chain.integration_s))
    return neq_curves


THRESHOLDS_DB = (0.0, 6.0, 12.0, 20.0, 30.0, 40.0)  # of the ranges of a pixel's SNR
_DARKEST = 0.3  # of the noise in the dark: -10 dB


@dataclass(frozen=True)
class SnrCurve:
    """The SNR of several readings of a pixel and of their merge, by temporal noise, against the
    light.

    charge_e : mean electrons of light in the first collector in a frame, (n,), rising
    cd_per_m2_per_e : luminance of the scene's white on axis over its charge, or None for light that
        has none
    merged_db : SNR of the merge, (n,); -inf where the last reading is full
    readings_db : of each reading alone, (n,), by its name
    switches_e : charge at which the merge changes its readings, and the SNR in dB that this costs
    ranges : where the SNR of the merge is at least each of `THRESHOLDS_DB`
    """

    charge_e: Array
    cd_per_m2_per_e: float | None
    merged_db: Array
    readings_db: dict[str, Array]
    switches_e: tuple[tuple[float, float], ...]
    ranges: tuple[DynamicRange, ...]


def run_snr(result: RunResult) -> SnrCurve | None:
    """Return the SNR of the pixel of a run in its exposure, or None for a pixel that is read once,
    and where dark charge fills its last reading.
    """
    chain = result.chain
    if not chain.readout.readings:
        return None
    time_s = result.score.frame.integration_s
    readout = chain.readout.at(chain.exposure)
    ranges = tuple(readout_range(readout, threshold_db, time_s) for threshold_db in THRESHOLDS_DB)
    lowest = ranges[0]
    if not lowest.largest_e:
        return None

    darkest_e = _DARKEST * lowest.dark_noise_e
    levels_e, beside_e = levels_of_light_e(readout, time_s, darkest_e, lowest.largest_e)
    charge_e = np.sort(np.append(levels_e, beside_e))
    before_db, after_db = readout_snr_db(readout, beside_e, time_s)
    display = result.settings.display
    cd_per_m2_per_e = None
    if white_w_per_m2_sr(result.irradiance, display) is None:
        white_e = chain.white_e_per_s * time_s
        cd_per_m2_per_e = white_cd_per_m2(result.irradiance, display) / white_e
    return SnrCurve(
        charge_e,
        cd_per_m2_per_e,
        readout_snr_db(readout, charge_e, time_s),
        {
            reading.name: readout_snr_db(readout, charge_e, time_s, reading=reading.name)
            for reading in readout.readings
        },
        tuple(zip(beside_e.mean(axis=0).tolist(), (before_db - after_db).tolist(), strict=True)),
        ranges,
    )


def noise_budgets(result: StudyResult) -> dict[str, NoiseBudget]:
    """Return the noise budget of each curve of each case, at its best size tried, by the label of
    the curve and that size.

    Empty unless the study asks for it. The frame is the first one of the first sensor, with the
    same random numbers in all cases.
    """
    if not result.study.noise_budget:
        return {}
    budgets = {}
    for case in result.cases:
        for curve in case.curves:
            pitch_um = float(curve.pitch_um[int(np.nanargmin(curve.mean()))])
            rendered = case.sensors[curve.technology]
            chain = make_chain(rendered.imaging.at(pitch_um).registered(0), rendered.light())
            budget = noise_budget(chain, case.irradiance, *rendered.case.stream_at(pitch_um), 0)
            budgets[f"{curve.label}, {pitch_um:.3g} µm"] = budget
        case.scenes.clear()
    return budgets
