"""CMOS processes, read from TOML files in which every number has a source and a confidence."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self, get_args

from pydantic import Field, create_model, model_validator

from pixsim.base.caller import setting
from pixsim.base.door import checked_methods
from pixsim.base.errors import (
    PixsimError,
    did_you_mean,
    excerpt,
    invalid,
    name_fault,
    one_line,
    quoted,
)
from pixsim.base.layers import Layer
from pixsim.base.records import AnyNumber, Record, checked
from pixsim.base.toml import packaged, read_toml
from pixsim.light.quantities import Fraction
from pixsim.optics.quantities import FNumber
from pixsim.sensor.labels import label_of
from pixsim.sensor.pixel_options import NO_TECHNOLOGY, NUMBERS, PixelOptions
from pixsim.sensor.quantities import (
    AreaMismatch,
    Crosstalk,
    DarkSpread,
    DiffusionLength,
    GainSpread,
    GateArea,
    NoiseElectrons,
    OffsetSpread,
    Pitch,
    RefractiveIndex,
    SiliconDepth,
    StackHeight,
    VoltageMismatch,
)
from pixsim.sensor.spread import Distribution
from pixsim.sensor.stack_options import MICROLENSES, SHIFTS, StackOptions

_Volts = Annotated[float, Field(ge=1e-3, le=1e3)]
_Grading = Annotated[float, Field(ge=0, le=0.99)]
_Capacitance = Annotated[float, Field(ge=0, le=1e9)]
_MIN_FF = 1e-6  # one electron changes its voltage by 160 V


class Junction(Record):
    """An n+/psub photodiode of a 3T pixel, with SPICE's names; capacitances are zero-bias."""

    reset_voltage_v: _Volts = Field(description="reverse bias after reset, V")
    voltage_swing_v: _Volts = Field(
        description="voltage swing of the photodiode, from reset to full, V"
    )
    cj_ff_per_um2: _Capacitance = Field(description="junction capacitance of the area, fF/µm²")
    pb_v: _Volts = Field(description="built-in potential of the area's junction, V")
    mj: _Grading = Field(
        description="grading coefficient of the area's junction: ½ abrupt, ⅓ linear"
    )
    cjsw_ff_per_um: _Capacitance = Field(description="junction capacitance of the sidewall, fF/µm")
    pbsw_v: _Volts = Field(description="built-in potential of the sidewall's junction, V")
    mjsw: _Grading = Field(description="grading coefficient of the sidewall's junction")
    node_capacitance_ff: _Capacitance = Field(description="fixed capacitance of the sense node, fF")

    @model_validator(mode="after")
    def _swing_and_capacitance_are_consistent(self) -> Self:
        if self.voltage_swing_v > self.reset_voltage_v:
            raise ValueError(
                f"voltage_swing_v = {self.voltage_swing_v:g} exceeds reset_voltage_v ="
                f" {self.reset_voltage_v:g}"
            )
        if max(self.cj_ff_per_um2, self.cjsw_ff_per_um, self.node_capacitance_ff) < _MIN_FF:
            raise ValueError(
                "one of cj_ff_per_um2, cjsw_ff_per_um and node_capacitance_ff must be at least"
                f" {_MIN_FF:g}"
            )
        return self


def _declared_by_pixels() -> dict[str, Any]:
    """Return the numbers of a process that are declared in the record of pixels, with the value
    where a process has none.
    """
    declared: dict[str, Any] = {}
    for name, number in NUMBERS.items():
        if number.technology_default is None:
            continue
        # A process has numbers, a pixel those or None.
        field = PixelOptions.model_fields[name]
        kind = next(kind for kind in get_args(field.annotation) if kind is not type(None))
        declared[name] = kind, Field(number.technology_default, description=field.description)
    return declared


if TYPE_CHECKING:
    NumbersOfPixels = Record
else:
    NumbersOfPixels = create_model("NumbersOfPixels", __base__=Record, **_declared_by_pixels())


@checked_methods
class Technology(NumbersOfPixels):
    """A CMOS process: the properties from which a pixel follows.

    Beside these fields it has the numbers that `PixelOptions` declares with a value for processes
    that state none.
    """

    ALTERNATIVES: ClassVar = (
        (("a_vt_mv_um", "follower_area_um2"), ("offset_fpn",)),
        (("stack_crosstalk",), ("stack_depletion_um", "stack_diffusion_length_um")),
    )

    name: str = Field(description="name in results")
    feature_size_um: Annotated[
        float, Field(ge=1e-4, le=1e3, description="feature size F of the process")
    ]
    junction: Junction | None = Field(
        None,
        description=(
            "3T pixel: photodiode junction, whose capacitance times the voltage swing is the full"
            " well"
        ),
    )
    full_well_e_per_um2: Annotated[float, Field(ge=1e-6, le=1e12)] | None = Field(
        None, description="4T pixel: full well of the pinned photodiode per µm² of its area"
    )
    response_curve: Literal["hp_mosis", "silicon"] = Field(
        "hp_mosis", description="packaged curve of the quantum efficiency"
    )
    dark_current_na_per_cm2: Annotated[float, Field(ge=0, le=1e12)] = Field(
        description="dark current of the photodiode's area at 27 °C, nA/cm²"
    )
    dark_current_perimeter_pa_per_cm: Annotated[float, Field(ge=0, le=1e12)] = Field(
        0.0,
        description=(
            "dark current of the photodiode's perimeter at 27 °C, pA/cm, added to that of the area"
        ),
    )
    dark_doubling_k: Annotated[float, Field(ge=1, le=1e6)] = Field(
        description="temperature rise that doubles the dark current; 4 to 12 K in silicon"
    )
    peak_quantum_efficiency: Fraction = Field(
        description="largest quantum efficiency, electrons per photon on the photodiode"
    )
    prnu: GainSpread | None = Field(
        None, description="standard deviation of the gain over its mean"
    )
    prnu_um: AreaMismatch | None = Field(
        None,
        description=(
            "in place of prnu: prnu times the side of the square photodiode, so that prnu is this"
            " at 1 µm²"
        ),
    )
    dsnu: DarkSpread = Field(
        description="standard deviation of the dark current over its mean, without hot pixels"
    )
    offset_fpn: OffsetSpread | None = Field(
        None,
        description="standard deviation of the pixels' offsets, as a fraction of the full well",
    )
    a_vt_mv_um: VoltageMismatch | None = Field(
        None,
        description=(
            "in place of offset_fpn, with follower_area_um2: A_Vt of one source follower, mV·µm; "
            "of a 3T pixel without double sampling"
        ),
    )
    follower_area_um2: GateArea | None = Field(
        None, description="gate area W·L of the source follower, µm², at every pitch"
    )
    column_fpn: OffsetSpread = Field(
        description="standard deviation of the columns' offsets, as a fraction of the full well"
    )
    read_noise_e: NoiseElectrons = Field(
        description="temporal read noise before the amplifier, without the reset noise"
    )
    fill_factor_limit: Fraction = Field(
        description="η of the fill-factor law: its limit for large pixels"
    )
    fill_factor_zero_pitch_features: Annotated[float, Field(ge=1e-6, le=1e6)] = Field(
        description=(
            "p0 of the fill-factor law, in feature sizes: pitch at which the photodiode vanishes"
        )
    )
    fill_factor_inset_features: Annotated[float, Field(ge=0, le=1e6)] = Field(
        0.0, description="s of the fill-factor law, in feature sizes: width lost at every pitch"
    )
    stack_height_um: StackHeight | None = Field(
        None,
        description=(
            "height of the microlens or opening above the photodiode; microlenses wider than √π"
            " times it lie at 1/√π of their pitch; None: no stack unless the pixel gives one"
        ),
    )
    stack_index: RefractiveIndex | None = Field(None, description="refractive index of the stack")
    stack_microlens: MICROLENSES | None = Field(None, description="'square' or 'none'")
    stack_shift: SHIFTS | None = Field(None, description="'none' or 'optimal'")
    stack_depletion_um: SiliconDepth | None = Field(
        None, description="front-side illuminated: depth of the depletion region"
    )
    stack_diffusion_length_um: DiffusionLength | None = Field(
        None,
        description=(
            "front-side illuminated: diffusion length of electrons below the depletion region"
        ),
    )
    stack_crosstalk: Crosstalk | None = Field(
        None,
        description=(
            "in place of diffusion: share of a pixel's charge that its four neighbours collect"
            " together"
        ),
    )
    quantum_efficiency_includes: Literal["photodiode", "microlens"] = Field(
        "photodiode",
        description="area of the measurement behind the quantum efficiency, if there is a stack",
    )
    quantum_efficiency_f_number: FNumber | None = Field(
        None, description="f-number of the light of that measurement, under a microlens; None: 8"
    )
    quantum_efficiency_pitch_um: Pitch | None = Field(
        None,
        description=(
            "pitch of the pixel of that measurement, under a microlens; None: every pixel has that"
            " efficiency"
        ),
    )
    sources: dict[str, str] = Field(
        default_factory=dict, description="field -> confidence and source"
    )
    ranges: dict[str, tuple[AnyNumber, AnyNumber]] = Field(
        default_factory=dict,
        description="field -> smallest and largest plausible value, in the field's unit",
    )
    distributions: dict[str, Distribution] = Field(
        default_factory=dict,
        description=(
            "field -> distribution of its range, which is the central 90 % (absent: uniform, the"
            " range is its ends)"
        ),
    )

    @model_validator(mode="after")
    def _one_kind_of_well_inside_the_pixel(self) -> Self:
        if (self.junction is None) == (self.full_well_e_per_um2 is None):
            raise ValueError(
                "a technology needs either full_well_e_per_um2 or all of"
                f" {', '.join(Junction.model_fields)} (a junction)"
            )
        if self.fill_factor_inset_features > self.fill_factor_zero_pitch_features:
            raise ValueError(
                f"fill_factor_inset_features = {self.fill_factor_inset_features:g} exceeds"
                f" fill_factor_zero_pitch_features = {self.fill_factor_zero_pitch_features:g}: the"
                " photodiode area of larger pixels would be negative"
            )
        return self

    @model_validator(mode="after")
    def _mismatch_is_stated_once(self) -> Self:
        if (self.prnu is None) == (self.prnu_um is None):
            raise ValueError(
                f"got {'neither prnu nor' if self.prnu is None else 'both prnu and'} prnu_um; give"
                " one of them"
            )
        layout = [
            name for name in ("a_vt_mv_um", "follower_area_um2") if getattr(self, name) is not None
        ]
        if self.offset_fpn is None and len(layout) < 2:
            got = f"{layout[0]} alone" if layout else "no offsets"
            raise ValueError(
                f"got {got}; give offset_fpn, or both a_vt_mv_um and follower_area_um2"
            )
        if layout and self.junction is None:
            raise ValueError(
                "a_vt_mv_um with full_well_e_per_um2: the node capacitance of a pinned photodiode"
                " is unknown; give offset_fpn"
            )
        return self

    @model_validator(mode="after")
    def _ranges_hold_their_values(self) -> Self:
        numbers = self.numbers
        for name, (low, high) in self.ranges.items():
            value = numbers.get(name)
            if value is None:
                raise invalid(
                    "range", quoted(name), f"numbers of this process: {', '.join(numbers)}"
                )
            if not low <= value <= high:
                raise invalid(
                    f"range of {name}",
                    f"[{low:g}, {high:g}]",
                    f"low <= {value:g} (the value) <= high",
                )
            for end in (low, high):
                self.with_numbers(
                    {name: end}, f"range of {name}"
                )  # the ends have the bounds of the value
        for name, distribution in self.distributions.items():
            if name not in self.ranges:
                raise invalid(
                    f"distribution of {name}",
                    f"'{distribution}' without a range",
                    "a range = [low, high] together with it",
                )
            low, high = self.ranges[name]
            if distribution == "lognormal" and not 0 < low < high:
                raise invalid(
                    f"range of {name}",
                    f"[{low:g}, {high:g}]",
                    "0 < low < high for a lognormal distribution",
                )
        return self

    @property
    def numbers(self) -> dict[str, float]:
        """All numbers of the process and its junction by name; the names end in the units."""
        table = self.model_dump(exclude={"junction"})
        if self.junction:
            table |= self.junction.model_dump()
        return {name: value for name, value in table.items() if isinstance(value, float)}

    @property
    def stack(self) -> StackOptions:
        """What the process states about the stack of its pixels."""
        stated = {
            name: getattr(self, f"stack_{name}")
            for name in StackOptions.model_fields
            if hasattr(self, f"stack_{name}")
        }
        return StackOptions(**stated)

    @property
    def content(self) -> dict[str, Any]:
        """The values that results depend on: the record without sources, ranges and
        distributions.
        """
        return self.model_dump(exclude={"sources", "ranges", "distributions"})

    def with_numbers(self, values: dict[str, float], source: str) -> Technology:
        """Return the technology with other values of some of its `numbers`.

        values : name of a number -> its value, in its unit
        source : origin of the values, for messages

        Raises PixsimError for an unknown name, and for a value out of bounds.
        """
        numbers = self.numbers
        for name in values:
            if name not in numbers:
                raise invalid(source, f"'{name}'", ", ".join(numbers), did_you_mean(name, numbers))

        new_sources: dict[str, str] = {}
        process_values: dict[str, Any] = {}
        junction_values: dict[str, float] = {}
        for name, value in values.items():
            source_text = self.sources.get(name, "no source")
            new_sources[name] = f"set by the study; the file has {numbers[name]:g} ({source_text})"
            if name in Junction.model_fields:
                junction_values[name] = value
            else:
                process_values[name] = value
        if junction_values:
            process_values["junction"] = junction_values

        # A study may set a value outside its plausible range, so ranges are not checked.
        base = self.model_dump() | {
            "sources": self.sources | new_sources,
            "ranges": {},
            "distributions": {},
        }
        technology: Technology = checked(Technology, [Layer(base), Layer(process_values, source)])
        return technology.model_copy(
            update={"ranges": self.ranges, "distributions": self.distributions}
        )


# For a sensor that is described by a data sheet (`pixsim.sensor.pixel_options.DATA_SHEET`). Numbers
# that the data sheet lacks are ideal: no non-uniformity, no offsets, no reset noise apart from the
# read noise, and a fill factor of 1, since a data sheet's quantum efficiency is that of the whole
# pixel with its microlens. The other numbers are placeholders.
_NO_PROCESS = Technology.model_validate(
    {
        "name": NO_TECHNOLOGY,
        "feature_size_um": 1e-4,
        "response_curve": "silicon",
        "dark_current_na_per_cm2": 0.0,
        "dark_doubling_k": 8.0,
        "reset_noise_factor": 0.0,
        "read_noise_e": 0.0,
        "prnu": 0.0,
        "dsnu": 0.0,
        "offset_fpn": 0.0,
        "column_fpn": 0.0,
        "full_well_e_per_um2": 1.0,
        "peak_quantum_efficiency": 1.0,
        "fill_factor_limit": 1.0,
        "fill_factor_zero_pitch_features": 1e-6,
    }
)


def number_of(pixel: PixelOptions, technology: Technology, name: str) -> float:
    """Return a number of a pixel that neither its size nor its layout changes: as the pixel states
    it, or its technology.

    It is 0 where the pixel states a sum that contains it.

    name : of a field of `PixelOptions` that a technology may have, too
    """
    if any(getattr(pixel, word) is not None for word in NUMBERS[name].part_of):
        return 0.0
    value = getattr(pixel, name)
    return float(getattr(technology, name) if value is None else value)


# Other laws that fit the paper's three fill factors about as well: (limit, zero pitch, inset) of
# `fill_factor_law`.
_OTHER_FILL_FACTOR_LAWS = {"inset": (0.870, 14.67, 1.44), "inset_unlimited": (1.0, 14.54, 4.9)}


def with_fill_factor_law(technology: Technology, law: str) -> Technology:
    """Return the technology with another fill-factor law (`Pixel.fill_factor_law`); a data sheet
    has none, and stays the same.
    """
    if law not in _OTHER_FILL_FACTOR_LAWS or technology.name == NO_TECHNOLOGY:
        return technology
    names = "fill_factor_limit", "fill_factor_zero_pitch_features", "fill_factor_inset_features"
    return technology.model_copy(update=dict(zip(names, _OTHER_FILL_FACTOR_LAWS[law], strict=True)))


def load_technology(name: str) -> Technology:
    """Load a packaged technology by its name, or a user's by the path of its TOML file.

    Every number of the file is a table `{value, confidence, source}`, with an optional
    `range = [low, high]` of plausible values and their `distribution`: "uniform" (the default),
    "normal" or "lognormal", of which the range is the central 90 %.

    Raises PixsimError for an unknown name, and for a file that is damaged or incomplete.

    >>> load_technology("0.35um").feature_size_um
    0.35
    """
    if name == NO_TECHNOLOGY:
        return _NO_PROCESS
    packaged_files = packaged("data/technologies")
    if name in packaged_files:
        return _read(packaged_files[name], ())
    path = Path(name)
    if path.suffix != ".toml" or not name:
        sensors = packaged("data/sensors")
        hint = f"{did_you_mean(name, [*packaged_files, *sensors])} Or give the path of a TOML file."
        if name in sensors:
            hint = f"It is a packaged sensor, a file of settings: {setting('config', name)}."
        raise invalid(
            "technology", f"'{name}'", ", ".join([*packaged_files, NO_TECHNOLOGY]), hint.strip()
        )
    check_name(name)
    status = path.stat() if path.is_file() else None
    return _read(path, (status.st_mtime_ns, status.st_size) if status else ())


_NUMBERS_OF_FILE = {*Technology.model_fields, *Junction.model_fields}
_ENTRY_KEYS = ("value", "range", "distribution", "confidence", "source")  # of a file


@lru_cache
def _read(path: Path, _: tuple[int, ...]) -> Technology:
    """Read the technology of a file; the cache key has its modification time and size."""
    table = read_toml(path)
    numbers = {key: entry for key, entry in table.items() if isinstance(entry, dict)}
    for key, entry in numbers.items():
        unknown = [name for name in entry if name not in _ENTRY_KEYS]
        if unknown:
            number = key if key in _NUMBERS_OF_FILE else "a table"
            hint = did_you_mean(unknown[0], _ENTRY_KEYS)
            raise invalid(f"{path}: {number}", excerpt(unknown[0]), ", ".join(_ENTRY_KEYS), hint)

    try:
        values = {key: entry["value"] for key, entry in numbers.items()}
        junction = {key: values.pop(key) for key in Junction.model_fields if key in values}
        sources = {
            key: f"{entry['confidence']}: {entry['source']}" for key, entry in numbers.items()
        }
        ranges = {key: entry["range"] for key, entry in numbers.items() if "range" in entry}
        distributions = {
            key: entry["distribution"] for key, entry in numbers.items() if "distribution" in entry
        }
    except KeyError as missing:
        raise PixsimError(
            f"technology '{path}': an entry has no {missing}; each needs value, confidence and"
            " source"
        ) from None

    record = values | {
        "name": table.get("name", path.stem),
        "sources": sources,
        "ranges": ranges,
        "distributions": distributions,
    }
    if junction:
        record["junction"] = junction
    if isinstance(record["name"], str) and (fault := name_fault(record["name"])):
        raise invalid(f"{path}: name", f"a name that {fault}", "another name")
    technology: Technology = checked(Technology, [Layer(record, str(path), named=True)])
    return technology


def check_name(file: str, kind: str = "technology") -> None:
    """Raise PixsimError if the name of a file, or of a technology, cannot stand in tables."""
    if fault := name_fault(file) or name_fault(label_of(file)):
        raise invalid(
            kind,
            f"'{one_line(file)}', whose name {fault}",
            "another name",
            "Rename the file, or write ./ before it.",
        )
