"""Pixels that are read several times: what collects their charge, and how it is read."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from pixsim.base.records import Record, UnitInterval, as_list
from pixsim.base.toml import packaged_tables
from pixsim.light.quantities import Fraction
from pixsim.sensor.quantities import (
    Current,
    DarkSpread,
    GainSpread,
    NoiseElectrons,
    ResetFactor,
    Well,
)

MAX_READINGS = 8
_ConversionGain = Annotated[float, Field(ge=1e-3, le=1e6)]  # µV/e⁻
_Response = Annotated[float, Field(ge=1e-6, le=1e6)]
_Share = Annotated[float, Field(ge=1e-6, le=1)]
_Time = Annotated[float, Field(ge=0, le=1e9)]


def _as_values(value: object) -> object:
    """A single number as a list of one."""
    return [value] if isinstance(value, int | float) else as_list(value)


_Gains = Annotated[tuple[_ConversionGain, ...], BeforeValidator(_as_values)]
_Wells = Annotated[tuple[Well, ...], BeforeValidator(_as_values)]
_Noises = Annotated[tuple[NoiseElectrons, ...], BeforeValidator(_as_values)]
_Currents = Annotated[tuple[Current, ...], BeforeValidator(_as_values)]
_Responses = Annotated[tuple[_Response, ...], BeforeValidator(_as_values)]


class CollectorOptions(Record):
    """A photodiode during one exposure. Values of None come from the pixel.

    Collectors that differ in start and length alone are exposures of one photodiode, and share its
    fixed pattern.
    """

    name: str = Field(description="name, to which readings refer")
    response: _Response = Field(
        1.0, description="light that it collects in equal times, over that of the first collector"
    )
    full_well_e: Well | None = Field(None, description="full well of the photodiode")
    capacity_e: Annotated[float, Field(ge=0, le=1e18)] = Field(
        0.0, description="charge beyond the full well that an overflow capacitor holds"
    )
    dark_current_e_per_s: Current | None = Field(None, description="dark current")
    capacitor_dark_e_per_s: Current = Field(0.0, description="dark current of the capacitor")
    prnu: GainSpread | None = Field(
        None, description="standard deviation of the gain over its mean"
    )
    dsnu: DarkSpread | None = Field(
        None, description="standard deviation of the dark current over its mean"
    )
    start_s: _Time = Field(0.0, description="start of its exposure, after start_share")
    start_share: _Time = Field(
        0.0, description="share of the integration time after which start_s counts"
    )
    length_share: _Share = Field(
        1.0, description="length of its exposure over the integration time"
    )


class ReadingOptions(Record):
    """One reading of the charge of a collector. Values of None come from the pixel."""

    name: str = Field(description="name, as in Frame.readings")
    collector: str = Field(description="name of the collector that it reads")
    overflow: bool = Field(
        False, description="whether it reads the overflow capacitor with the photodiode"
    )
    conversion_gain_uv_per_e: _ConversionGain | None = Field(
        None, description="conversion gain of the floating diffusion"
    )
    read_noise_e: NoiseElectrons | None = Field(
        None, description="temporal read noise, without the reset noise of resets"
    )
    limit_e: Well | None = Field(
        None,
        description=(
            "largest charge that it can read (absent: the charge that gives the voltage of the"
            " full collector at its lowest conversion gain, at most what it holds)"
        ),
    )
    bits: Annotated[int, Field(ge=1, le=24)] | None = Field(None, description="bits of its ADC")
    black_level_dn: Annotated[float, Field(ge=0, lt=2**24)] | None = Field(
        None, description="offset added before its ADC"
    )
    resets: ResetFactor | None = Field(
        None,
        description=(
            "n in the reset noise variance n kTC/q², with C = q over the conversion gain (without"
            " both: the reset noise of the pixel)"
        ),
    )
    gain_spread: GainSpread = Field(
        0.0,
        description=(
            "standard deviation over pixels of its gain over the mean, beside the PRNU of the"
            " collector"
        ),
    )
    column_gain_spread: GainSpread = Field(
        0.0, description="standard deviation over columns of its gain over the mean"
    )
    gain_error: Annotated[float, Field(ge=-0.9, le=10)] = Field(
        0.0, description="error of its gain, relative, of which the merge does not know"
    )
    black_error_dn: Annotated[float, Field(ge=-(2.0**24), le=2.0**24)] = Field(
        0.0, description="error of its black level, of which the merge does not know"
    )


_OF_ALL_KINDS = {"kind", "merge", "validity_sigmas", "blend_from_share", "blend_to_share"}
_OF_ALL_KINDS |= {"area_um2", "collector", "reading"}


class ReadoutOptions(Record):
    """Several readings of a pixel, and how they merge to one estimate of its electrons.

    `kind` makes collectors and readings of a few numbers; lists are in the order of decreasing
    sensitivity. `collector` and `reading` describe any other pixel in full, in place of `kind`.
    """

    kind: Literal["single", "dual_gain", "split", "staggered", "overflow"] = Field(
        "single",
        description=(
            "'single', one reading; 'dual_gain', one charge at two conversion gains; 'split', a"
            " large and a small photodiode; 'staggered', exposures of several lengths; 'overflow',"
            " a photodiode, and with it a capacitor for the charge beyond its full well"
        ),
    )
    merge: Literal["select", "blend", "max_likelihood"] = Field(
        "select",
        description=(
            "'select', the most sensitive valid reading; 'blend', from one reading to the next"
            " between blend_from_share and blend_to_share; 'max_likelihood', weights of least"
            " variance, for the level of the neighbourhood"
        ),
    )
    validity_sigmas: Annotated[float, Field(ge=0, le=100)] = Field(
        4.0,
        description=(
            "a reading is valid below the code of its limit by so many standard deviations of the"
            " noise behind the limit"
        ),
    )
    blend_from_share: UnitInterval = Field(
        0.5, description="share of the limit of the sensitive reading at which a blend begins"
    )
    blend_to_share: Fraction = Field(
        0.9, description="share of the limit of the sensitive reading at which a blend ends"
    )

    area_um2: Annotated[float, Field(ge=0, le=1e6)] = Field(
        0.0,
        description=(
            "area that its circuits take from the photodiode: fill factor × (1 - area_um2/pitch²);"
            " about 9 a transistor at 0.35 µm, 0.04 in a back-lit 65 nm process (a third, and a"
            " quarter, of what the fill-factor laws leave out), and capacity_e/40 000 for a"
            " capacitor in the silicon, 0 for one above it"
        ),
    )
    conversion_gain_uv_per_e: _Gains | None = Field(
        None, description="conversion gains of the readings; dual_gain and overflow: [high, low]"
    )
    full_well_e: _Wells | None = Field(
        None,
        description=(
            "full well: dual_gain and overflow, of the photodiode; split, [large, small] (absent:"
            " the full well of the pixel)"
        ),
    )
    read_noise_e: _Noises | None = Field(
        None,
        description=(
            "read noise of the readings, without the kTC noise of an overflow capacitor (absent:"
            " that of the pixel)"
        ),
    )
    dark_current_e_per_s: _Currents | None = Field(
        None, description="split: dark currents [large, small] (absent: that of the pixel)"
    )
    response: _Responses | None = Field(
        None, description="split: light of the photodiodes, [1, that of the small one]"
    )
    ratio: Annotated[float, Field(ge=1, le=1e6)] | None = Field(
        None, description="staggered: ratio of the lengths of successive exposures"
    )
    count: Annotated[int, Field(ge=2, le=MAX_READINGS)] = Field(
        2, description="staggered: number of exposures; integration_s is the longest"
    )
    gap_us: Annotated[float, Field(ge=0, le=1e9)] = Field(
        0.0, description="staggered: time from the end of an exposure to the start of the next"
    )
    capacity_e: Well | None = Field(
        None, description="overflow: charge beyond the full well that the capacitor holds"
    )
    resets: ResetFactor = Field(
        1.0,
        description=(
            "overflow: n in the reset noise variance n kTC/q² of the capacitor: frame memory or"
            " soft reset 1, delta double sampling 2"
        ),
    )
    capacitor_dark_e_per_s: Current = Field(
        0.0, description="overflow: dark current of the capacitor"
    )

    collector: tuple[CollectorOptions, ...] = Field(
        (), max_length=MAX_READINGS, description="in place of kind: the collectors"
    )
    reading: tuple[ReadingOptions, ...] = Field(
        (), max_length=MAX_READINGS, description="in place of kind: the readings"
    )

    @model_validator(mode="after")
    def _has_numbers_of_kind(self) -> Self:
        kind = packaged_tables("readouts")[self.kind]
        needed, taken = kind["needs"], kind["takes"]
        stated = self.model_dump(exclude=_OF_ALL_KINDS, exclude_defaults=True)
        problems = [f"no {name}" for name in needed if name not in stated]
        problems += [name for name in stated if name not in needed + taken]
        if problems:
            raise ValueError(
                f"got {', '.join(problems)} with kind = '{self.kind}'; allowed:"
                f" {', '.join(needed + taken) or 'no numbers'}"
            )
        if self.blend_from_share >= self.blend_to_share:
            raise ValueError(
                f"got blend_from_share = {self.blend_from_share:g}; allowed: below blend_to_share,"
                f" {self.blend_to_share:g}"
            )
        return self

    @model_validator(mode="after")
    def _reads_all_collectors(self) -> Self:
        collectors, readings = self.model
        names = [collector.name for collector in collectors]
        read = [reading.collector for reading in readings]
        reading_names = {reading.name for reading in readings}
        if {*read} != {*names} or len({*names}) < len(names) or len(reading_names) < len(read):
            raise ValueError(
                f"got [[readout.reading]] of the collectors {', '.join(read) or 'none'}; allowed:"
                f" those of [[readout.collector]], {', '.join(names) or 'none'}, all of them, with"
                " another name for each collector and each reading"
            )
        first = collectors[0]
        if first.response != 1 or first.length_share != 1:
            raise ValueError(
                f"got response = {first.response:g} and length_share = {first.length_share:g} of"
                f" the first collector, {first.name}; allowed: 1, since it is the reference"
            )
        return self

    @property
    def is_single(self) -> bool:
        """Whether the pixel is read once, as it states itself."""
        return self.kind == "single" and not self.reading

    @property
    def model(self) -> tuple[tuple[CollectorOptions, ...], tuple[ReadingOptions, ...]]:
        """Collectors and readings in full. ValueError for lists of another length."""
        if self.collector or self.reading:
            return self.collector, self.reading

        kind = packaged_tables("readouts")[self.kind]
        collectors = self._with_numbers(kind["collector"], CollectorOptions)
        readings = self._with_numbers(kind["reading"], ReadingOptions)
        share_before = 0.0
        for number, collector in enumerate(collectors if self.ratio else ()):
            collector["length_share"] = (self.ratio or 1.0) ** -number
            collector["start_share"] = share_before
            collector["start_s"] = 1e-6 * self.gap_us * number
            share_before += collector["length_share"]
        for reading in readings:
            if reading.get("overflow"):
                reading["resets"] = self.resets
        return (
            tuple(CollectorOptions(**collector) for collector in collectors),
            tuple(ReadingOptions(**reading) for reading in readings),
        )

    def _with_numbers(
        self, tables: Sequence[dict[str, Any]], record: type[Record]
    ) -> list[dict[str, Any]]:
        """Return tables of a kind, each with its numbers for the record: of lists one for each
        table, of single numbers that one. ValueError for lists of another length.
        """
        tables = tables[: self.count]
        names = {*record.model_fields} - {"collector", "resets"}
        stated = self.model_dump(include=names, exclude_none=True)
        for name, value in stated.items():
            values = value if isinstance(value, tuple) else (value,)
            if len(values) not in (1, len(tables)):
                raise ValueError(
                    f"got {name} of {len(values)} numbers with kind = '{self.kind}'; allowed: one,"
                    f" or {len(tables)}"
                )
            tables = [
                table | {name: number} for table, number in zip(tables, cycle(values), strict=False)
            ]
        return [dict(table) for table in tables]
