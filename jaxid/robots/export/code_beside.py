"""What an export leaves to code beside the robot's file, in runs of that file in MuJoCo: laws on
commands change the recorded goals; the others are not in these runs, which is said.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxid.base.numbers import is_finite
from jaxid.base.wording import listed
from jaxid.data.dataset import Dataset, Experiment
from jaxid.dynamics.effect import Command, Signals
from jaxid.dynamics.parameter import specs, with_fields
from jaxid.numerics.precision import float64
from jaxid.robots.export.law_code import kind_of, law_of
from jaxid.robots.export.target import CODE, ExportRow


def commanded(dataset: Dataset, rows: Iterable[ExportRow]) -> Dataset:
    """The dataset with its inputs as the laws on commands among these rows hand them on, sample by
    sample.
    """
    runs = dataset.experiments
    for row in _left_to_code(rows):
        if _on_command(row) and row.location in dataset.input_names:
            column = dataset.input_names.index(row.location)
            runs = tuple(_handed_on(e, column, row, dataset.sampling_time) for e in runs)
    return replace(dataset, experiments=runs)


def on_commands(rows: Iterable[ExportRow]) -> str:
    """What acts on commands; "" where nothing does."""
    return _told(row for row in _left_to_code(rows) if _on_command(row))


def left_out(rows: Iterable[ExportRow]) -> str:
    """What acts elsewhere, and so is not in these runs; "" where nothing does."""
    return _told(row for row in _left_to_code(rows) if not _on_command(row))


def _told(rows: Iterable[ExportRow]) -> str:
    return listed([f"{row.effect} at {row.location}" for row in rows])


def _left_to_code(rows: Iterable[ExportRow]) -> list[ExportRow]:
    return [row for row in rows if row.how == CODE and _has_numbers(row.value)]


def _has_numbers(value: object) -> bool:
    return isinstance(value, Mapping) and all(map(is_finite, value.values()))


def _on_command(row: ExportRow) -> bool:
    law = law_of(row.effect)
    return law is not None and law.port == "command"


def _handed_on(e: Experiment, column: int, row: ExportRow, period: float) -> Experiment:
    """The run with an input as the effect hands it on at each sample, `period` s apart."""
    kind: Any = kind_of(row.effect)
    told = {name: spec.value for name, spec in specs(kind).items()} | row.value
    numbers = {name: np.array([float(told[name])]) for name in specs(kind)}
    with float64():
        t, u = jnp.asarray(e.t), jnp.asarray(e.u[:, column])
        effect, h = with_fields(kind.sampled(period), numbers), jnp.asarray(period)

        def step(z: Any, now: tuple[Any, Any]) -> tuple[Any, Any]:
            moment, value = now
            own, still = value[None], jnp.zeros(1)
            command = Command(moment, h, own, own, lambda late: jnp.interp(moment - late, t, u))
            signals = Signals(moment, still, still, still, h, command, still)
            handed, z = effect(own, signals, z)
            return z, handed[0]

        _, after = jax.lax.scan(step, effect.start(u[:1]), (t, u))
        changed = e.u.copy()
        changed[:, column] = np.asarray(after)
    return replace(e, u=changed)
