"""CMOS processes, read from TOML files in which every number has a source and a confidence."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Annotated, Self

from pydantic import Field, model_validator

from pixsim.config import packaged, read_toml
from pixsim.errors import PixsimError, refuse
from pixsim.parameters import Fraction, NonNegative, Positive, Record


class Technology(Record):
    """A CMOS process, as a 3T pixel sees it. Junction parameters carry their SPICE names; capacitances are zero-bias."""

    name: str
    feature_size_um: Positive
    reset_voltage_v: Positive
    voltage_swing_v: Positive
    cj_ff_per_um2: NonNegative
    pb_v: Positive
    mj: Annotated[float, Field(ge=0, lt=1)]
    cjsw_ff_per_um: NonNegative
    pbsw_v: Positive
    mjsw: Annotated[float, Field(ge=0, lt=1)]
    node_capacitance_ff: NonNegative
    dark_current_na_per_cm2: NonNegative
    dark_doubling_k: Positive
    peak_quantum_efficiency: Fraction
    prnu: NonNegative
    dsnu: NonNegative
    offset_fpn: NonNegative
    column_fpn: NonNegative
    read_noise_e: NonNegative
    fill_factor_limit: Fraction
    fill_factor_zero_pitch_features: Positive
    sources: dict[str, str] = Field(default_factory=dict, description="field -> confidence and source")

    @model_validator(mode="after")
    def _swing_below_reset(self) -> Self:
        if self.voltage_swing_v > self.reset_voltage_v:
            raise ValueError(
                f"voltage_swing_v = {self.voltage_swing_v:g} exceeds reset_voltage_v = {self.reset_voltage_v:g}"
            )
        return self


@lru_cache
def load_technology(name: str) -> Technology:
    """A packaged technology by name, or a user's by the path of its TOML file.

    Every number is a table `{value, confidence, source}`. PixsimError for an unknown name, naming the known ones.
    """
    known = packaged("data/technologies")
    path = known.get(name) or Path(name)
    if path.suffix != ".toml":
        raise refuse("technology", f"'{name}'", ", ".join(known), "Or give the path of a technology's TOML file.")
    table = read_toml(path)
    numbers = {key: entry for key, entry in table.items() if isinstance(entry, dict)}
    try:
        return Technology(
            name=table.get("name", path.stem),
            **{key: entry["value"] for key, entry in numbers.items()},
            sources={key: f"{entry['confidence']}: {entry['source']}" for key, entry in numbers.items()},
        )
    except KeyError as missing:
        raise PixsimError(f"technology '{path}': an entry has no {missing}; each needs value, confidence, source") from None
