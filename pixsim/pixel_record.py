"""A pixel as its user tells it: measured values, and the technology that the others are derived from."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import BeforeValidator, Field, WithJsonSchema, model_validator

from pixsim import bounds
from pixsim.quantum_efficiency import as_quantum_efficiency
from pixsim.record import Record

NO_TECHNOLOGY = "none"
# What a data sheet must tell of a pixel that has no technology; non-uniformities and offsets are none where it is silent.
DATA_SHEET = ("full_well_e", "read_noise_e", "dark_current_e_per_s", "quantum_efficiency")
QuantumEfficiency = Annotated[
    bounds.Fraction | tuple[tuple[float, float], ...],
    BeforeValidator(as_quantum_efficiency),
    WithJsonSchema(
        {
            "anyOf": [
                {"type": "number", "exclusiveMinimum": 0, "maximum": 1},
                {"type": "string", "description": "a CSV file of wavelength in nm and quantum efficiency, beside the TOML file"},
                {"type": "array", "items": {"type": "array", "items": {"type": "number"}, "minItems": 2, "maxItems": 2}},
            ]
        }
    ),
]


class PixelOptions(Record):
    """A pixel but for its process and size. What is left at None is derived from the technology."""

    capacitance: Literal["mosis", "paper"] = Field(
        "mosis", description="junction capacitance of the process, or 2.6 fF + 0.22 fF/µm² and a swing of 1 V"
    )
    well_limit: Literal["swing", "diode"] = Field(
        "swing", description="what fills the well: the voltage swing (hard clip), or the diode turning forward (soft, about twice)"
    )
    conversion: Literal["linear", "junction"] = Field(
        "linear", description="charge to voltage: proportional, or by the junction's capacitance, which grows as it discharges"
    )
    response: Literal["scaled", "literal"] = Field(
        "scaled", description="reading of the response curve: A/W scaled to the measured peak, or literally a QE"
    )
    quantum_efficiency: QuantumEfficiency | None = Field(
        None,
        description="of the photodiode: a number for every wavelength, a CSV file or pairs of (wavelength in nm, value); None: the "
        "technology's response curve",
    )
    infrared_cut_nm: bounds.Wavelength | None = Field(None, description="no response beyond this wavelength")
    fill_factor_law: Literal["technology", "inset", "inset_unlimited"] = Field(
        "technology", description="photodiode area against pitch: the technology's, or another fit to the paper's numbers"
    )
    fill_factor: bounds.Fraction | None = Field(None, description="photodiode area over pixel area")
    full_well_e: bounds.Well | None = Field(None, description="charge that the ADC's top code stands for")
    dark_current_e_per_s: bounds.Current | None = Field(None, description="per pixel")
    data_sheet_pitch_um: bounds.Pitch | None = Field(
        None,
        description="pitch at which full_well_e and dark_current_e_per_s were measured; at others both go with the photodiode's "
        "area. None: they hold at every pitch",
    )
    read_noise_e: bounds.NoiseElectrons | None = Field(None, description="temporal, beside the reset noise")
    reset_noise_factor: bounds.ResetFactor | None = Field(
        None, description="n in the variance n kTC/q²: 1 in the paper, ½ soft reset, 2 hard with delta double sampling"
    )
    prnu: bounds.GainSpread | None = Field(None, description="standard deviation of the gain over its mean")
    dsnu: bounds.DarkSpread | None = Field(
        None,
        description="spread of the dark current over its mean; EMVA 1288's DSNU in electrons is offset_fpn × full_well_e",
    )
    offset_fpn: bounds.OffsetSpread | None = Field(None, description="per pixel, fraction of the full well")
    column_fpn: bounds.OffsetSpread | None = Field(None, description="per column, fraction of the full well")
    bits: Annotated[int, Field(ge=1, le=24)] = Field(10, description="of the ADC")
    black_level_dn: Annotated[float, Field(ge=0, lt=2**24)] = Field(
        0.0, description="added before the ADC; at least 6 σ of the dark for data sheets"
    )
    temperature_k: Annotated[float, Field(ge=77, le=400)] = Field(300.15, description="of dark current and reset noise")

    @model_validator(mode="after")
    def _black_below_white(self) -> Self:
        if self.black_level_dn >= 2**self.bits - 1:
            raise ValueError(f"black_level_dn = {self.black_level_dn:g} leaves no codes below {2**self.bits - 1}")
        return self


class Pixel(PixelOptions):
    """One pixel of a sensor; `pixsim.pixel.derive` fills in what is left at None."""

    technology: str = Field(
        "0.35um", description="a packaged technology, the path of a TOML file, or none for a sensor that is known by its data sheet"
    )
    pitch_um: bounds.Pitch = Field(6.5, description="centre to centre")

    @model_validator(mode="after")
    def _known_by_its_data_sheet(self) -> Self:
        """Without a process nothing can be derived."""
        missing = [name for name in DATA_SHEET if getattr(self, name) is None]
        if self.technology == NO_TECHNOLOGY and missing:
            raise ValueError(
                f"technology = 'none' derives nothing; missing: {', '.join(missing)}. Give them, or name a technology that they "
                "are derived from"
            )
        return self
