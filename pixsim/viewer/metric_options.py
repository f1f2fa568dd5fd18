"""Settings of the metrics."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Annotated, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from pixsim.base.records import NumberOrText, Record, UnitInterval, as_list
from pixsim.light.quantities import Fraction

Illuminance = Annotated[float, Field(ge=1e-9, le=1e9)]
Length = Annotated[float, Field(ge=1e-6, le=1e9)]
MetricNames = Annotated[
    tuple[Annotated[str, Field(pattern=r"^[A-Za-z_]\w*$", max_length=60)], ...], Field(min_length=1)
]


NO_CONTRAST: dict[str, NumberOrText] = {"contrast": 0.0}
PAIRS = re.compile(r"\s*[A-Za-z_]\w*\s*=[^,=]+(,\s*[A-Za-z_]\w*\s*=[^,=]+)*")


def _as_table(value: object) -> object:
    """Convert the text name=value,… of a command line to a table."""
    if not (isinstance(value, str) and PAIRS.fullmatch(value)):
        return value
    return {
        name.strip(): text.strip()
        for name, _, text in (pair.partition("=") for pair in value.split(","))
    }


class Detectability(Record):
    """Settings of the metric detectability."""

    without: Annotated[str | dict[str, NumberOrText], BeforeValidator(_as_table)] = Field(
        NO_CONTRAST,
        description=(
            "the scene without the target: values of the scene's parameters, such as contrast=0; or"
            " another scene, a file or a packaged name; of light that is given in a file, a file of"
            " light"
        ),
    )
    registrations: Annotated[int, Field(ge=1, le=1000)] = Field(
        16,
        description=(
            "least number of positions of the pixels under the target, over all frames of a pixel"
            " size"
        ),
    )
    threshold: Annotated[float, Field(ge=1e-3, le=1e3)] = Field(
        5.0, description="d′ at which a target counts as seen; Rose (1948) has 5"
    )
    solve_for: Annotated[str, Field(pattern=r"^[A-Za-z_]\w*$", max_length=60)] | None = Field(
        None,
        description=(
            "parameter of the scene, as contrast, size_mm or lux, whose value at this threshold a"
            " run searches for, starting from its own (absent: none)"
        ),
    )


class Information(Record):
    """Settings of the metric information."""

    spectrum: Literal["natural", "scene"] = Field(
        "natural",
        description=(
            "'natural': power C/(f² + f₀²), of natural scenes; 'scene': that of the scene's own"
            " light, radially averaged"
        ),
    )
    contrast: Annotated[float, Field(ge=1e-6, le=10)] = Field(
        0.15,
        description="of a natural spectrum: rms contrast in an octave of frequencies far above f₀",
    )
    corner_cy_per_mm: Annotated[float, Field(ge=1e-6, le=1e6)] | None = Field(
        None, description="of a natural spectrum: f₀ on the sensor (absent: a cycle across the die)"
    )

    @property
    def other_contrasts(self) -> tuple[float, float] | None:
        """A third of the contrast, and three times the contrast, limited to 1 but not below the
        contrast; None for the spectrum of the scene.
        """
        if self.spectrum == "scene":
            return None
        return self.contrast / 3, max(self.contrast, min(3 * self.contrast, 1.0))


class _SnrIlluminance(Record):
    """Settings of the metric snr10_lx."""

    snr: Annotated[float, Field(ge=0.1, le=1e6)] = Field(
        10.0, description="signal to noise ratio of a dot of the display"
    )
    reflectance: Fraction = Field(0.18, description="of the wall")
    integration_s: Annotated[float, Field(ge=1e-9, le=1e6)] = Field(
        1 / 30, description="integration time"
    )


class ContrastDetection(Record):
    """Settings of the metric contrast_detection_probability."""

    contrast: Annotated[float, Field(ge=1e-4, le=100)] = Field(
        0.1, description="Weber contrast of a brighter pixel to each pixel of the frame"
    )
    tolerance: Annotated[float, Field(ge=1e-3, le=1)] = Field(
        0.5, description="contrasts that differ by at most this share count as detected"
    )


class Niirs(Record):
    """Settings of the metric niirs."""

    ground_distance_m: Length | None = Field(
        None, description="of the ground from the lens (absent: that of the plane in focus)"
    )
    reflectances: Annotated[tuple[UnitInterval, UnitInterval], BeforeValidator(as_list)] = Field(
        (0.07, 0.15), description="of two surfaces whose difference is the signal of SNR"
    )

    @model_validator(mode="after")
    def _surfaces_differ(self) -> Self:
        if self.reflectances[0] == self.reflectances[1]:
            raise ValueError(
                f"reflectances = {list(self.reflectances)}, which are equal; give those of two"
                " surfaces that differ"
            )
        return self


class MetricOptions(Record):
    """Settings of the metrics, each in a table of its name."""

    detectability: Detectability = Field(Detectability(), description="settings of detectability")
    information: Information = Field(Information(), description="settings of information")
    snr10_lx: _SnrIlluminance = Field(_SnrIlluminance(), description="settings of snr10_lx")
    niirs: Niirs = Field(Niirs(), description="settings of niirs")
    contrast_detection_probability: ContrastDetection = Field(
        ContrastDetection(), description="settings of contrast_detection_probability"
    )


METRIC_OPTIONS = MetricOptions()

# Metrics that ask for the light of the scene without its target.
_TARGET_METRICS = ("detectability", "npwe")


def has_target(metrics: Sequence[str]) -> bool:
    """Return whether some metrics, by their names, ask for the light of the scene without its
    target.
    """
    return any(name in metrics for name in _TARGET_METRICS)
