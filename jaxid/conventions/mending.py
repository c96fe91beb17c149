"""What mends a recording: the change of its samples, and the line of `dataset.toml` that says the
same.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from jaxid.data.dataset import Channel, Dataset, Experiment, StatedChannel
from jaxid.data.forms import signal
from jaxid.data.records import MINIMUM_SAMPLES
from jaxid.data.retimed import retimed
from jaxid.data.schema import ChannelEntry
from jaxid.data.units import Conversion, named_unit


#: Forms of the numbers as they were recorded, before any scale.
REGISTER = frozenset({"sign_bit", "signed_bits"})


@dataclass(frozen=True)
class Mending:
    """Forms by channel (`scale`, `offset`, `unwrap`, `shift` …, on SI values), channels that take
    each other's samples, whether a start at rest is no longer claimed, and samples `(run, first,
    stop)` that are left out: before anything else is changed.
    """

    forms: dict[str, dict[str, Any]] = field(default_factory=dict)
    exchanged: tuple[tuple[str, str], ...] = ()
    moving: bool = False
    left_out: tuple[tuple[str, int, int], ...] = ()

    def then(self, other: Mending) -> Mending:
        """Both, one after the other; scales and offsets of a channel compose."""
        forms = {name: dict(own) for name, own in self.forms.items()}
        for name, more in other.forms.items():
            own = forms.setdefault(name, {})
            for key, value in more.items():
                if key == "scale":
                    own["scale"] = own.get("scale", 1.0) * value
                    if "offset" in own:
                        own["offset"] *= value
                elif key in ("offset", "shift", "clock_ppm", "delay_s"):
                    own[key] = own.get(key, 0) + value
                else:
                    own[key] = value
        return Mending(
            forms,
            self.exchanged + other.exchanged,
            self.moving or other.moving,
            self.left_out + other.left_out,
        )

    def __bool__(self) -> bool:
        return bool(self.forms or self.exchanged or self.moving or self.left_out)


def mended(dataset: Dataset, mending: Mending) -> Dataset:
    """The dataset with these changes made to every run."""
    if not mending:
        return dataset
    kept = [_without(e, mending.left_out) for e in dataset.experiments]
    runs = tuple(_run(dataset, e, mending) for e in kept if e is not None)
    channels = tuple(_retimed(c, mending) for c in dataset.channels)
    return replace(dataset, channels=channels, experiments=runs)


def _retimed(channel: Channel, mending: Mending) -> Channel:
    forms = mending.forms.get(channel.name, {})
    return retimed(channel, forms.get("delay_s", 0.0), forms.get("clock_ppm", 0.0))


def _without(e: Experiment, left_out: tuple[tuple[str, int, int], ...]) -> Experiment | None:
    """A run without some of its samples: the longest stretch of the others, or None where that is
    too short to say anything.
    """
    taken = np.zeros(len(e), bool)
    for name, first, stop in left_out:
        if name == e.name:
            taken[first:stop] = True
    if not taken.any():
        return e
    edges = np.flatnonzero(np.diff(np.concatenate([[True], taken, [True]]).astype(int)))
    stretches = edges.reshape(-1, 2)
    first, stop = max(stretches.tolist(), key=lambda s: s[1] - s[0], default=(0, 0))
    return (
        None
        if stop - first < MINIMUM_SAMPLES
        else e.piece(first, stop, name=e.name, split=e.split, past=first)
    )


def _run(dataset: Dataset, e: Experiment, mending: Mending) -> Experiment:
    past = e.past_by(lambda before: _run(dataset, before, mending))
    left = ~e.read
    read: dict[str, tuple[np.ndarray, np.ndarray]] = {}
    for k, c in enumerate(dataset.inputs):
        read[c.name] = e.u[:, k], np.zeros(len(e), bool)
    for k, c in enumerate(dataset.outputs):
        read[c.name] = e.y[:, k], left[:, k]
    read |= {name: (v, np.zeros(len(e), bool)) for name, v in e.auxiliary.items()}
    for a, b in mending.exchanged:
        read[a], read[b] = read[b], read[a]
    known = np.ones(len(e), bool)
    for channel in dataset.channels:
        if channel.name not in mending.forms or channel.name not in read:
            continue
        forms = mending.forms[channel.name]
        entry = ChannelEntry(role=channel.role, unit=channel.unit, hold=channel.hold, **forms)  # pyright: ignore
        values, out = read[channel.name]
        conversion = Conversion(1.0, channel.unit)
        if REGISTER & forms.keys():  # the bits are those of what was recorded
            entry, conversion, values = _as_recorded(channel, entry, values)
        found = signal(values, e.t, ~out, entry, conversion)
        read[channel.name] = found.values, found.left_out
        known &= found.known
    there = np.flatnonzero(known)
    span = slice(int(there[0]), int(there[-1]) + 1)

    def take(channels, k):
        return [read[c.name][k][span] for c in channels]

    def stack(parts, dtype):
        return np.stack(parts, 1) if parts else np.zeros((span.stop - span.start, 0), dtype)

    return replace(
        e,
        t=e.t[span],
        u=stack(take(dataset.inputs, 0), float),
        y=stack(take(dataset.outputs, 0), float),
        left_out=stack(take(dataset.outputs, 1), bool),
        auxiliary={name: read[name][0][span] for name in e.auxiliary},
        scatter=None if e.scatter is None else e.scatter[span],
        at_rest=e.at_rest and not mending.moving,
        past=past,
    )


def raw_of(channel: Channel, values: np.ndarray) -> np.ndarray:
    """What was recorded where a channel has these values (SI), by the scale and offset that
    `dataset.toml` states.
    """
    s = channel.stated or StatedChannel(channel.unit)
    return (values / s.factor - s.offset) / s.scale


def _as_recorded(
    channel: Channel, entry: ChannelEntry, values: np.ndarray
) -> tuple[ChannelEntry, Conversion, np.ndarray]:
    """The entry, conversion and samples of a channel as its file has them, whole numbers of a
    register.
    """
    s = channel.stated or StatedChannel(channel.unit)
    stated = entry.model_copy(update={"scale": s.scale, "offset": s.offset})
    return stated, Conversion(s.factor, channel.unit), np.round(raw_of(channel, values))


def lines(dataset: Dataset, channel: str, forms: Mapping[str, Any]) -> str:
    """What to write for a channel in `dataset.toml`, in its stated unit and with what stands there
    already.
    """
    found = next(c for c in dataset.channels if c.name == channel)
    s = found.stated or StatedChannel(found.unit)
    out = []
    unit = (
        named_unit(found.unit, s.factor * forms["scale"])
        if "scale" in forms and "offset" not in forms
        else ""
    )
    if unit:
        out.append(f'unit = "{unit}"')
    elif "scale" in forms:
        out.append(f"scale = {_short(forms['scale'] * s.scale)}")
    offset = forms.get("scale", 1.0) * s.offset + forms.get("offset", 0.0) / s.factor
    if not unit and abs(offset - s.offset) > 1e-9 * max(1.0, abs(s.offset)):
        out.append(f"offset = {_short(offset)}")
    for key, value in forms.items():
        if key not in ("scale", "offset"):
            out.append(f"{key} = {_form_text(found, s, key, value)}")
    return "\n".join(out)


def _form_text(channel: Channel, s: StatedChannel, key: str, value: Any) -> str:
    """The value of a form, on top of what stands there already."""
    if key == "unwrap":
        turn = channel.unit == "rad" and abs(value - 2 * np.pi) < 1e-6
        return "true" if turn else _short(value / s.factor / abs(s.scale))
    if key == "shift":
        return str(s.shift + value)
    if key == "delay_s":
        return f"{s.delay_s + value:.4g}"
    if key == "clock_ppm":
        return f"{s.clock_ppm + value:.4g}"
    return str(value).lower() if isinstance(value, bool) else str(value)


def _short(value: float) -> str:
    return f"{value:.6g}" if value != int(value) or abs(value) > 1e9 else str(int(value))


def exchange_lines(dataset: Dataset, a: str, b: str) -> str:
    """The `column` lines that make two channels take each other's samples."""
    column = {c.name: c.name for c in dataset.channels}
    column |= {c.name: c.stated.column for c in dataset.channels if c.stated and c.stated.column}
    return f'column = "{column[b]}"  # of {a}\ncolumn = "{column[a]}"  # of {b}'
