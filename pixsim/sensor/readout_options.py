"""Pixels that are read several times: what collects their charge, and how it is read."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from pixsim.base.records import Record, UnitInterval, as_list
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
            "n in the reset noise variance n kTC/q², with C = q over the conversion gain (absent:"
            " the reset noise of the pixel)"
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
    def _is_complete(self) -> Self:
        if self.collector or self.reading:
            _check_full(self)
            return self
        required, optional = _KINDS[self.kind]
        fields = ReadoutOptions.model_fields
        problems = [f"no {name}" for name in required if getattr(self, name) is None]
        problems += [
            name
            for name in _NUMBERS_OF_KINDS
            if name not in (*required, *optional) and getattr(self, name) != fields[name].default
        ]
        if problems:
            allowed = " and ".join(filter(None, (", ".join(required), ", ".join(optional))))
            raise ValueError(
                f"got {', '.join(problems)} with kind = '{self.kind}'; allowed:"
                f" {allowed or 'no numbers'}"
            )
        _model(self)  # which compares the lengths of lists
        if self.blend_from_share >= self.blend_to_share:
            raise ValueError(
                f"got blend_from_share = {self.blend_from_share:g}; allowed: below blend_to_share,"
                f" {self.blend_to_share:g}"
            )
        return self

    @property
    def is_single(self) -> bool:
        """Whether the pixel is read once, as it states itself."""
        return self.kind == "single" and not self.reading

    @property
    def model(self) -> tuple[tuple[CollectorOptions, ...], tuple[ReadingOptions, ...]]:
        """Collectors and readings in full."""
        if self.reading:
            return self.collector, self.reading
        return _model(self)


def _check_full(options: ReadoutOptions) -> None:
    """Raise ValueError unless collectors and readings refer to each other, by names that are not
    used twice.
    """
    stated = [name for name in ("kind", *_NUMBERS_OF_KINDS) if name in options.model_fields_set]
    if stated:
        raise ValueError(
            f"got {', '.join(stated)} with [[readout.collector]] or [[readout.reading]]; allowed:"
            " one of both. Give the numbers to the collectors and readings"
        )
    for name, records in (("collector", options.collector), ("reading", options.reading)):
        names = [record.name for record in records]
        if not names or len(set(names)) < len(names):
            raise ValueError(
                f"got [[readout.{name}]] with the names {', '.join(names) or 'none'}; allowed: at"
                " least one, each with a name of its own"
            )
    collectors = {record.name for record in options.collector}
    unknown = [record.name for record in options.reading if record.collector not in collectors]
    if unknown:
        raise ValueError(
            f"got readings {', '.join(unknown)} of no [[readout.collector]]; allowed:"
            f" {', '.join(sorted(collectors))}"
        )
    if options.collector[0].response != 1 or options.collector[0].length_share != 1:
        raise ValueError(
            f"got the first collector, {options.collector[0].name}, with response ="
            f" {options.collector[0].response:g} and length_share ="
            f" {options.collector[0].length_share:g}; allowed: 1, since it is the reference"
        )


_COLLECTOR_LISTS = "response", "full_well_e", "dark_current_e_per_s"
_READING_LISTS = "conversion_gain_uv_per_e", "read_noise_e"


def _tables(
    options: ReadoutOptions, names: Sequence[str], lists: Sequence[str]
) -> list[dict[str, Any]]:
    """Return a table for each name, with its number of each list that is stated; the last number is
    that of all further names.
    """
    stated = {field: getattr(options, field) for field in lists if getattr(options, field)}
    for field, values in stated.items():
        if len(values) not in (1, len(names)):
            raise ValueError(
                f"got {field} of {len(values)} numbers with kind = '{options.kind}'; allowed:"
                f" one, or one for each of {', '.join(names)}"
            )
    return [
        {"name": name}
        | {field: values[min(index, len(values) - 1)] for field, values in stated.items()}
        for index, name in enumerate(names)
    ]


def _model(
    options: ReadoutOptions,
) -> tuple[tuple[CollectorOptions, ...], tuple[ReadingOptions, ...]]:
    """Return collectors and readings of a kind."""
    names = {
        "split": ["large", "small"],
        "staggered": ["long", *(f"short{number}" for number in range(1, options.count))],
    }.get(options.kind, ["pixel"])
    is_read_twice = options.kind in ("dual_gain", "overflow")
    collectors = _tables(options, names, _COLLECTOR_LISTS)
    readings = _tables(options, ["high", "low"] if is_read_twice else names, _READING_LISTS)
    for index, table in enumerate(readings):
        table["collector"] = names[0] if is_read_twice else names[index]

    if options.kind == "staggered":
        assert options.ratio is not None  # as checked
        shares = [options.ratio**-number for number in range(options.count)]
        for index, table in enumerate(collectors):
            table["length_share"] = shares[index]
            table["start_share"] = sum(shares[:index])
            table["start_s"] = 1e-6 * options.gap_us * index
    if options.kind == "overflow":
        collectors[0]["capacity_e"] = options.capacity_e
        collectors[0]["capacitor_dark_e_per_s"] = options.capacitor_dark_e_per_s
        readings[1] |= {"overflow": True, "resets": options.resets}
    return (
        tuple(CollectorOptions(**table) for table in collectors),
        tuple(ReadingOptions(**table) for table in readings),
    )


# Of each kind: the fields that it needs, and those that may be absent.
_KINDS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "single": ((), ()),
    "dual_gain": (("conversion_gain_uv_per_e",), ("full_well_e", "read_noise_e")),
    "split": (
        ("response", "full_well_e"),
        ("read_noise_e", "conversion_gain_uv_per_e", "dark_current_e_per_s"),
    ),
    "staggered": (("ratio",), ("count", "gap_us", "read_noise_e")),
    "overflow": (
        ("conversion_gain_uv_per_e", "capacity_e"),
        ("full_well_e", "read_noise_e", "resets", "capacitor_dark_e_per_s"),
    ),
}
_NUMBERS_OF_KINDS = tuple(
    dict.fromkeys(name for kind in _KINDS.values() for names in kind for name in names)
)
