"""How sure a mean ΔE is, in words: the error of its film, the noise of its render, and causes beside the sensor's noise and blur.

What is largest is named first.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from pixsim.base.headline import NOT_CONVERGED
from pixsim.base.notes import told_apart
from pixsim.show.sentences import with_error

NOTHING = "the frame tells nothing"


@dataclass(frozen=True)
class Cause:
    """A cause of a mean ΔE.

    words : for the headline
    delta_e : how much of ΔE it can make, which decides on the order of causes
    hint : what removes it
    """

    words: str
    delta_e: float
    hint: str

    def __str__(self) -> str:
        return f"{self.words}: {self.hint}"

    @property
    def leaves_nothing(self) -> bool:
        """Whether the frame tells nothing of the light."""
        return self.words.startswith(NOTHING)

    def as_dict(self) -> dict[str, Any]:
        """Return the cause as in score.json."""
        return asdict(self)


def cause_words(causes: Sequence[Cause]) -> str:
    """Return the largest of some causes in brackets, the first one; empty without any."""
    return f" ({causes[0].words}{', …' if len(causes) > 1 else ''})" if causes else ""


@dataclass(frozen=True)
class LightError:
    """Errors of a mean ΔE by the light behind it; their limits stand in the settings.

    film_delta_e : largest error by the film; NaN if it is unknown, None if it was not measured
    noise_delta_e : largest error by the noise of the render; NaN if it is unknown, None if no noise was measured
    film_words, noise_words : error and limit in words, where the error is above its limit; else empty
    rendered : whether pixsim rendered the light, and so could have measured both
    causes : of the mean ΔE beside the sensor's noise and blur, the largest first
    """

    film_delta_e: float | None = None
    noise_delta_e: float | None = None
    film_words: str = ""
    noise_words: str = ""
    rendered: bool = False
    causes: tuple[Cause, ...] = ()

    @classmethod
    def of(cls, header: Mapping[str, Any], film: Mapping[str, Any] | None = None, causes: Iterable[Cause] = ()) -> LightError:
        """Return the errors that the header of an irradiance and an entry `film` of score.json state.

        header : that of a file of another program may hold anything
        """
        film_delta_e: float | None = None
        film_words = ""
        if film is not None:
            film_delta_e = math.nan if film["delta_e"] is None else float(film["delta_e"])
        if film is not None and film_delta_e is not None and not film["met"]:
            error, limit = told_apart(film_delta_e, min(film["tolerated_delta_e"]), 1)
            size = "unknown" if math.isnan(film_delta_e) else f"up to {error} ΔE"
            film_words = f"the film's error is {size}, {limit} tolerated"

        noise_delta_e, noise_words = None, ""
        if (measured := noise_and_limit(header)) is not None:
            delta_e = header["render_noise"].get("delta_e")
            noise_delta_e = delta_e if isinstance(delta_e, float | int) else math.nan
            words = "render noise is {} of the sensor's noise, target {}"
            if header["render_noise"].get("tolerance_delta_e") is not None:
                words = "render noise makes up to {} ΔE, {} tolerated"
            noise_words = words.format(*told_apart(*measured)) if measured[0] > measured[1] else ""

        return cls(film_delta_e, noise_delta_e, film_words, noise_words, "scene_hash" in header, tuple(causes))

    @property
    def converged(self) -> bool:
        """Whether no error is known to be above its limit."""
        return not (self.film_words or self.noise_words)

    def shown(self, mean_delta_e: float, half_delta_e: float = 0.0) -> str:
        """Return `number`, and whether it has converged.

        >>> LightError().shown(0.9731), LightError(0.6, film_words="0.02 tolerated").shown(0.9731)
        ('0.973', '1.0 ± 0.6 (film), not converged')
        """
        return self.number(mean_delta_e, half_delta_e) + ("" if self.converged else f", {NOT_CONVERGED}")

    def number(self, mean_delta_e: float, half_delta_e: float = 0.0) -> str:
        """Return a mean ΔE as text, with the film's error if that is above its limit, and with its largest cause.

        half_delta_e : half of its 95 % interval, of several sensors

        "…" stands for smaller causes, which the lines below a headline name.

        >>> LightError().number(0.97312, 0.0021), LightError(0.6, film_words="0.02 tolerated").number(0.9731, 0.0021)
        ('0.9731 ± 0.0021 (95 %)', '1.0 ± 0.6 (95 % and film)')
        >>> few_codes = (Cause("all codes are equal", 100.0, "more bits"),)
        >>> LightError(3.6, film_words="0.02 tolerated", causes=few_codes).number(76.54)
        '76.5 (all codes are equal) ± 3.6 (film)'
        """
        film_delta_e = self.film_delta_e if self.film_words and self.film_delta_e is not None else 0.0
        value, error = f"{mean_delta_e:.3f}", ""
        if math.isnan(film_delta_e):
            error = " ± an unknown error (film)"
        elif film_delta_e or half_delta_e:
            value, _, error = with_error(mean_delta_e, half_delta_e + film_delta_e).partition(" ")
            parts = ["95 %"] * (half_delta_e > 0) + ["film"] * (film_delta_e > 0)
            error = f" {error} ({' and '.join(parts)})"
        cause = cause_words(self.causes)
        return f"{value}{error}{cause}" if cause and self.causes[0].delta_e < film_delta_e else f"{value}{cause}{error}"

    @property
    def errors(self) -> list[tuple[float, str]]:
        """The errors above their limits, the largest first: ΔE and words; an unknown one is infinite."""
        errors = []
        if self.film_words and self.film_delta_e is not None:
            errors.append((math.inf if math.isnan(self.film_delta_e) else self.film_delta_e, self.film_words))
        if self.noise_words:
            noise_delta_e = self.noise_delta_e or 0.0
            errors.append((0.0 if math.isnan(noise_delta_e) else noise_delta_e, self.noise_words))
        return sorted(errors, key=lambda error: -error[0])

    @property
    def unmeasured(self) -> str:
        """What was not measured of light that pixsim rendered, in words; empty for nothing."""
        parts = ["the film's error"] * (self.film_delta_e is None) + ["render noise"] * (self.noise_delta_e is None)
        return f"{' and '.join(parts)} not measured" if self.rendered and parts else ""


def noise_and_limit(header: Mapping[str, Any]) -> tuple[float, float] | None:
    """Return the noise of a render with its limit: in ΔE with a tolerance, else as fractions of the sensor's noise.

    header : of an irradiance; that of a file of another program may hold anything, and gives None
    """
    noise = header.get("render_noise")
    if not isinstance(noise, Mapping):
        return None
    names = ("fraction", "target") if noise.get("tolerance_delta_e") is None else ("delta_e", "tolerance_delta_e")
    value, limit = (noise.get(name) for name in names)
    return (value, limit) if isinstance(value, float | int) and isinstance(limit, float | int) else None


NOTHING_KNOWN = LightError()
