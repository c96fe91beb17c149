"""A finding about a recording, and all of them together with the recording that they mend."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from jaxid.base.display import Displayed
from jaxid.base.serialise import plain
from jaxid.base.wording import one_line
from jaxid.data.dataset import Dataset


KINDS = (
    "time_unit",
    "does_not_move",
    "not_at_rest",
    "wrapped",
    "glitch",
    "repeated_rows",
    "saturated",
    "filtered",
    "sign",
    "zero",
    "scale",
    "swapped_channels",
    "row_shift",
    "clock",
    "unsigned",
    "law",
    "copy",
    "play",
    "impossible_body",
)
#: What no run can be used with as it is.
UNUSABLE = ("time_unit", "does_not_move")


@dataclass(frozen=True)
class DataFinding:
    """What seems to be wrong with a channel of a recording.

    `value` is the fault (-1 for a sign, the offset, factor, rows, ppm … by which the record is off,
    in SI), `interval_95` its interval; `gap_before` and `gap_if_mended` are what the model leaves,
    times the noise; `line` is what to write in `dataset.toml` ("" where nothing mends it);
    `same_as`: other readings that these data cannot tell from it.
    """

    kind: str
    channel: str
    value: float | None
    text: str
    line: str = ""
    interval_95: tuple[float, float] | None = None
    gap_before: float | None = None
    gap_if_mended: float | None = None
    decisive: bool = False
    applied: bool = False
    same_as: tuple[tuple[str, str], ...] = ()  # (kind, channel)
    headline: str = ""  # "tau has the opposite sign; everything below takes it negated"

    def to_dict(self) -> dict[str, Any]:
        """The form in which it stands in every result's JSON."""
        return plain(
            {
                "kind": self.kind,
                "channel": self.channel,
                "value": self.value,
                "interval_95": self.interval_95,
                "gap_before": self.gap_before,
                "gap_if_mended": self.gap_if_mended,
                "decisive": self.decisive,
                "applied": self.applied,
                "line": self.line,
                "same_as": [{"kind": kind, "channel": channel} for kind, channel in self.same_as],
                "text": self.text,
            }
        )


@dataclass(frozen=True, repr=False)
class Checked(Displayed):
    """What `jaxid.check` returns: the findings, and `mended`, the dataset with those applied that
    are decisive.
    """

    dataset: str
    dataset_sha256: str
    findings: tuple[DataFinding, ...]
    mended: Dataset | None = field(repr=False, compare=False)
    model: str = ""
    usable: bool = True
    notes: tuple[str, ...] = ()
    wall_time_s: float = 0.0
    model_sha256: str = ""  # of the file of a model of the user's own

    def to_dict(self) -> dict[str, Any]:
        from jaxid.base.serialise import model_digest, SCHEMA
        from jaxid.base.versions import versions

        return plain(
            {
                "schema": SCHEMA,
                "kind": "check",
                "dataset": self.dataset,
                "dataset_sha256": self.dataset_sha256,
                "model": self.model,
                **model_digest(self.model_sha256),
                "usable": self.usable,
                **as_data(self.findings),
                "wall_time_s": self.wall_time_s,
                "notes": self.notes,
                "versions": versions(),
            }
        )


def data_lines(findings: Sequence[DataFinding]) -> list[str]:
    """What comes first in every answer: `DATA: tau has the opposite sign; everything below takes it
    negated.`
    """
    return [f"DATA: {one_line(f.headline)}." for f in findings if f.applied]


def as_data(findings: tuple[DataFinding, ...]) -> dict[str, Any]:
    """`{"data": {"findings": [...]}}`, a part of every result."""
    return {"data": {"findings": [f.to_dict() for f in findings]}}
