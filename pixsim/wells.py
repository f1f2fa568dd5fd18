"""How much charge a pixel keeps: its junctions' capacitance over the biases that are used, or a pinned photodiode's density."""

from __future__ import annotations

import math
from dataclasses import dataclass

from pixsim.errors import refuse
from pixsim.junction import BOLTZMANN_J_PER_K, C_PER_FF_V, ELECTRON_C, Diode
from pixsim.parameters import Pixel
from pixsim.technology import Junction, Technology

# The `paper` capacitance: fitted to the axis of Fig. 2a of Chen et al. (2000), 35-70 dB, with the authors' habitual 1 V.
PAPER_NODE_FF, PAPER_FF_PER_UM2, PAPER_SWING_V = 2.6, 0.22, 1.0
WELL_REFERENCE_S = 0.03  # integration time of Fig. 2 of Chen et al. (2000): that of the light that fills a `diode` well


def mean_junction_ff(zero_bias_ff: float, built_in_v: float, grading: float, high_v: float, low_v: float) -> float:
    """Mean over a reverse-bias range of C0 (1 + V/PB)^-M: what turns a swing into a charge."""

    def charge(v: float) -> float:
        return built_in_v / (1 - grading) * (1 + v / built_in_v) ** (1 - grading)

    return zero_bias_ff * (charge(high_v) - charge(low_v)) / (high_v - low_v)


def photodiode_capacitance_ff(area_um2: float, junction: Junction) -> float:
    """Mean capacitance of a square photodiode and its node over the swing: area, sidewall and fixed parts."""
    t = junction
    high_v, low_v = t.reset_voltage_v, t.reset_voltage_v - t.voltage_swing_v
    area_ff = mean_junction_ff(t.cj_ff_per_um2 * area_um2, t.pb_v, t.mj, high_v, low_v)
    side_ff = mean_junction_ff(t.cjsw_ff_per_um * 4 * math.sqrt(area_um2), t.pbsw_v, t.mjsw, high_v, low_v)
    return area_ff + side_ff + t.node_capacitance_ff


def reset_capacitance_ff(area_um2: float, junction: Junction) -> float:
    """Capacitance at the reset voltage, where the reset transistor opens and kTC noise freezes."""
    j, v = junction, junction.reset_voltage_v
    area_ff = j.cj_ff_per_um2 * area_um2 * (1 + v / j.pb_v) ** -j.mj
    side_ff = j.cjsw_ff_per_um * 4 * math.sqrt(area_um2) * (1 + v / j.pbsw_v) ** -j.mjsw
    return area_ff + side_ff + j.node_capacitance_ff


def reset_noise_e(capacitance_ff: float, temperature_k: float, factor: float = 1.0) -> float:
    """√(n kTC)/q, standard deviation."""
    return math.sqrt(factor * BOLTZMANN_J_PER_K * temperature_k * capacitance_ff * C_PER_FF_V) / ELECTRON_C


@dataclass(frozen=True)
class Well:
    """Where the charge is kept. All but the charge is None for a pinned photodiode, whose well is given."""

    full_well_e: float
    mean_ff: float | None = None  # over the biases that the well uses: what the charge sees
    reset_ff: float | None = None  # at the reset voltage: what kTC noise sees
    diode: Diode | None = None


def diode_full_v(diode: Diode) -> float:
    """Reverse bias at which a photodiode that is read down to its forward bias counts as full, V.

    V_oc of the light that discharges it to V = 0 in `WELL_REFERENCE_S`, and no further than where SPICE's tangent of the area
    begins, which a photodiode without a forward current would pass. In swings, at 0.5, 0.35, 0.25 and 0.18 µm and 300 K:

    down to V = 0          2.33  2.00  2.22  2.46   the diode has taken nothing yet: the ADC would clip what is soft
    down to this bias      2.69  2.27  2.59  2.88   -0.24, -0.23, -0.21, -0.16 V: the corner is at the top code
    down to -FC·PB         3.13  2.52  3.14  3.46   never reached: auto exposure would aim into the saturation

    Light of another integration time moves the corner by V_T for each factor e: to 0.98 of the well in 0.1 s, 1.05 in 1 ms.
    """
    zero_bias_e = float(diode.charge_e(diode.reset_voltage_v, diode.reset_voltage_v))
    return max(diode.open_circuit_v(zero_bias_e / WELL_REFERENCE_S), diode.knees_v[0])


def well(pixel: Pixel, technology: Technology, area_um2: float, dark_current_e_per_s: float) -> Well:
    """The junction's charge over the swing or down to the forward bias, by the process or by the paper's constant capacitance;
    or the given density."""
    junction = technology.junction
    if junction is None:
        assert technology.full_well_e_per_um2 is not None  # the record's validator
        refuse_junction_options(pixel, technology)
        return Well(technology.full_well_e_per_um2 * area_um2)
    if pixel.capacitance == "paper":
        mean_ff = reset_ff = PAPER_NODE_FF + PAPER_FF_PER_UM2 * area_um2
        swing_v = PAPER_SWING_V
    else:
        mean_ff, reset_ff = photodiode_capacitance_ff(area_um2, junction), reset_capacitance_ff(area_um2, junction)
        swing_v = junction.voltage_swing_v
    paper_ff = mean_ff if pixel.capacitance == "paper" else None
    diode = make_diode(area_um2, junction, paper_ff, dark_current_e_per_s, pixel.temperature_k)
    if pixel.well_limit == "swing":
        return Well(mean_ff * C_PER_FF_V * swing_v / ELECTRON_C, mean_ff, reset_ff, diode)
    drop_v = junction.reset_voltage_v - diode_full_v(diode)
    full_well_e = float(diode.charge_e(junction.reset_voltage_v, drop_v))
    return Well(full_well_e, full_well_e * ELECTRON_C / C_PER_FF_V / drop_v, reset_ff, diode)


def refuse_junction_options(pixel: Pixel, technology: Technology) -> None:
    """PixsimError where a pixel with a pinned photodiode is asked for what only a junction has."""
    for name, allowed in (("capacitance", "mosis"), ("well_limit", "swing"), ("conversion", "linear")):
        value = getattr(pixel, name)
        if value != allowed:
            told = f"'{allowed}', or a 3T technology: a pinned photodiode's well is given, and its charge is handed over"
            raise refuse(f"pixel.{name}", f"'{value}' for {technology.name}", told)


def make_diode(
    area_um2: float, junction: Junction, constant_ff: float | None, dark_current_e_per_s: float, temperature_k: float
) -> Diode:
    """The square photodiode of a process; of a constant capacitance where one is given."""
    zero = constant_ff is not None
    return Diode(
        area_um2=area_um2,
        perimeter_um=4 * math.sqrt(area_um2),
        cj_ff_per_um2=0.0 if zero else junction.cj_ff_per_um2,
        pb_v=junction.pb_v,
        mj=junction.mj,
        cjsw_ff_per_um=0.0 if zero else junction.cjsw_ff_per_um,
        pbsw_v=junction.pbsw_v,
        mjsw=junction.mjsw,
        node_capacitance_ff=junction.node_capacitance_ff if constant_ff is None else constant_ff,
        reset_voltage_v=junction.reset_voltage_v,
        saturation_current_e_per_s=dark_current_e_per_s,
        temperature_k=temperature_k,
    )
