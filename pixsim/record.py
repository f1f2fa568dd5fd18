"""What every set of parameters is: frozen, checked when made, with a content hash out."""

from __future__ import annotations

import hashlib
import json
from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationInfo, field_validator


class Record(BaseModel):
    """A frozen set of parameters; an unknown name is an error, pydantic's ValidationError, which is a ValueError."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    @field_validator("*", mode="before")
    @classmethod
    def _no_truth_for_a_number(cls, value: Any, info: ValidationInfo) -> Any:
        """Pydantic takes true for 1: `bits = true` would be a sensor of one bit."""
        if isinstance(value, bool) and cls.model_fields[info.field_name or ""].annotation is not bool:
            raise ValueError(f"got {value}; allowed: a number or a name")
        return value

    @property
    def content_hash(self) -> str:
        """16 hexadecimal digits of all that it holds."""
        return content_hash(self.model_dump(mode="json"))


def content_hash(content: object) -> str:
    """16 hexadecimal digits (BLAKE2b) that depend on the JSON content only, not on the order of the keys."""
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.blake2b(text.encode(), digest_size=8).hexdigest()
