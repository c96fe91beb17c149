"""How near a model has to come: what is left within a stated accuracy is not missing.

`"1 mrad"` is of every output of that dimension, `"q = 1 mrad, tau = 0.1 N m"` of these channels
alone; torques are those that a diagnosis by torque compares.
An accuracy counts like noise: a gap is a multiple of both together, and what lies within is none.
So does what a channel that was moved in time is not known by (`jaxid.data.retimed`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from jaxid.base.errors import UsageError
from jaxid.base.wording import listed
from jaxid.data.dataset import Dataset
from jaxid.data.noise import Noise
from jaxid.data.retimed import known_within
from jaxid.data.units import conversion, si_unit, UnitError


HOW = 'write "1 mrad", or "q = 1 mrad, position = 0.1 mm" by channel'


def accuracy_of(
    text: str, channels: Mapping[str, str], outputs: Mapping[str, str]
) -> dict[str, float]:
    """Channel -> accuracy in its SI unit, of `channels` by name or of `outputs` (name -> unit).
    Raises `UsageError` for what is no accuracy, and for a channel or a dimension that there is not.
    """
    out: dict[str, float] = {}
    for part in text.split(","):
        name, is_named, size = part.rpartition("=")
        value, unit = _quantity(size)
        named = [name.strip()] if is_named else _of_dimension(unit, outputs)
        for channel in named:
            if channel not in channels:
                raise UsageError(
                    f"accuracy: there is no channel {channel!r}; there is: {listed(channels)}"
                )
            own = channels[channel]
            if si_unit(unit) != si_unit(own):
                raise UsageError(
                    f"accuracy: {channel} is in {own}, and {unit} is another dimension"
                )
            out[channel] = value
    return out


def _quantity(text: str) -> tuple[float, str]:
    """A size in SI and its unit."""
    number, _, unit = text.strip().partition(" ")
    try:
        if not unit:
            raise ValueError
        value = float(number) * conversion(unit.strip()).factor
    except (ValueError, UnitError) as error:
        raise UsageError(f"accuracy: {text.strip()!r} is not a size with a unit; {HOW}") from error
    if not (np.isfinite(value) and value > 0):
        raise UsageError(f"accuracy: {text.strip()!r} is not above 0; {HOW}")
    return value, unit.strip()


def _of_dimension(unit: str, channels: Mapping[str, str]) -> list[str]:
    found = [name for name, own in channels.items() if si_unit(own) == si_unit(unit)]
    if not found:
        told = listed(f"{name} ({own})" for name, own in channels.items())
        raise UsageError(f"accuracy: no output is in {unit}; there is: {told}")
    return found


def with_accuracy(dataset: Dataset, text: str | None) -> Dataset:
    """The dataset with the accuracy that a diagnosis of it is asked for."""
    if text is None:
        return dataset
    units = {c.name: c.unit for c in dataset.channels}
    outputs = {c.name: c.unit for c in dataset.outputs}
    return replace(dataset, accuracy=accuracy_of(text, units, outputs))


def beside_accuracy(noise: Mapping[str, Noise], dataset: Dataset) -> dict[str, Noise]:
    """The noise of each output beside which it has to be followed no nearer than asked, nor nearer
    than its times are known.
    """
    asked = _beside(noise, dataset.accuracy, "was not asked for")
    return _beside(asked, known_within(dataset), "its times, moved within a row, are not known")


def _beside(noise: Mapping[str, Noise], sizes: Mapping[str, float], why: str) -> dict[str, Noise]:
    out = dict(noise)
    for name, size in sizes.items():
        if name in noise:
            own = noise[name]
            text = f"{own.text}; nearer than {size:.2g} {own.unit} {why}"
            out[name] = replace(own, std=float(np.hypot(own.std, size)), text=text)
    return out
