"""How sure a mean ΔE is, in words: the error of its film, the noise of its render, and causes beside the sensor's noise and blur.

What is largest is named first.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from pixsim.base.headline import NOT_CONVERGED
from pixsim.base.notes import told_apart
from pixsim.show.sentences import with_error
from pixsim.viewer.causes import Cause


def cause_words(causes: Sequence[Cause]) -> str:
    """Return the largest of some causes in brackets, the first one; empty without any."""
    return f" ({causes[0].words}{', …' if len(causes) > 1 else ''})" if causes else ""


@dataclass(frozen=True)
class LightError:
    """Errors of the light behind a mean ΔE, each with the limit that it was given.

    film_delta_e : largest error of the mean ΔE that the film may cause; NaN if it is unknown, None if it was not measured
    tolerated_delta_e : for it
    noise : of the render, as a fraction of the sensor's noise; None if it was not measured
    noise_target : for it
    rendered : whether pixsim rendered the light, and so could have measured both
    causes : of the mean ΔE beside the sensor's noise and blur, the largest first
    """

    film_delta_e: float | None = None
    tolerated_delta_e: float = math.inf
    noise: float | None = None
    noise_target: float = math.inf
    rendered: bool = False
    causes: tuple[Cause, ...] = ()

    @classmethod
    def of(cls, header: Mapping[str, Any], film: Mapping[str, Any] | None = None, causes: Iterable[Cause] = ()) -> LightError:
        """Return the errors that the header of an irradiance and an entry `film` of score.json state.

        header : that of a file of another program may hold anything
        """
        found = header.get("render_noise")
        noise = found if isinstance(found, Mapping) else {}
        fraction, target = noise.get("fraction"), noise.get("target")
        light = cls(rendered="scene_hash" in header, causes=tuple(causes))
        if isinstance(fraction, float | int) and isinstance(target, float | int):
            light = replace(light, noise=fraction, noise_target=target)
        if film is None:
            return light
        error, tolerated = film["delta_e"], math.inf if film["met"] else min(film["tolerated_delta_e"])
        return replace(light, film_delta_e=math.nan if error is None else error, tolerated_delta_e=tolerated)

    @property
    def film_is_met(self) -> bool:
        """Whether the error of the film is tolerated, or was not measured."""
        return self.film_delta_e is None or math.isinf(self.tolerated_delta_e) or self.film_delta_e <= self.tolerated_delta_e

    @property
    def noise_is_met(self) -> bool:
        """Whether the noise is at most its target, or was not measured."""
        return self.noise is None or self.noise <= self.noise_target

    @property
    def converged(self) -> bool:
        """Whether no error is known to be above its limit."""
        return self.film_is_met and self.noise_is_met

    def shown(self, mean_delta_e: float, half_delta_e: float = 0.0) -> str:
        """Return `number`, and whether it has converged.

        >>> LightError().shown(0.9731), LightError(0.6, 0.02).shown(0.9731), LightError(noise=2.4, noise_target=0.2).shown(0.9731)
        ('0.973', '1.0 ± 0.6 (film), not converged', '0.973, not converged')
        """
        return self.number(mean_delta_e, half_delta_e) + ("" if self.converged else f", {NOT_CONVERGED}")

    def number(self, mean_delta_e: float, half_delta_e: float = 0.0) -> str:
        """Return a mean ΔE as text, with the film's error if that is above its limit, and with its largest cause.

        half_delta_e : half of its 95 % interval, of several sensors

        "…" stands for smaller causes, which the lines below a headline name.

        >>> LightError().number(0.97312, 0.0021), LightError(0.6, 0.02).number(0.9731, 0.0021)
        ('0.9731 ± 0.0021 (95 %)', '1.0 ± 0.6 (95 % and film)')
        >>> LightError(3.6, 0.02, causes=(Cause("all codes are equal", 100.0, "more bits"),)).number(76.54)
        '76.5 (all codes are equal) ± 3.6 (film)'
        """
        film = 0.0 if self.film_is_met or self.film_delta_e is None else self.film_delta_e
        value, error = f"{mean_delta_e:.3f}", ""
        if math.isnan(film):
            error = " ± an unknown error (film)"
        elif film or half_delta_e:
            value, _, error = with_error(mean_delta_e, half_delta_e + film).partition(" ")
            error = f" {error} ({' and '.join(['95 %'] * (half_delta_e > 0) + ['film'] * (film > 0))})"
        cause = cause_words(self.causes)
        return f"{value}{error}{cause}" if cause and self.causes[0].delta_e < film else f"{value}{cause}{error}"

    def errors(self, mean_delta_e: float) -> list[tuple[float, str]]:
        """Return the errors above their limits, the largest first: how much of this mean ΔE each can make, and its words.

        Noise of the render that is f of the sensor's noise makes at most 1 - 1/√(1 + f²) of it.
        """
        found = []
        if not self.film_is_met and self.film_delta_e is not None:
            error, most = told_apart(self.film_delta_e, self.tolerated_delta_e, 1)
            size = "unknown" if math.isnan(self.film_delta_e) else f"up to {error} ΔE"
            found.append(
                (math.inf if math.isnan(self.film_delta_e) else self.film_delta_e, f"the film's error is {size}, {most} tolerated")
            )
        if not self.noise_is_met and self.noise is not None:
            part = mean_delta_e * (1 - 1 / math.hypot(1.0, self.noise))
            words = "render noise is {} of the sensor's noise, target {}".format(*told_apart(self.noise, self.noise_target))
            found.append((part, words))
        return sorted(found, key=lambda one: -one[0])

    @property
    def unmeasured(self) -> str:
        """What was not measured of light that pixsim rendered, in words; empty for nothing."""
        parts = ["the film's error"] * (self.film_delta_e is None) + ["render noise"] * (self.noise is None)
        return f"{' and '.join(parts)} not measured" if self.rendered and parts else ""


NOTHING_KNOWN = LightError()
