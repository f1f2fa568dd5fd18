"""Pixels from 0.3 to 100 µm, exposures from 1 ns to 10 h, 1 to 24 bits, 77 to 400 K, gains from 0 to 60 dB, and stacks from 1 nm
to 10 mm high behind f/0.5 to f/10⁶, against closed forms and exact sums."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import norm, poisson

from pixsim.base.arrays import Array
from pixsim.optics.pupil import disc_pupil
from pixsim.optics.stack import Stack, collected_shares, stack_collection
from pixsim.sensor import readout as sensors
from pixsim.sensor.exposure import Exposure
from pixsim.sensor.integration import integrate_pixels
from pixsim.sensor.pixel import PixelPhysics, derive
from pixsim.sensor.pixel_options import Pixel
from pixsim.sensor.technology import Junction, Technology, load_technology
from pixsim.verification.stability import QUIET, ROUNDING, ExtremeCase, compare, compare_drawn

PITCHES_UM = (0.3, 1.0, 6.5, 40.0, 100.0)
TIMES_S = 10.0 ** np.array([-9.0, -6.0, -3.0, 0.0, 3.0, math.log10(36_000)])
TEMPERATURES_K = np.array([77.0, 150.0, 250.0, 300.15, 350.0, 400.0])
# SI 2019, exact; independent of pixsim's constants.
BOLTZMANN_J_PER_K, ELECTRON_C = 1.380649e-23, 1.602176634e-19


def cases() -> Iterator[ExtremeCase]:
    physical = _pitches, _fill_factors, _grids, _times, _dark_current, _saturated
    for group in (*physical, _converters, gains, _temperatures, _fixed_patterns, stacks):
        yield from group()


def physics_of(**options: object) -> PixelPhysics:
    return derive(Pixel.model_validate({"fill_factor": 0.5, **QUIET, **options}))


def frame(
    physics: PixelPhysics, mean_e: Array | float, time_s: float = 1.0, shape: tuple[int, int] = (200, 500), seed: int = 0
) -> Array:
    """Codes under uniform light."""
    sensor = sensors.sample_sensor(physics, shape, np.random.default_rng(seed))
    return sensors.read_out(np.broadcast_to(mean_e, shape), time_s, sensor, np.random.default_rng(seed + 1)).astype(float)


def _pitches() -> Iterator[ExtremeCase]:
    # The full well of a pinned photodiode is proportional to its area; a junction has area, sidewall and node capacitance.
    pinned = load_technology("4t-bsi").full_well_e_per_um2 or 0.0
    wells = [physics_of(technology="4t-bsi", pitch_um=pitch).full_well_e for pitch in PITCHES_UM]
    expected = [pinned * 0.5 * p**2 for p in PITCHES_UM]
    yield compare("full well of a pinned photodiode, pitch 0.3 … 100 µm", expected, wells, ROUNDING, "density · area")
    junction = load_technology("0.35um")
    wells = [physics_of(pitch_um=pitch).full_well_e for pitch in PITCHES_UM]
    expected = [_junction_well_e(0.5 * pitch**2, junction) for pitch in PITCHES_UM]
    source = "∫C dV/q over the swing by 2000 trapezoids, 1e-7"
    yield compare("full well of a junction, pitch 0.3 … 100 µm", expected, wells, 1e-6, source)


def _junction_well_e(area_um2: float, technology: Technology) -> float:
    j = technology.junction
    assert j is not None
    v = np.linspace(j.reset_voltage_v - j.voltage_swing_v, j.reset_voltage_v, 2001)
    return float(np.trapezoid(_junction_ff(j, area_um2, v), v) * 1e-15 / ELECTRON_C)


def _junction_ff(j: Junction, area_um2: float, v: ArrayLike) -> Array:
    v = np.asarray(v, float)
    c_ff = j.cj_ff_per_um2 * area_um2 * (1 + v / j.pb_v) ** -j.mj + j.node_capacitance_ff
    return c_ff + j.cjsw_ff_per_um * 4 * math.sqrt(area_um2) * (1 + v / j.pbsw_v) ** -j.mjsw


def _fill_factors() -> Iterator[ExtremeCase]:
    # The limit is the picture's value at the pixel's centre, which for a linear picture is also the mean.
    rows, columns = np.mgrid[0:60, 0:60] + 0.5
    plane = 1 + rows / 60 + 2 * columns / 60
    centres = (np.arange(24) + 0.5) * 2.5
    values = 1 + centres[:, None] / 60 + 2 * centres / 60
    fills = (1e-2, 1e-4, 1e-6, 1e-8)
    got = [integrate_pixels(plane, 1.0, 2.5, 2.5 * math.sqrt(fill)) / fill for fill in fills]
    # The rounding of a running sum up to 60 · 4 is 5e-14, relative to a side of 2.5e-4 µm 2e-10, along both axes.
    source = "limit FF → 0: value at the centre · FF · pitch²; rounding of the running sum over a side of 2.5e-4 µm"
    yield compare("FF 1e-2 … 1e-8: electrons proportional to FF", np.stack([values * 6.25] * 4), np.stack(got), 1e-8, source)
    wells = [physics_of(technology="4t-bsi", fill_factor=fill).full_well_e / fill for fill in (1e-12, 1e-6, 1.0)]
    yield compare("FF 1e-12 … 1: full well over FF of a pinned photodiode", wells[-1], wells, ROUNDING, "proportional")


def _grids() -> Iterator[ExtremeCase]:
    physics = physics_of(pitch_um=0.3, technology="4t-bsi", full_well_e=1000, bits=12)
    codes = frame(physics, 500.0, shape=(1, 1))
    spread = math.sqrt(500.0) * physics.dn_per_e
    yield compare_drawn("1 × 1 pixel: its code", 4095 / 2, codes, spread, "half of the full well ± shot noise")
    column = frame(replace(physics, column_fpn_e=20.0), 500.0, shape=(20_000, 3)).mean(axis=0)
    alone = np.random.default_rng(0).standard_normal((1, 3))[0] * 20.0
    expected = (500 + alone) * physics.dn_per_e
    error = math.sqrt(500.0 / 20_000) * physics.dn_per_e
    yield compare_drawn("20 000 × 3 pixels: mean of each column", expected, column, error, "offset of the column")


def _times() -> Iterator[ExtremeCase]:
    physics = physics_of(full_well_e=1e15, bits=16)
    sensor = sensors.sample_sensor(physics, (2, 2), np.random.default_rng(0))
    rate = np.full((2, 2), 1e9)
    exposures = [Exposure(integration_s=float(time_s)) for time_s in TIMES_S]
    got = [sensors.capture_from_rates(rate, sensor, exposure, np.random.default_rng(0)).mean_e.mean() for exposure in exposures]
    yield compare("mean electrons, 1 ns … 10 h", 1e9 * TIMES_S, got, ROUNDING, "rate · time")
    dark = physics_of(full_well_e=1e15, dark_current_e_per_s=250.0)
    sensor = sensors.sample_sensor(dark, (2, 2), np.random.default_rng(0))
    frames = [sensors.capture_from_rates(rate * 0, sensor, exposure, np.random.default_rng(0)) for exposure in exposures]
    yield compare("mean dark electrons, 1 ns … 10 h", 250 * TIMES_S, [f.mean_dark_e for f in frames], ROUNDING, "current · time")


def _dark_current() -> Iterator[ExtremeCase]:
    physics = physics_of(full_well_e=1000, bits=10, dark_current_e_per_s=1e6)
    yield compare("dark charge of a thousand full wells: every code", 1023.0, frame(physics, 0.0), 0.0, "exactly the top code")
    lowered = replace(sensors.sample_sensor(physics, (4, 4), np.random.default_rng(0)), offset_e=np.full((4, 4), -400.0))
    moved = sensors.read_out(np.zeros((4, 4)), 1.0, lowered, np.random.default_rng(1))
    source = "0.6 · 1023, rounded: the full well clips before the offset is added"
    yield compare("dark charge of a thousand full wells, offset -0.4 full wells: every code", 614.0, moved, 0.0, source)
    exposed = sensors.integration_time_s(Exposure(max_integration_s=10.0), physics, 0.0)
    yield compare("automatic exposure in the dark: charge over full well", 0.95, exposed * 1e6 / 1000, ROUNDING, "well_target")
    # Dark charge at full well, gain 1: codes are min(n, full well) of Poisson counts.
    brim = physics_of(full_well_e=1023, bits=10, dark_current_e_per_s=1023)
    codes = frame(brim, 0.0)
    counts = np.arange(1023)
    mean = float(poisson.sf(counts, 1023).sum())
    square = float(((2 * counts + 1) * poisson.sf(counts, 1023)).sum())
    error = math.sqrt((square - mean**2) / codes.size)
    source = "Σ P(n > k) over Poisson counts"
    yield compare_drawn("dark charge equal to the full well: mean code", mean, codes.mean(), error, source)
    full = poisson.sf(1022, 1023)
    share, error = np.mean(codes == 1023), math.sqrt(full * (1 - full) / codes.size)
    yield compare_drawn("dark charge equal to the full well: fraction of saturated pixels", full, share, error, "P(n ≥ full well)")


def _saturated() -> Iterator[ExtremeCase]:
    """Fractions of saturated pixels with all kinds of noise."""
    sheet = {"technology": "none", "pitch_um": 3.75, "full_well_e": 10500, "read_noise_e": 2.3, "dark_current_e_per_s": 3}
    sheet |= {"quantum_efficiency": 0.62, "bits": 12, "black_level_dn": 64, "prnu": 0.005, "dsnu": 0.2, "offset_fpn": 0.002}
    pixels = {
        "default pixel": Pixel(),
        "data sheet": Pixel.model_validate(sheet),
        "pinned": Pixel(technology="4t-bsi", pitch_um=2.8),
        "diode": Pixel(well_limit="diode"),
        "junction": Pixel(conversion="junction"),
        "diode and junction": Pixel(well_limit="diode", conversion="junction"),
    }
    for wells, expected, where in ((14.0, 1.0, "every one"), (0.5, 0.0, "none")):
        got = [_saturated_of(derive(pixel), wells * derive(pixel).full_well_e) for pixel in pixels.values()]
        source = f"{where}: the full well is 30 σ of shot noise and PRNU away"
        yield compare(f"saturated pixels under {wells:g} full wells, {', '.join(pixels)}", expected, got, 0.0, source)
    # With offsets of -5 % no pixel reads the top code, so only the charge determines saturation.
    for name in ("default pixel", "data sheet"):
        physics = replace(derive(pixels[name]), prnu=0.0, dark_current_e_per_s=0.0)
        well_e = physics.full_well_e
        lowered = np.full((200, 500), -0.05 * well_e)
        share = float(poisson.sf(math.ceil(well_e) - 1, well_e))
        scale = math.sqrt(share * (1 - share) / lowered.size)
        alone, source = _saturated_of(physics, well_e, lowered), "P(N ≥ full well) of Poisson counts"
        yield compare_drawn(f"{name}, light equal to the full well, below the top code", share, alone, scale, source)
        # With the usual offsets, noise raises some of the other pixels to the top code.
        counts = np.arange(math.ceil(well_e))
        top_e = (2**physics.pixel.bits - 1.5 - physics.pixel.black_level_dn) / physics.dn_per_e
        noise_e = math.hypot(physics.reset_noise_e, physics.read_noise_e, physics.offset_fpn_e)
        share += float((poisson.pmf(counts, well_e) * norm.sf((top_e - counts) / noise_e)).sum())
        scale = math.sqrt(share * (1 - share) / lowered.size)
        both = _saturated_of(replace(physics, column_fpn_e=0.0), well_e)
        source = "P(N ≥ full well) + Σ P(N = n < full well) P(noise raises n to the top code)"
        yield compare_drawn(f"{name}, light equal to the full well", share, both, scale, source)


def _saturated_of(physics: PixelPhysics, mean_e: float, offset_e: Array | None = None) -> float:
    """Saturated fraction of 100 000 pixels under uniform light for 30 ms; `offset_e` replaces the sensor's offsets."""
    sensor = sensors.sample_sensor(physics, (200, 500), np.random.default_rng(0))
    if offset_e is not None:
        sensor = replace(sensor, offset_e=offset_e)
    rate, exposure = np.full(sensor.shape, mean_e / 0.03), Exposure(integration_s=0.03)
    return sensors.capture_from_rates(rate, sensor, exposure, np.random.default_rng(1)).saturated_fraction


def _converters() -> Iterator[ExtremeCase]:
    """A level swept uniformly over codes, so that all rounding errors are equally frequent."""
    bits = np.arange(1, 25)
    means, variances, tops = [], [], []
    for count in bits:
        top = 2 ** int(count) - 1
        # 2^18 levels over a whole number of codes; the number of levels per code is not an integer.
        width = min(top, (1 << 16) - 1)
        level = (top - width) / 2 + width * ((np.arange(1 << 18) + 0.5) / (1 << 18))
        error = sensors.quantise(level, int(count)) - level
        means.append(error.mean())
        variances.append(np.mean(error**2))
        tops.append(sensors.quantise(np.array([-1e30, 1e30, top + 0.49]), int(count)))
    source = "symmetry: rounding is unbiased over a whole number of codes"
    yield compare("ADC of 1 … 24 bits: mean error in codes", 0.0, means, 1e-9, source, scale=1.0)
    source = "1/12: uniform error of ± half a code; steps of the sweep"
    yield compare("ADC of 1 … 24 bits: mean square error", 1 / 12, variances, 1e-8, source)
    ends = np.stack([np.zeros(24), 2.0**bits - 1, 2.0**bits - 1], axis=1)
    yield compare("ADC of 1 … 24 bits: codes beyond both ends", ends, np.stack(tops), 0.0, "exactly 0 and 2^n - 1")
    quiet = [frame(physics_of(full_well_e=2.0**n - 1, bits=int(n)), 0.0, shape=(4, 4)).max() for n in bits]
    yield compare("no light and no noise, 1 … 24 bits", 0.0, quiet, 0.0, "exactly 0")
    wide = physics_of(full_well_e=1e12, bits=24, black_level_dn=1000)
    codes = frame(wide, 0.5e12)
    error = math.sqrt((0.5e12 * wide.dn_per_e**2 + 1 / 12) / codes.size)
    mean, source = 1000 + (2**24 - 1001) / 2, "black level + half of the codes above it"
    yield compare_drawn("zero read noise, 24 bits: mean code", mean, codes.mean(), error, source)
    variance = 0.5e12 * ((2**24 - 1001) / 1e12) ** 2 + 1 / 12
    error = variance * math.sqrt(2 / codes.size)
    yield compare_drawn("zero read noise, 24 bits: variance", variance, codes.var(), error, "shot noise + 1/12")


def gains() -> Iterator[ExtremeCase]:
    """Read noise before the amplifier is that of the electrons, noise behind it that of the codes."""
    gains_db = (0.0, 0.1, 6.0, 20.0, 40.0, 60.0)
    times = 10 ** (np.array(gains_db) / 20)
    noisy = physics_of(full_well_e=1e5, bits=16, black_level_dn=4000, read_noise_e=0.5, read_noise_after_gain_e=30.0)
    per_e = (2**16 - 4001) / 1e5
    codes = np.stack([frame(noisy.at_gain(gain_db), 0.0) for gain_db in gains_db])
    variances = per_e**2 * ((0.5 * times) ** 2 + 30**2) + 1 / 12
    errors = (codes.var(axis=(1, 2)) - variances) / (variances * math.sqrt(2 / codes[0].size))
    source = "(before · gain)² + after² + 1/12, in codes"
    yield compare_drawn("dark variance at 0 … 60 dB, in standard errors", 0.0, errors, 1.0, source)
    off = (codes.mean(axis=(1, 2)) - 4000) / np.sqrt(variances / codes[0].size)
    yield compare_drawn("mean dark code at 0 … 60 dB, in standard errors", 0.0, off, 1.0, "the black level")
    half_e = 0.5 * 1e5 / times
    means = np.array([frame(noisy.at_gain(g), e).mean() for g, e in zip(gains_db, half_e.tolist(), strict=True)])
    error = np.sqrt((per_e**2 * (half_e * times**2 + (0.5 * times) ** 2 + 30**2) + 1 / 12) / codes[0].size)
    wanted = 4000 + (2**16 - 4001) / 2
    name = "half of the ADC's range at 0 … 60 dB: mean code, in standard errors"
    yield compare_drawn(name, 0.0, (means - wanted) / error, 1.0, "half of the codes above black")
    above = zip(gains_db[2:], times.tolist()[2:], strict=True)
    full = [frame(noisy.at_gain(gain_db), 4e5 / gain, shape=(4, 4)).min() for gain_db, gain in above]
    yield compare("four times the ADC's range at 6 … 60 dB: every code", 65535.0, full, 0.0, "exactly the top code")


def stacks() -> Iterator[ExtremeCase]:
    """Shares of light that photodiodes below microlenses and openings collect."""
    fills, heights_um = (1e-12, 1e-6, 0.3, 1.0), (1e-3, 1.0, 1e4)
    bare = [stack_collection(3.0, 3 * math.sqrt(f), h, 1.5, f_number=1e12, microlens=False) for f in fills for h in heights_um]
    wanted = [fill for fill in fills for _ in heights_um]
    yield compare(
        "bare pixel behind a pinhole, FF 1e-12 … 1, height 1 nm … 10 mm", wanted, [s[1, 1] for s in bare], ROUNDING, "fill factor"
    )
    lenses = [(n, h, i) for n in (0.5, 1.4, 8.0, 1e3, 1e6) for h in (4.0, 100.0, 1e4) for i in (1.0, 1.5, 10.0)]

    def spread_um(f_number: float, height_um: float, index: float) -> float:
        return height_um / (index * math.hypot(1.0, 2 * f_number))

    def share(f_number: float, height_um: float, index: float, side_um: float, **more: Any) -> float:
        shares = stack_collection(6.0, side_um, height_um, index, f_number=f_number, refraction="paraxial", **more)
        return float(shares[1, 1])

    small = [(lens, min(0.7 * spread_um(*lens), 6.0)) for lens in lenses]  # its corner is within the disc of light
    inside = [share(*lens, side) * math.pi * (spread_um(*lens) / side) ** 2 for lens, side in small]
    source = "photodiode over disc, w²/(π (h NA/n)²); rounding of boundaries 1e-11 of a pupil"
    yield compare("small photodiodes under microlenses, f/0.5 … f/1e6, height 4 µm … 10 mm, n 1 … 10", 1.0, inside, 1e-11, source)
    wide = [lens for lens in lenses if 2 * spread_um(*lens) < 5.9]
    all_of_it = [share(*lens, 2 * spread_um(*lens)) for lens in wide]
    source = "1 at N = √((h/nw)² - ¼), where the disc touches the photodiode's sides"
    yield compare("photodiodes as wide as the disc, f/0.5 … f/1e6", 1.0, all_of_it, 1e-11, source)
    whole = [
        stack_collection(6.0, 6.0, h, 1.5, f_number=n, chief_ray_deg=deg, azimuth_deg=30.0, microlens=lens).sum()
        for n in (0.7, 4.0, 1e3) for deg in (0.0, 20.0) for lens in (True, False) for h in (3.5, 5.0)
    ]  # fmt: skip
    yield compare("photodiodes as wide as their pixels, 0 and 20°: all nine", 1.0, whole, 1e-11, "conservation")
    side, high_um = 1e-3, 1e3
    shifted = Stack(6.0, side, high_um, 1.5, microlens=True, shift_um="optimal")
    pupil = disc_pupil(1e-10, [0.0, 30.0, 60.0, 89.0], 40.0)
    hit = collected_shares(shifted, pupil)[:, 2, 2]
    yield compare("chief rays of 0 … 89°, optimal shift, 1 mm below", 1.0, hit, 0.0, "exactly 1: on the centre of 1 nm")
    nodes, weights = np.polynomial.legendre.leggauss(400)
    nm = np.array([300.0, 550.0, 1200.0])
    low = Stack(1.0, 0.4, 3.0, 1.5, microlens=True)
    half = 0.4 * 1.5 / (2 * 3e-3 * nm)  # of the photodiode, in spots
    energy = (half * (np.sinc(half[:, None] * nodes) ** 2 @ weights)) ** 2
    spots = collected_shares(low, disc_pupil(0.0), nm)[:, 2, 2]
    yield compare("diffraction of a microlens of 1 µm, 300 … 1200 nm", energy, spots, 1e-7, "∫ sinc² by quadrature; table 2e-8")
    fast = [(f, share(0.5, h, 1.5, 6 * math.sqrt(f))) for f in (1e-6, 0.1, 0.9) for h in (3.3852, 4.0, 1e4)]
    over = [max(0.0, got - f * 1.5**2 / 0.5) for f, got in fast]
    yield compare("light beyond étendue at f/0.5, from the lowest microlens on", 0.0, over, 0.0, "at most FF · n²/NA²")


def _temperatures() -> Iterator[ExtremeCase]:
    options = {"dark_current_e_per_s": None, "reset_noise_factor": 1.0}
    cold = [physics_of(temperature_k=float(t), **options) for t in TEMPERATURES_K]
    doubling_k = load_technology("0.35um").dark_doubling_k
    # The technology gives the dark current at 300.15 K: nA/cm² · area / q.
    quoted = load_technology("0.35um").dark_current_na_per_cm2 * 1e-9 * 0.5 * (6.5e-4) ** 2 / ELECTRON_C
    expected = quoted * 2 ** ((TEMPERATURES_K - 300.15) / doubling_k)
    source = f"doubling every {doubling_k:g} K; rounding"
    yield compare("dark current at 77 … 400 K", expected, [p.dark_current_e_per_s for p in cold], ROUNDING, source)
    noise = np.array([p.reset_noise_e for p in cold])
    yield compare("kTC noise at 77 … 400 K over that at 77 K", np.sqrt(TEMPERATURES_K / 77), noise / noise[0], ROUNDING, "√T")
    j = load_technology("0.35um").junction
    assert j is not None
    c_ff = _junction_ff(j, 0.5 * 6.5**2, j.reset_voltage_v)
    ktc = math.sqrt(BOLTZMANN_J_PER_K * 400 * c_ff * 1e-15) / ELECTRON_C
    yield compare("kTC noise at 400 K", ktc, noise[-1], ROUNDING, "√(kTC)/q with C at the reset voltage")


def _fixed_patterns() -> Iterator[ExtremeCase]:
    """Dark-current maps from DSNU near 0 to 1, the maximum: mean 1 and the given standard deviation."""
    n = 200_000
    spreads = (1e-30, 1e-9, 0.02, 0.3, 1.0)
    means, deviations = [], []
    for seed, dsnu in enumerate(spreads):
        physics = physics_of(dsnu=dsnu, dark_current_e_per_s=1.0)
        drawn = sensors.sample_sensor(physics, (400, 500), np.random.default_rng(seed)).dark_gain
        gain = np.ones((400, 500)) if drawn is None else drawn
        means.append((gain.mean() - 1) / (dsnu / math.sqrt(n) + 1e-15))
        # The fourth central moment of a gamma variable of mean 1 is (3 + 6 s²) s⁴.
        deviations.append((np.mean((gain - 1) ** 2) - dsnu**2) / (dsnu**2 * math.sqrt((2 + 6 * dsnu**2) / n) + 1e-25))
    name = "DSNU 1e-30 … 1, 200 000 pixels each: {}, in standard errors"
    yield compare_drawn(name.format("mean"), 0.0, means, 1.0, "1")
    yield compare_drawn(name.format("variance"), 0.0, deviations, 1.0, "DSNU²")
