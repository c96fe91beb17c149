"""What the fields of all tables of dataset.toml share."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat


Number = FiniteFloat | bool


Positive = Field(default=None, gt=0)


class Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


def plain_text(text: str) -> str:
    if not text.strip():
        raise ValueError("is empty")
    if any(ord(c) < 32 or ord(c) == 127 for c in text):
        raise ValueError("holds control characters")
    return text
