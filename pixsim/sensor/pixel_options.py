"""The pixel: its numbers, each declared once, and the rules of data sheets and technologies."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from pixsim.base.problems import Words
from pixsim.base.records import Record, UnitInterval, as_list
from pixsim.light.curves import QuantumEfficiency
from pixsim.light.quantities import Fraction, Wavelength
from pixsim.optics.quantities import FNumber
from pixsim.sensor.colour_options import BIN, ColourOptions, efficiencies_of
from pixsim.sensor.number import Number, numbers_of
from pixsim.sensor.quantities import (
    AbsorbedWavelength,
    AbsorptionDepth,
    AreaMismatch,
    Current,
    DarkSpread,
    Doubling,
    GainSpread,
    GateArea,
    HotMedian,
    HotSpread,
    Knees,
    NoiseElectrons,
    OffsetSpread,
    Pitch,
    ResetFactor,
    VoltageMismatch,
    Well,
)
from pixsim.sensor.readout_options import ReadoutOptions
from pixsim.sensor.stack_options import StackOptions
from pixsim.sensor.unit_slips import slip_hint

NO_TECHNOLOGY = "none"
# Required of a data sheet without a technology; non-uniformities and offsets that it does not give
# are 0.
DATA_SHEET = ("full_well_e", "read_noise_e", "dark_current_e_per_s", "quantum_efficiency")


TEMPORAL = ("temporal_dark_noise_e",)  # the word for all temporal noise in the dark
MISMATCH = {"a_vt_mv_um", "follower_area_um2"}  # two words that state the offsets together


def excluded_by(names: Iterable[str]) -> set[str]:
    """The fields of a pixel that cannot be given together with the fields `names`, since they state
    the same quantity.
    """
    excluded: set[str] = set()
    for name in names:
        fields = {name, *STANDS_FOR.get(name, ())}
        words = {word for word, meanings in STANDS_FOR.items() if fields & set(meanings)}
        together = MISMATCH if name in MISMATCH else set()
        excluded |= (fields | words) - {name} - together
    return excluded


def missing_of_data_sheet(stated: Iterable[str]) -> list[str]:
    """The names of `DATA_SHEET` that neither stand among `stated` nor under another word of
    `STANDS_FOR`.
    """
    names = set(stated)
    for word in STANDS_FOR.keys() & names:
        names |= set(STANDS_FOR[word])
    return [name for name in DATA_SHEET if name not in names]


def is_data_sheet(values: dict[str, Any], pitch: str) -> bool:
    """The one rule of the technology, for files, options and Python: a complete data sheet with its
    pitch needs none.

    It looks at what was given, after layers are merged.

    pitch : name of the data sheet's pitch
    """
    stated = {name for name, value in values.items() if value is not None}
    return pitch in stated and not missing_of_data_sheet(
        stated | efficiencies_of(values.get("colour"))
    )


ABSOLUTE_ZERO_C = -273.15


class DarkCurrent(Record):
    """Dark current of a data sheet: e_per_s · 2^((T - at_c)/doubling_k), with T the temperature of
    the pixel in °C.
    """

    e_per_s: Current = Field(
        description="dark current of one pixel at at_c", examples=["e_per_s = 0.5"]
    )
    at_c: Annotated[float, Field(ge=-196, le=127)] = Field(
        description="temperature of the measurement", examples=["at_c = 20"]
    )
    doubling_k: Doubling | None = Field(
        None,
        description=(
            "temperature rise that doubles the dark current (absent: that of the technology, 8 K"
            " without one)"
        ),
    )


GAIN = "gain", "conversion_gain", "system_gain"  # usual words for either


def _hint_of_current(path: Sequence[str], value: object) -> str:
    """How to write a plain number of dark current."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return ""
    return (
        f"Write dark_current_e_per_s = {value:g}, or dark_current = {{ e_per_s = {value:g}, at_c ="
        " 25 }."
    )


class PixelOptions(Record):
    """A pixel without its technology and pitch. Values of None are derived from the technology.

    A data sheet's own words can stand for some fields, but not beside them: `saturation_capacity_e`
    for `full_well_e`, `dn_per_e` and `adc_full_scale_e` for `gain_e_per_dn`,
    `temporal_dark_noise_e` for `read_noise_e` and all other temporal noise in the dark,
    `dark_current` for `dark_current_e_per_s`, `prnu_percent` for `prnu`, and `dsnu_e` for
    `offset_fpn` and `column_fpn`. So can mismatch that depends on the layout: `prnu_um` for `prnu`,
    and `a_vt_mv_um` with `follower_area_um2` for `offset_fpn`.
    """

    capacitance: Literal["mosis", "paper"] = Field(
        "mosis",
        description=(
            "capacitance: 'mosis', junctions of the process; 'paper', 2.6 fF + 0.22 fF/µm² and a"
            " voltage swing of 1 V"
        ),
    )
    well_limit: Literal["swing", "diode"] = Field(
        "swing",
        description=(
            "limit of full well: 'swing', voltage swing; 'diode', forward bias of the photodiode,"
            " about twice the charge"
        ),
    )
    conversion: Literal["linear", "junction"] = Field(
        "linear",
        description=(
            "charge to voltage: 'linear', proportional; 'junction', junction capacitance that grows"
            " with the charge"
        ),
    )
    response: Literal["scaled", "literal"] = Field(
        "scaled",
        description=(
            "meaning of the response curve: 'scaled', A/W scaled to the measured peak; 'literal',"
            " quantum efficiency"
        ),
    )
    quantum_efficiency: Annotated[
        QuantumEfficiency | None,
        Number(0.62, in_technology=True, also=("qe", "peak_qe", "quantum_efficiency_percent")),
    ] = Field(
        None,
        description=(
            "number, CSV file or pairs of (wavelength in nm, value); replaces the technology's"
            " response curve"
        ),
    )
    quantum_efficiency_nm: Annotated[AbsorbedWavelength | None, Number(525.0, is_certain=True)] = (
        Field(
            None,
            description=(
                "wavelength at which quantum_efficiency, one number, was measured; the others"
                " follow from the absorption of silicon (absent: the number holds at every"
                " wavelength)"
            ),
        )
    )
    quantum_efficiency_depth_um: Annotated[AbsorptionDepth | None, Number(5.0)] = Field(
        None,
        description=(
            "with quantum_efficiency_nm: depth of the silicon that collects charge, 3 to 12 among"
            " sensors (absent: 5)"
        ),
    )
    quantum_efficiency_includes: Annotated[
        Literal["photodiode", "microlens"] | None, Number("microlens")
    ] = Field(
        None,
        description=(
            "with a stack, where the quantum efficiency was measured: 'photodiode', on its area;"
            " 'microlens', on the whole pixel under a microlens (absent: the technology's; for a"
            " data sheet with a microlens, microlens)"
        ),
    )
    quantum_efficiency_f_number: Annotated[FNumber | None, Number(8.0)] = Field(
        None,
        description=(
            "f-number of the light of that measurement, for 'microlens' (absent: the technology's,"
            " or 8)"
        ),
    )
    quantum_efficiency_pitch_um: Annotated[Pitch | None, Number(1.4)] = Field(
        None,
        description=(
            "pitch of the pixel of that measurement, for 'microlens' (absent: data_sheet_pitch_um"
            " for that of a data sheet, else the technology's, or that of each pixel)"
        ),
    )
    infrared_cut_nm: Annotated[Wavelength | None, Number(650.0)] = Field(
        None, description="wavelength beyond which the response is zero (absent: no infrared cut)"
    )
    fill_factor_law: Literal["technology", "inset", "inset_unlimited"] = Field(
        "technology",
        description=(
            "fill factor against pitch: the technology's law, or one of two other fits to Chen et"
            " al. (2000)"
        ),
    )
    stack: Annotated[
        StackOptions | None,
        Number({"height_um": 5.0, "index": 1.5, "microlens": "square", "shift": "optimal"}),
    ] = Field(None, description="stack between the surface and the photodiode (absent: none)")
    colour: Annotated[
        ColourOptions | None,
        Number({"pattern": "rggb", "sensitivities": "Nikon_D5100", "peak_quantum_efficiency": 0.5}),
    ] = Field(
        None, description="colour filters and their responses (absent: none, a monochrome sensor)"
    )
    fill_factor: Annotated[
        Fraction | None, Number(0.8, hint=lambda path, value: slip_hint("fill_factor", value))
    ] = Field(None, description="photodiode area over pixel area (absent: from fill_factor_law)")
    full_well_e: Annotated[
        Well | None,
        Number(
            10500.0,
            in_technology=True,
            scales_with_area=True,
            also=("full_well", "full_well_capacity", "well_capacity"),
        ),
    ] = Field(
        None,
        description=(
            "full well: charge that the pixel holds; it corresponds to the highest ADC code, unless"
            " gain_e_per_dn is given"
        ),
    )
    saturation_capacity_e: Annotated[
        Well | None, Number(10500.0, ("full_well_e",), scales_with_area=True)
    ] = Field(
        None,
        description=(
            "in place of full_well_e: saturation capacity (μ_e.sat of EMVA 1288), signal at the"
            " peak of the temporal variance; the full well is chosen such that the simulated test"
            " returns it"
        ),
    )
    gain_e_per_dn: Annotated[
        Annotated[float, Field(ge=1e-9, le=1e15)] | None,
        Number(2.57, scales_with_area=True, also=GAIN),
    ] = Field(
        None,
        description=(
            "electrons per ADC code at 0 dB, 1/K of EMVA 1288; signals saturate at the lower of the"
            " full well and the highest code (absent: the codes above the black level span the full"
            " well)"
        ),
    )
    dn_per_e: Annotated[
        Annotated[float, Field(ge=1e-15, le=1e9)] | None,
        Number(0.39, ("gain_e_per_dn",), scales_with_area=True, also=GAIN),
    ] = Field(
        None,
        description="in place of gain_e_per_dn: ADC codes per electron at 0 dB, K of EMVA 1288",
    )
    adc_full_scale_e: Annotated[
        Well | None, Number(10500.0, ("gain_e_per_dn",), scales_with_area=True)
    ] = Field(
        None,
        description=(
            "in place of gain_e_per_dn: signal at 0 dB that the codes above the black level span,"
            " up to the highest"
        ),
    )
    dark_current_e_per_s: Annotated[
        Current | None, Number(3.0, in_technology=True, scales_with_area=True)
    ] = Field(None, description="dark current of one pixel")
    dark_current: Annotated[
        DarkCurrent | None,
        Number(
            {"e_per_s": 3.0, "at_c": 27.0, "doubling_k": 8.0},
            ("dark_current_e_per_s",),
            scales_with_area=True,
            hint=_hint_of_current,
        ),
    ] = Field(
        None,
        description=(
            "in place of dark_current_e_per_s: dark current at a temperature, from which that at"
            " temperature_k follows"
        ),
    )
    data_sheet_pitch_um: Annotated[Pitch | None, Number(3.75, is_certain=True)] = Field(
        None,
        description=(
            "pitch at which full well, gain and dark current were measured; they scale with the"
            " photodiode area"
        ),
    )
    read_noise_e: Annotated[
        NoiseElectrons | None,
        Number(2.3, part_of=TEMPORAL, in_technology=True, also=("read_noise", "readout_noise")),
    ] = Field(
        None,
        description=(
            "temporal read noise before the amplifier, which gain_db does not change; without reset"
            " noise"
        ),
    )
    read_noise_after_gain_e: Annotated[
        NoiseElectrons | None,
        Number(4.0, part_of=TEMPORAL, in_technology=True, technology_default=0.0),
    ] = Field(
        None,
        description=(
            "temporal read noise after the amplifier, in electrons at 0 dB; gain_db divides it by"
            " the amplification (absent: the technology's, or 0 if read_noise_e is given)"
        ),
    )
    row_noise_e: Annotated[
        NoiseElectrons | None,
        Number(0.5, part_of=TEMPORAL, in_technology=True, technology_default=0.0),
    ] = Field(
        None,
        description=(
            "temporal noise before the amplifier that all pixels of a row share, one value for each"
            " row of each frame"
        ),
    )
    temporal_dark_noise_e: Annotated[NoiseElectrons | None, Number(2.3)] = Field(
        None,
        description=(
            "in place of read_noise_e and of all other temporal noise: temporal dark noise (σ_d of"
            " EMVA 1288), the same at every gain_db, without quantisation noise, at an exposure so"
            " short that dark current adds none"
        ),
    )
    reset_noise_factor: Annotated[
        ResetFactor | None,
        Number(0.0, part_of=TEMPORAL, in_technology=True, technology_default=1.0),
    ] = Field(
        None,
        description=(
            "n in the reset noise variance n kTC/q²: hard reset 1, soft reset 0.5, delta double"
            " sampling 2"
        ),
    )
    prnu: Annotated[
        GainSpread | None,
        Number(0.005, in_technology=True, hint=lambda path, value: slip_hint("prnu", value)),
    ] = Field(None, description="standard deviation of the gain over its mean (PRNU)")
    prnu_percent: Annotated[Annotated[float, Field(ge=0, le=30)] | None, Number(0.5, ("prnu",))] = (
        Field(None, description="in place of prnu: the same in per cent")
    )
    prnu_um: Annotated[AreaMismatch | None, Number(0.02, ("prnu",))] = Field(
        None,
        description=(
            "in place of prnu: prnu times the side of the square photodiode, so that prnu is this"
            " at 1 µm²"
        ),
    )
    dsnu: Annotated[DarkSpread | None, Number(0.2, in_technology=True)] = Field(
        None,
        description=(
            "standard deviation of the dark current over its mean, without hot pixels (DSNU in"
            " electrons, as in EMVA 1288, is dsnu_e)"
        ),
    )
    hot_pixel_fraction: Annotated[
        UnitInterval | None, Number(0.001, in_technology=True, technology_default=0.0)
    ] = Field(
        None,
        description=(
            "fraction of pixels that are hot; the dark current remains the mean of all pixels"
        ),
    )
    hot_pixel_median: Annotated[
        HotMedian | None, Number(30.0, in_technology=True, technology_default=1.0)
    ] = Field(None, description="median dark current of hot pixels, over the mean of the others")
    hot_pixel_spread: Annotated[
        HotSpread | None, Number(1.0, in_technology=True, technology_default=0.0)
    ] = Field(
        None,
        description="standard deviation of the natural logarithm of the dark current of hot pixels",
    )
    dsnu_e: Annotated[NoiseElectrons | None, Number(2.0, ("offset_fpn", "column_fpn"))] = Field(
        None,
        description=(
            "in place of offset_fpn and column_fpn: standard deviation of the pixel offsets"
            " (DSNU1288 of EMVA 1288); none of it is spread of the dark current (dsnu)"
        ),
    )
    offset_fpn: Annotated[OffsetSpread | None, Number(0.0002, in_technology=True)] = Field(
        None, description="standard deviation of the pixel offsets, as a fraction of the full well"
    )
    a_vt_mv_um: Annotated[VoltageMismatch | None, Number(8.0, ("offset_fpn",))] = Field(
        None,
        description=(
            "in place of offset_fpn, with follower_area_um2: standard deviation of the threshold"
            " voltage of the source followers, times √follower_area_um2 (A_Vt of one transistor,"
            " 1/√2 of a pair's), for a 3T pixel without double sampling"
        ),
    )
    follower_area_um2: Annotated[GateArea | None, Number(0.5, ("offset_fpn",))] = Field(
        None,
        description=(
            "with a_vt_mv_um: gate area W·L of the source follower, the same at every pitch"
        ),
    )
    column_fpn: Annotated[OffsetSpread | None, Number(0.0001, in_technology=True)] = Field(
        None, description="standard deviation of the column offsets, as a fraction of the full well"
    )
    bits: Annotated[
        Annotated[int, Field(ge=1, le=24)], Number(12, also=("bit_depth", "adc_bits"))
    ] = Field(10, description="bits of the ADC")
    black_level_dn: Annotated[
        Annotated[float, Field(ge=0, lt=2**24)] | None,
        Number(64.0, is_certain=True, also=("black_level",)),
    ] = Field(
        None,
        description=(
            "offset added before the ADC (absent: 0; for a data sheet without a technology, 6"
            " standard deviations of the dark noise at gain_db, at most half of the codes)."
            " `pixsim datasheet` uses at least 6 standard deviations of the dark signal"
        ),
    )
    companding: Annotated[
        Literal["imx585", "automotive_24"] | Knees | None, Number("imx585", is_certain=True)
    ] = Field(
        None,
        description=(
            "codes on straight lines between knees, [linear DN, code] of whole, rising numbers; or"
            " 'imx585' (12 bits of 16) or 'automotive_24' (12 bits of 24). bits counts linear DN"
            " (absent: linear codes)"
        ),
    )
    readout: Annotated[
        ReadoutOptions | None, Number({"kind": "staggered", "ratio": 16.0}, is_certain=True)
    ] = Field(
        None, description="several readings of the pixel, and their merge (absent: one reading)"
    )
    temperature_k: Annotated[float, Field(ge=77, le=400)] = Field(
        300.15,
        description=(
            "temperature of the sensor, which sets dark current, reset noise, and the absorption"
            " where charge diffuses"
        ),
    )

    @model_validator(mode="after")
    def _states_each_quantity_once(self) -> Self:
        fields = PixelOptions.model_fields
        stated = [name for name in fields if getattr(self, name) is not None]
        for word in STANDS_FOR:
            if word in stated:
                excluded = excluded_by([word])
                both = [name for name in stated if name in excluded]
                if both:
                    raise ValueError(
                        f"{word} and {', '.join(both)} state the same quantity; give one of them"
                    )

        is_linear = self.well_limit == "swing" and self.conversion == "linear"
        if self.saturation_capacity_e is not None and not is_linear:
            raise ValueError(
                f"saturation_capacity_e with well_limit = '{self.well_limit}' and conversion ="
                f" '{self.conversion}'; the full well is solved for a linear pixel that clips"
                " (well_limit = 'swing', conversion = 'linear'). Give full_well_e instead"
            )
        if self.has_readings and not is_linear:
            raise ValueError(
                "got a readout of several readings, or companding, with well_limit ="
                f" '{self.well_limit}' and conversion = '{self.conversion}'; allowed: well_limit ="
                " 'swing' and conversion = 'linear'"
            )
        return self

    @model_validator(mode="after")
    def _black_below_white(self) -> Self:
        if self.codes_dn <= 0:
            raise ValueError(
                f"black_level_dn = {self.black_level_dn:g} is not below the highest code,"
                f" {2**self.bits - 1}"
            )
        return self

    @property
    def has_readings(self) -> bool:
        """Whether the pixel has readings whose codes need a merge, or a decoder."""
        is_single = self.readout is None or self.readout.is_single
        return not is_single or self.companding is not None

    @property
    def readout_area_um2(self) -> float:
        """Area that the circuits of several readings take from the photodiode."""
        return 0.0 if self.readout is None else self.readout.area_um2

    @property
    def bin_side(self) -> int:
        """Pixels along a side of those that are read as one."""
        return BIN if self.colour is not None and self.colour.binning else 1

    @property
    def stated_gain_e_per_dn(self) -> float | None:
        """Electrons per code at 0 dB by `gain_e_per_dn` or `dn_per_e`. None: the codes above the
        black level span a charge.
        """
        return self.gain_e_per_dn if self.dn_per_e is None else 1 / self.dn_per_e

    @property
    def codes_dn(self) -> float:
        """The codes above the stated black level."""
        return 2**self.bits - 1 - (self.black_level_dn or 0.0)

    @property
    def adc_range_per_well(self) -> float | None:
        """Ratio of the range of the ADC to the full well of a data sheet, if it states both."""
        full_well_e = self.saturation_capacity_e if self.full_well_e is None else self.full_well_e
        gain_e_per_dn = self.stated_gain_e_per_dn
        if full_well_e is None or gain_e_per_dn is None:
            return None
        return self.codes_dn * gain_e_per_dn / full_well_e


NUMBERS = numbers_of(PixelOptions)
# Words of data sheets or of the layout, and the fields that each of them stands for.
STANDS_FOR = {
    word: (*number.stands_for, *(name for name, part in NUMBERS.items() if word in part.part_of))
    for word, number in NUMBERS.items()
}
STANDS_FOR = {word: fields for word, fields in STANDS_FOR.items() if fields}


_PartOfPixel = Annotated[float, Field(ge=0, lt=1)]
# Width in pixels, on each side of the die, that is not scored on a display of fixed size: up to one
# pixel is uncovered at a registration, and half of the outermost pixel is interpolated as a
# constant.
BORDER_PIXELS = 1.5


class Pixel(PixelOptions):
    """One pixel of a sensor; `pixsim.pixel.derive` computes values of None from the technology.

    Without a technology, a complete data sheet is taken as it is: pitch_um, full_well_e,
    read_noise_e, dark_current_e_per_s and quantum_efficiency (or the words of a data sheet for
    them, see `PixelOptions`) make `technology` 'none'. If only some of them are given, the others
    come from the default technology, which `assumption` then states.

    >>> sheet = {"full_well_e": 10500, "read_noise_e": 2.3, "dark_current_e_per_s": 3}
    >>> Pixel(pitch_um=3.75, quantum_efficiency=0.62, **sheet).technology
    'none'
    >>> Pixel(pitch_um=3.75, full_well_e=10500).assumption
    'technology 0.35um assumed, without read_noise_e, dark_current_e_per_s, quantum_efficiency'
    """

    technology: str = Field(
        "0.35um",
        description=(
            "packaged technology, path of a TOML file, or 'none' (in Python also None) for a sensor"
            " described by its data sheet alone; with a complete data sheet, 'none' is the default"
        ),
    )
    pitch_um: Annotated[
        Pitch, Words(also=("pixel_size", "pixel_size_um", "pixel_pitch", "pixel_pitch_um", "pitch"))
    ] = Field(6.5, description="pixel pitch")
    registration: Annotated[tuple[_PartOfPixel, _PartOfPixel], BeforeValidator(as_list)] | None = (
        Field(
            None,
            description=(
                "[x, y]: distance of a pixel border from the die's centre, in pixels, at least 0"
                " and below 1"
                " (absent: the pixels are centred, and of several repeats each has its own)"
            ),
        )
    )

    @model_validator(mode="before")
    @classmethod
    def _complete_data_sheet_needs_no_technology(cls, values: object) -> object:
        if not isinstance(values, dict):
            return values
        if "technology" in values:
            needs_none = values["technology"] is None
        else:
            needs_none = is_data_sheet(values, "pitch_um")
        return {**values, "technology": NO_TECHNOLOGY} if needs_none else values

    @model_validator(mode="after")
    def _data_sheet_complete(self) -> Self:
        missing = missing_of_data_sheet(self.given | efficiencies_of(self.colour))
        if self.technology == NO_TECHNOLOGY and missing:
            raise ValueError(
                f"technology = 'none' derives no values; missing: {', '.join(missing)}. Give them,"
                " or a technology from which they are derived"
            )
        return self

    @property
    def given(self) -> frozenset[str]:
        """Names of the fields that were set, to a value other than None."""
        return frozenset(name for name in self.model_fields_set if getattr(self, name) is not None)

    @property
    def assumption(self) -> str:
        """The technology that is assumed since a data sheet is incomplete, in words; empty without
        one.
        """
        if not self.assumed:
            return ""
        return f"technology {self.technology} assumed, without {', '.join(self.assumed)}"

    @property
    def assumed(self) -> tuple[str, ...]:
        """Names that a data sheet lacks, whose values the assumed technology has; empty if none is
        assumed.
        """
        stated = self.given
        missing = missing_of_data_sheet(stated | efficiencies_of(self.colour))
        if "pitch_um" not in stated:
            missing = ["pitch_um", *missing]
        # Without any number of a data sheet, the pixel is one of a technology.
        is_data_sheet = len(missing) <= len(DATA_SHEET)
        if "technology" in stated or not is_data_sheet:
            return ()
        return tuple(missing)

    @property
    def is_stated(self) -> bool:
        """Whether its size, its technology or a number of its data sheet is stated."""
        return bool({"technology", "pitch_um"} & self.given or self.assumed)

    def __repr__(self) -> str:
        return super().__repr__() + (f"  # {self.assumption}" if self.assumption else "")


# A data sheet states them for its pitch only.
SCALED_WITH_AREA = tuple(name for name, number in NUMBERS.items() if number.scales_with_area)
