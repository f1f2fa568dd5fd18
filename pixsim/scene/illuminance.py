"""The illuminance that a lit scene states, and all of its lamps made stronger or weaker by one
factor.

A scene states it by `<default name="lux" value="E"/>`, which only pixsim reads: what a lux meter
shows at a place that the scene's author chose, with the lamps as the file has them. Light is linear
in its lamps, so another illuminance is a factor.
"""

from __future__ import annotations

from collections.abc import Sequence

from pixsim.base.errors import invalid
from pixsim.light.quantities import ILLUMINANCE
from pixsim.scene.contents import Lamp

# Starlight has 1e-4, the sun 1e5; beyond, float32 would not hold all of the light.
_ALLOWED_LUX = (1e-9, 1e9)
_BALANCE = 1e-6  # by which the ratios of lamps may differ through rounding


def strength(
    lux: float,
    stated_lux: float,
    written_lamps: Sequence[Lamp],
    lamps: Sequence[Lamp],
    parameters: Sequence[str],
) -> float:
    """Return the factor for all lamps that gives the scene's place an illuminance of `lux`.

    stated_lux : of the scene's place, under the lamps as its file has them
    written_lamps : of the file
    lamps : with the parameters of the user, named `parameters`

    Raises PixsimError if the parameters change the lamps' balance, or if their light is unknown or
    invisible.
    """
    got = f"'{lux:g}' together with {', '.join(parameters)}" if parameters else f"'{lux:g}'"
    low, high = _ALLOWED_LUX
    if not low <= lux <= high:
        raise invalid(ILLUMINANCE, f"'{lux:g}'", f"{low:g} to {high:g} lx")

    before = luminances(written_lamps)
    after = luminances(lamps)
    is_stated = all(lamp.spectrum is not None for lamp in (*written_lamps, *lamps))
    is_seen = all(any(lamp.has_luminance for lamp in light) for light in (written_lamps, lamps))
    if not is_stated or not is_seen:
        raise invalid(
            ILLUMINANCE,
            f"{got}, but the light of the emitters is unknown or 0",
            "emitters of visible light, in tables",
        )

    # One factor for all lamps: the same ones shine, in the same ratios.
    shine_before = {index for index, luminance in before.items() if luminance > 0}
    ratios = [after[index] / before[index] for index in shine_before & after.keys()]
    dark_stay_dark = all(after.get(index) == 0 for index in before.keys() - shine_before)
    same_lamps = before.keys() == after.keys() and dark_stay_dark
    if not same_lamps or max(ratios) - min(ratios) > _BALANCE * max(ratios):
        raise invalid(
            ILLUMINANCE,
            f"{got}, with a different balance of the lamps",
            "the balance in the scene's file, the only one for which the illuminance is known",
            "Set only the lamps' own parameters.",
        )
    return lux / stated_lux / max(ratios)


def luminances(lamps: Sequence[Lamp]) -> dict[int, float]:
    """Return emitter node -> luminance: of a picture where its texel value is 1; of distant
    emitters the illuminance.
    """
    emitter_luminance = {}
    for lamp in lamps:
        luminance = lamp.luminance_cd_per_m2
        for index, (_, power) in lamp.pictures.items():
            emitter_luminance[index] = luminance * (power if isinstance(power, float) else 1.0)
    return emitter_luminance
