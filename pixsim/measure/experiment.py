"""The photon-transfer experiment of EMVA 1288: one individual sensor under even monochromatic light, and in the dark.

Light of one wavelength, the same on every pixel, in equal steps from dark to beyond saturation at one integration time
(Release 4.0 Linear, section 6.5); two frames a step; stacks of frames in the dark and at half of the saturation for the
spatial terms (8); pairs in the dark at several times (7.1) and temperatures (7.2). The fixed pattern is drawn once. Every
frame has its own random stream, so that a frame is the same whichever others are taken.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from pixsim.base.arrays import Array, stream
from pixsim.base.errors import invalid
from pixsim.base.parameters import Exposure, Pixel
from pixsim.measure.estimators import Frames, Pair, Series, pair, series
from pixsim.sensor.photodiode import stored_signal_e
from pixsim.sensor.pixel import PixelPhysics, derive
from pixsim.sensor.readout import MAX_BLACK, Sensor, least_black_level_dn, read_out, sample_sensor

SHAPE = 200, 200  # pixels of the command's sensor: a variance is known to 0.7 %, a fitted slope to 0.2 %
EXPOSURES = 50  # the least of EMVA 1288, section 6.5
DIM_EXPOSURES = 12  # beside them, at equal ratios below the first: where ISO 12232 finds S/N 10
BEYOND_SATURATION = 1.1  # of the light that fills the well: the peak of the variance is to be seen from both sides
STACK = 64  # frames; the standard asks for 16 at least
DARK_TIMES = 8  # the standard asks for 6 at least
WARMER_K = (0.0, 5.0, 10.0, 15.0, 20.0, 25.0)  # temperatures of the dark series, above the pixel's own
HOTTEST_K = 400.0
USUAL_INTEGRATION_S = 0.030  # of Fig. 2 of Chen et al. (2000)
DARK_SHARE = 0.02  # of the well that dark charge takes at most in the light series, unless told otherwise
MAX_DARK_SHARE = 0.2  # of the well, in the longest of the dark series
MAX_DARK_S = 3600.0
SEARCH_NM = (200.0, 1200.0)  # where the peak of a response is looked for
FULL_LEVEL = 0.999  # of the full well: where a soft saturation counts as full
MAX_LIGHT = 4.0  # wells of generated charge, if a soft saturation is not full before


@dataclass(frozen=True)
class Experiment:
    """What is exposed, and how.

    photons : (n,) per pixel, in rising order, one for each pair of the light series
    dark_times_s, temperatures_k : of the dark series
    black_level_dn in the sensor's pixel is the one used; `asked_black_dn` is what the user had.
    """

    sensor: Sensor = field(repr=False)
    wavelength_nm: float
    integration_s: float
    photons: Array = field(repr=False)
    dim_photons: Array = field(repr=False)
    dark_times_s: Array = field(repr=False)
    temperatures_k: tuple[float, ...]
    asked_black_dn: float
    stack_frames: int = STACK
    seed: int = 0

    @property
    def physics(self) -> PixelPhysics:
        return self.sensor.physics

    @cached_property
    def efficiency(self) -> float:
        """Electrons per photon on the whole pixel: QE(λ) times fill factor."""
        return pixel_efficiency(self.physics, self.wavelength_nm)

    def frame(self, photons: float, integration_s: float, *key: object, sensor: Sensor | None = None) -> Frames:
        """One frame of the individual, (rows, columns) DN; the key names its random stream."""
        own = sensor or self.sensor
        mean_e = np.full(own.shape, photons * self.efficiency)
        return read_out(mean_e, integration_s, own, stream("datasheet", self.seed, *key))

    def frames(self, count: int, photons: float, *key: object) -> Iterator[Frames]:
        """Frames of the same light at the light series' integration time."""
        return (self.frame(photons, self.integration_s, *key, index) for index in range(count))

    def dark_series(self, temperature_k: float | None = None) -> Series:
        """Dark pairs at each time; at another temperature than the pixel's own, over times in which its well does not fill."""
        key: tuple[object, ...] = ("dark series",)
        sensor, times = self.sensor, self.dark_times_s
        if temperature_k is not None:
            key, sensor = ("temperature", round(1e6 * temperature_k)), self.warmed(temperature_k)
            times = times * min(self.physics.dark_current_e_per_s / sensor.physics.dark_current_e_per_s, 1.0)

        def dark_pair(number: int, time_s: float) -> Pair:
            return pair(*(self.frame(0.0, time_s, *key, number, index, sensor=sensor) for index in range(2)))

        return series(times, [dark_pair(number, each) for number, each in enumerate(times.tolist())])

    def warmed(self, temperature_k: float) -> Sensor:
        """The same individual at another temperature: its maps stay, its currents grow."""
        pixel = Pixel.model_validate(self.physics.pixel.model_dump() | {"temperature_k": temperature_k})
        return replace(self.sensor, physics=replace(derive(pixel), full_well_e=self.physics.full_well_e))


def pixel_efficiency(physics: PixelPhysics, wavelength_nm: float) -> float:
    """Electrons per photon on a whole pixel: what EMVA 1288 calls η, fill factor included."""
    return float(physics.quantum_efficiency(wavelength_nm)) * physics.fill_factor


def peak_wavelength_nm(physics: PixelPhysics) -> float:
    """Whole nanometre at which the response is highest; the middle one where several are."""
    nm = np.arange(*SEARCH_NM)
    efficiency = physics.quantum_efficiency(nm)
    highest = nm[efficiency >= efficiency.max() * (1 - 1e-9)]
    return float(highest[highest.size // 2])


def with_black_level(physics: PixelPhysics, integration_s: float) -> PixelPhysics:
    """The pixel with at least the black level that its dark needs; PixsimError where its ADC has no codes for one."""
    least = least_black_level_dn(physics, integration_s)
    if physics.pixel.black_level_dn >= least:
        return physics
    if least > MAX_BLACK * (2**physics.pixel.bits - 1):
        raise invalid(
            "pixel.bits",
            physics.pixel.bits,
            f"enough for a black level of 6 σ of the dark, here {least} DN, in the lower half of the codes",
            "Raise pixel.bits, or lower the noise in the dark.",
        )
    return replace(physics, pixel=physics.pixel.model_copy(update={"black_level_dn": float(least)}))


def usual_integration_s(physics: PixelPhysics, exposure: Exposure) -> float:
    """The one asked for; else 30 ms, or what keeps dark charge below 2 % of the well. PixsimError beyond half the well."""
    dark = physics.dark_current_e_per_s
    chosen = exposure.integration_s
    if chosen is None:
        return min(USUAL_INTEGRATION_S, DARK_SHARE * physics.full_well_e / dark) if dark else USUAL_INTEGRATION_S
    if dark * chosen > physics.full_well_e / 2:
        raise invalid(
            "exposure.integration_s",
            f"{chosen:g}, in which {dark * chosen:.3g} e- of dark charge gather",
            f"at most {physics.full_well_e / 2 / dark:.3g} s, which fills half the well",
        )
    return chosen


def filling_light_e(physics: PixelPhysics, integration_s: float) -> float:
    """Mean photo-electrons that fill the well, soft saturation included."""
    dark_e = physics.dark_current_e_per_s * integration_s
    grid = np.linspace(0.01, MAX_LIGHT, 400) * physics.full_well_e
    level = stored_signal_e(grid, integration_s, physics)
    full = np.flatnonzero(level >= FULL_LEVEL * physics.full_well_e)
    return float(grid[full[0]] if full.size else grid[-1]) - dark_e


def dark_times_s(physics: PixelPhysics, integration_s: float) -> Array:
    """Equally spaced, up to a fifth of the well or an hour."""
    dark = physics.dark_current_e_per_s
    longest = min(MAX_DARK_SHARE * physics.full_well_e / dark, MAX_DARK_S) if dark else MAX_DARK_S
    return np.linspace(integration_s, max(longest, 2 * integration_s), DARK_TIMES)


def temperatures_k(pixel: Pixel) -> tuple[float, ...]:
    """The pixel's own and warmer ones, or colder where it is hot; none where the dark current is given as one number."""
    if pixel.dark_current_e_per_s is not None:
        return ()
    sign = 1 if pixel.temperature_k + WARMER_K[-1] <= HOTTEST_K else -1
    return tuple(pixel.temperature_k + sign * each for each in WARMER_K)


def make_experiment(
    pixel: Pixel,
    exposure: Exposure | None = None,
    *,
    wavelength_nm: float | None = None,
    seed: int = 0,
    shape: tuple[int, int] = SHAPE,
    exposures: int = EXPOSURES,
    stack_frames: int = STACK,
) -> Experiment:
    """One individual of a pixel, drawn from the seed, and what it is shown.

    Parameters
    ----------
    exposure : integration_s is that of the light series; 30 ms by default, less where dark charge is strong
    wavelength_nm : of the light; where the response peaks by default
    shape : (rows, columns) pixels
    exposures : light levels, equally spaced from dark to 1.1 times what fills the well

    Raises PixsimError for a wavelength at which the pixel is blind, and for bits that leave no room for a black level.
    """
    raw = derive(pixel)
    time_s = usual_integration_s(raw, exposure or Exposure())
    physics = with_black_level(raw, time_s)
    nm = peak_wavelength_nm(physics) if wavelength_nm is None else wavelength_nm
    efficiency = pixel_efficiency(physics, nm)
    if not efficiency > 0:
        raise invalid("wavelength_nm", f"{nm:g}", f"one at which the pixel sees light, as {peak_wavelength_nm(physics):g}")
    brightest = BEYOND_SATURATION * filling_light_e(physics, time_s) / efficiency
    photons = brightest * np.arange(1, exposures + 1) / exposures
    return Experiment(
        sensor=sample_sensor(physics, shape, stream("datasheet", seed, "sensor")),
        wavelength_nm=nm,
        integration_s=time_s,
        photons=photons,
        dim_photons=np.geomspace(min(1.0 / efficiency, photons[0] / 2), photons[0], DIM_EXPOSURES, endpoint=False),
        dark_times_s=dark_times_s(physics, time_s),
        temperatures_k=temperatures_k(pixel),
        asked_black_dn=pixel.black_level_dn,
        stack_frames=stack_frames,
        seed=seed,
    )
