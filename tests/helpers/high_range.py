"""Pixels of several readings with published or independently computed numbers, and the signal-to-
noise ratios that they must have.
"""

from typing import NamedTuple

from pixsim import Pixel

SHEET = {
    "pitch_um": 2.8,
    "full_well_e": 22000,
    "read_noise_e": 0.83,
    "dark_current_e_per_s": 0,
    "quantum_efficiency": 0.6,
    "bits": 12,
}
DUAL = {"kind": "dual_gain", "conversion_gain_uv_per_e": [200, 49], "read_noise_e": [0.83, 3.05]}


def pixel(readout: dict | None, *, at_limit: bool = False, **over) -> Pixel:
    """A data sheet; `at_limit` has readings that are valid up to their limit."""
    if readout is not None and at_limit:
        readout = readout | {"validity_sigmas": 0}
    return Pixel(**SHEET | over, readout=readout)


def split_of_three(small_noise_e: float = 2.96, **over) -> dict:
    """Solhusvik et al., IISW 2019, R32, table 1."""
    return {
        "collector": [{"name": "large"}, {"name": "small", "response": 0.01, "full_well_e": 7900}],
        "reading": [
            {
                "name": name,
                "collector": collector,
                "conversion_gain_uv_per_e": gain,
                "read_noise_e": noise_e,
            }
            for name, collector, gain, noise_e in (
                ("high", "large", 200, 0.83),
                ("low", "large", 49, 3.05),
                ("small", "small", 49, small_noise_e),
            )
        ],
    } | over


def staggered(ratio: float, *, at_limit: bool = True, **over) -> Pixel:
    readout = {"kind": "staggered", "ratio": ratio} | over
    return pixel(readout, at_limit=at_limit, full_well_e=10_000, read_noise_e=2)


def overflow(low: float, full_well_e: float = 1000.0, resets: float = 1) -> Pixel:
    """A lateral overflow capacitor; amplifier noise is left out."""
    readout = {
        "kind": "overflow",
        "conversion_gain_uv_per_e": [160, low],
        "capacity_e": 100_000,
        "read_noise_e": [0, 0],
        "resets": resets,
    }
    return pixel(readout, at_limit=True, full_well_e=full_well_e, temperature_k=300)


class Level(NamedTuple):
    """A signal-to-noise ratio at a level, without rounding and dark charge.

    reading : that is alone, or None for the merge
    digits : of the number
    """

    name: str
    sensor: Pixel
    charge_e: float
    reading: str | None
    snr_db: float
    digits: int = 2


OVT = pixel(split_of_three(), at_limit=True)
OVT_083 = pixel(split_of_three(0.83), at_limit=True)
LEVELS = [
    Level("high gain at its limit", OVT, 5390, "high", 37.315, 3),
    Level("low gain there", OVT, 5390, "low", 37.308, 3),
    Level("large diode at its limit", OVT, 22_000, "low", 43.42),
    Level("small diode there, .83 e-", OVT_083, 22_000, "small", 23.41),
    Level("small diode there, 2.96 e-", OVT, 22_000, "small", 23.25),
    Level("small diode full, .83 e-", OVT_083, 790_000, None, 38.98),
    Level("small diode full, 2.96 e-", OVT, 790_000, None, 38.97),
    Level("start of the range at 0 dB", OVT, 1.469, None, 0.0),
    Level("start of the range at 20 dB", OVT, 100.68, None, 20.0),
    Level("start of the range at 30 dB", OVT, 1000.7, None, 30.0),
    Level("end of the gap at 30 dB", OVT, 100_869, None, 30.0),
    Level("long exposure, ratio 4", staggered(4), 10_000, "long", 40.00),
    *(
        Level(f"short exposure, ratio {ratio}", staggered(ratio), 1e4, "short1", db)
        for ratio, db in ((4, 33.97), (8, 30.96), (16, 27.93), (32, 24.89))
    ),
    *(
        Level(
            f"both exposures at {level} e-, {merge}",
            staggered(16, merge=merge),
            level,
            None,
            db,
            digits,
        )
        for level, digits, merged_db, long_db in (
            (100, 3, 19.998, 19.830),
            (1000, 3, 30.232, 29.983),
            (9000, 2, 39.80, 39.54),
        )
        for merge, db in (("max_likelihood", merged_db), ("select", long_db))
    ),
    Level("160 µV/e- at 1000 e-", overflow(10), 1000, "high", 30.0),
    Level("10 µV/e- at 1000 e-", overflow(10), 1000, "low", 24.45),
    Level("40 µV/e- at 1000 e-", overflow(40), 1000, "low", 27.84),
    Level("160 µV/e- at 5000 e-", overflow(10, 5000), 5000, "high", 36.99),
    Level("10 µV/e- at 5000 e-", overflow(10, 5000), 5000, "low", 35.18),
    Level("two resets at 1000 e-", overflow(10, resets=2), 1000, "low", 22.10),
    Level("two resets at 5000 e-", overflow(10, 5000, 2), 5000, "low", 33.91),
]
