"""Words as sentences, and settings as words."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from pixsim.base.digits import setting_text

STOPS = (".", "?", "!", ":")  # ends of a sentence
_IDENTIFIER = re.compile(r"\S*[\d_]|\S*\w\.\w")  # at the beginning


def capital(words: str) -> str:
    """Return words with a capital letter first, but for a name as files and settings have it.

    >>> capital("mean ΔE"), capital("my_sensor is better"), capital("f/4")
    ('Mean ΔE', 'my_sensor is better', 'f/4')
    """
    return words if _IDENTIFIER.match(words) else words[:1].upper() + words[1:]


def setting_value(value: object, name: str = "") -> object:
    """Return the value of a setting for a table; a curve of (wavelength in nm, value) by its size
    and range, and a table, or a list of tables, as words.

    name : of the setting
    """
    if isinstance(value, dict):
        return ", ".join(f"{name} {setting_value(inner, name)}" for name, inner in value.items())
    if isinstance(value, tuple | list) and value and isinstance(value[0], dict):
        return "; ".join(str(setting_value(inner)) for inner in value)
    if isinstance(value, tuple | list) and value and isinstance(value[0], tuple | list):
        lengths = dict.fromkeys(("chief_ray_angle", "relative_illumination", "fall_off"), " mm")
        unit = {**lengths, "tone_curve": " × white"}.get(name, " nm")
        return f"curve of {len(value)} points, {value[0][0]:g} to {value[-1][0]:g}{unit}"
    return setting_text(value) if isinstance(value, float) else value


def settings_line(settings: Mapping[str, Any]) -> str:
    """Return settings as one line."""
    return ", ".join(f"{name} = {setting_value(value, name)}" for name, value in settings.items())
