"""A path to play: commands at times. Read from a file or from the folder that `jaxid excite`
writes, or made here.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from jaxid.base.errors import DatasetError, UsageError
from jaxid.data.limits import Limits


#: Kind of command -> (channel stem in files, unit).
KINDS = {"position": ("q", "rad"), "velocity": ("qd", "rad/s"), "current": ("current", "A")}
#: This many rows are a path that was sampled, and nobody samples one as sparsely as this (s).
SAMPLED, SPARSE_S = 100, 0.5
UNITS = (("ms", 1000), ("us", 1_000_000), ("ns", 1_000_000_000))
FIRST_ROW = 2  # row 1 of a file is its header
JUMP = "correct the row if it is a jump, else give the path more time"


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Commands `values [time joints]` at `t [time]` s (from 0, rising): `kind` position (rad),
    velocity (rad/s) or current (A).

    Positions and velocities are linear in between, currents are held. Raises `UsageError` for what
    is no such path.
    """

    t: np.ndarray
    values: np.ndarray
    kind: str = "position"
    source: str = ""

    def __post_init__(self):
        t, values = np.array(self.t, float), np.array(self.values, float)
        values = values[:, None] if values.ndim == 1 else values
        where = f"trajectory {self.source}".strip()
        if self.kind not in KINDS:
            raise UsageError(f"{where}: kind is {self.kind!r}; it is one of {', '.join(KINDS)}")
        if t.ndim != 1 or values.ndim != 2 or len(t) != len(values) or len(t) < 2:
            raise UsageError(
                f"{where}: t {t.shape} and commands {values.shape}; expected [time] and [time"
                " joints], 2 or more"
            )
        if not np.isfinite(t).all() or not np.isfinite(values).all():
            row = int(np.flatnonzero(~np.isfinite(values).all(axis=1) | ~np.isfinite(t))[0])
            raise UsageError(
                f"{where}: row {row + 2} holds a value that is not a number; correct the file"
            )
        if np.diff(t).min() <= 0:
            row = int(np.argmin(np.diff(t)))
            raise UsageError(
                f"{where}: time does not rise at row {row + 3} (t = {t[row + 1]:g} s); sort the"
                " file"
            )
        object.__setattr__(self, "t", t - t[0])
        object.__setattr__(self, "values", values)

    @property
    def joints(self) -> int:
        return self.values.shape[1]

    @property
    def duration(self) -> float:
        return float(self.t[-1])

    @property
    def sha256(self) -> str:
        return hashlib.sha256(self.t.tobytes() + self.values.tobytes()).hexdigest()

    @classmethod
    def read(
        cls,
        path: str | os.PathLike[str],
        joints: int = 1,
        kind: str = "position",
        named: Sequence[str] = (),
    ) -> Trajectory:
        """From CSV or Parquet with a column `t` and one command a joint, or from a dataset folder
        (its first run).

        Columns are `q1_cmd …` or `q1 …` (`qd`, `current` for the other kinds; no number where there
        is one joint), in SI. Positions may also be called by the joints of a robot's file, `named`
        in the order of the device: `elbow_cmd` or `elbow`.
        """
        path = Path(path)
        columns, t = _columns(path)
        chosen = []
        for place in range(joints):
            names = _names_of_command(place, joints, kind, named)
            found = next((name for name in names if name in columns), None)
            if found is None:
                raise UsageError(_lacking(path, names[0], columns, kind, joints))
            chosen.append(np.asarray(columns[found], float))
        return cls(t, np.stack(chosen, axis=1), kind, str(path))

    @classmethod
    def multisine(
        cls,
        amplitude: Sequence[float] | float,
        duration: float,
        *,
        center: Sequence[float] | float = 0.0,
        frequencies: tuple[float, float] = (0.1, 2.0),
        lines: int = 8,
        rest: float = 0.5,
        kind: str = "position",
        seed: int = 0,
        rate: float = 500.0,
    ) -> Trajectory:
        """A sum of sines in a band (Hz), faded in and out over a second (less where it is short),
        with `rest` s of stillness at both ends.

        `amplitude` is the largest excursion from `center` of each joint. For excitation without a
        model; `jaxid excite` optimises one for a model.
        """
        sizes = np.atleast_1d(np.asarray(amplitude, float))
        centers = np.broadcast_to(np.asarray(center, float), sizes.shape)
        rng = np.random.default_rng(seed)
        t = np.arange(round(duration * rate) + 1) / rate
        length = min(1.0, max(t[-1] / 2 - rest, 1e-3))
        edge = np.clip(np.minimum(t - rest, t[-1] - rest - t) / length, 0.0, 1.0)
        fade = edge**3 * (
            10 - 15 * edge + 6 * edge**2
        )  # rises from 0 to 1 without a jump in speed or acceleration
        values = np.empty((len(t), len(sizes)))
        for j, a in enumerate(sizes):
            f = np.geomspace(*frequencies, lines) * rng.uniform(0.95, 1.05, lines)
            phase = rng.uniform(0, 2 * np.pi, lines)
            x = (
                np.sum(
                    np.sin(2 * np.pi * f[:, None] * t + phase[:, None]) / f[:, None] ** 0.5, axis=0
                )
                * fade
            )
            values[:, j] = centers[j] + a * x / np.abs(x).max()
        return cls(
            t,
            values,
            kind,
            f"multisine, {lines} lines from {frequencies[0]:g} to {frequencies[1]:g} Hz, seed"
            f" {seed}",
        )

    def sampled(self, step: float) -> np.ndarray:
        """Commands `[time joints]` every `step` s, first and last included."""
        times = _times(self.duration, step)
        if self.kind == "current":
            return self.values[np.searchsorted(self.t, times + 1e-9, side="right") - 1]
        return np.stack([np.interp(times, self.t, v) for v in self.values.T], axis=1)

    def check(self, limits: Limits, step: float) -> list[str]:
        """Every way in which the path, played with a command every `step` s, breaks a limit, as a
        sentence with its row and a remedy: the worst place of each joint and quantity.

        Values and speeds are those of the rows, accelerations and steps those of the commands.
        """
        limits = limits.widened(self.joints)
        sent, at = self.sampled(step), _times(self.duration, step)
        if self.kind != "position":  # nothing is commanded before and after
            sent, at = np.pad(sent, ((1, 1), (0, 0))), np.concatenate([at[:1], at, at[-1:]])
        change, unit = np.diff(sent, axis=0), KINDS[self.kind][1]
        slower = "scale the path down"
        texts: list[str] = []
        if self.kind == "position":
            speeds = np.diff(self.values, axis=0) / np.diff(self.t)[:, None]
            bend = np.diff(change, axis=0) / step**2
            # The last step is shorter than the others in the file and shows a rate that nothing
            # follows.
            bend = bend[:-1] if len(bend) > 1 else bend
            inside = "keep the path inside"
            most = _both(limits.acceleration)
            texts += self._worst("q", self.t, self.values, limits.lower, limits.upper, unit, inside)
            texts += self._worst("speed", self.t[1:], speeds, *_both(limits.speed), "rad/s", JUMP)
            texts += self._worst(
                "acceleration", at[1 : 1 + len(bend)], bend, *most, "rad/s^2", JUMP
            )
        elif self.kind == "velocity":
            most = _both(limits.acceleration)
            texts += self._worst("qd", self.t, self.values, *_both(limits.speed), unit, slower)
            texts += self._worst("acceleration", at[1:], change / step, *most, "rad/s^2", JUMP)
        else:
            top = _both(limits.current)
            texts += self._worst("current", self.t, self.values, *top, unit, slower)
        if limits.step is not None:
            texts += self._worst("step", at[1:], change, *_both(limits.step), unit, JUMP)
        return texts

    def not_in_seconds(self) -> str:
        """A sentence where the time is hardly in seconds (of a path that was sampled, rows that lie
        far apart), or nothing.
        """
        step = float(np.median(np.diff(self.t)))
        if len(self.t) <= SAMPLED or step < SPARSE_S:
            return ""
        guess = next(
            (
                f"rather {name} than s: divide it by {n}"
                for name, n in UNITS
                if 1e-4 <= step / n <= 0.1
            ),
            "no time in s",
        )
        k = 1 + int(np.argmax(np.diff(self.t) >= SPARSE_S))
        return (
            f"column t is {guess}. Read as seconds, row {k + FIRST_ROW} comes"
            f" {self.t[k] - self.t[k - 1]:g} s after the last and {len(self.t)} rows take"
            f" {self.duration / 3600:.3g} h; if that is meant, write rows less than {SPARSE_S:g} s"
            " apart"
        )

    def _worst(self, word, at, values, lower, upper, unit, remedy):
        for j in range(self.joints if upper is not None or lower is not None else 0):
            name = f"{word} of joint {j + 1}" if self.joints > 1 else word
            for bound, excess in ((upper, 1.0), (lower, -1.0)):
                if bound is None or not len(values):
                    continue
                k = int(np.argmax(excess * values[:, j]))
                if excess * (values[k, j] - bound[j]) > 1e-9 + 1e-6 * abs(bound[j]):
                    row = (
                        min(int(np.searchsorted(self.t, at[k] - 1e-9)), len(self.t) - 1) + FIRST_ROW
                    )
                    found = f"{name} reaches {values[k, j]:.4g} {unit} at {at[k]:.3f} s (row {row})"
                    yield f"{found}; the limit is {bound[j]:.4g} {unit}: {remedy}"


def _times(duration: float, step: float) -> np.ndarray:
    """Every `step` s from 0 on, and the end."""
    return np.append(step * np.arange(max(1, int(np.ceil(duration / step - 1e-6)))), duration)


def _both(limit):
    return (None, None) if limit is None else (tuple(-v for v in limit), limit)


def _names_of_command(place: int, joints: int, kind: str, named: Sequence[str]) -> list[str]:
    """What the column of a joint's command may be called, the most usual first."""
    stem = KINDS[kind][0]
    words = [f"{stem}{place + 1}"]
    if joints == 1:
        words.insert(0, stem)
    if kind == "position":
        words += named[place : place + 1]
    names = []
    for word in words:
        names += [f"{word}_cmd", word]
    return names


def _lacking(path: Path, column: str, columns: Iterable[str], kind: str, joints: int) -> str:
    """What is said where a trajectory lacks a joint's command."""
    there = list(columns)
    said = f"trajectory {path}: there is no column {column!r} (there is: {', '.join(there)})"
    if kind == "current" and any(name.startswith("tau") for name in there):
        return f"{said}; design it with --gain (N m/A), which adds the currents of its torques"
    each = "one column" if joints == 1 else f"one column for each of {joints} joints"
    return f"{said}; a {kind} command needs {each}"


def _columns(path: Path) -> tuple[dict[str, np.ndarray], np.ndarray]:
    if path.is_dir():
        from jaxid.data.io import load_dataset

        try:
            data = load_dataset(path, check_model=False)
        except DatasetError as error:
            raise UsageError(f"trajectory {path}: {error}") from error
        if not data.experiments:
            raise UsageError(f"trajectory {path}: the folder holds no run to play")
        run = data.experiments[0]
        columns = {c.name: run.u[:, i] for i, c in enumerate(data.inputs)}
        columns |= {c.name: run.y[:, i] for i, c in enumerate(data.outputs)}
        return columns | run.auxiliary, run.t
    from jaxid.data.table import read_table

    try:
        table = read_table(path, path.name, path.read_bytes())
    except OSError as error:
        raise UsageError(f"trajectory {path}: cannot be read ({error.strerror})") from error
    if table.problems:
        raise UsageError(f"trajectory {path}: {table.problems[0]}")
    if "t" not in table.columns:
        raise UsageError(
            f"trajectory {path}: there is no column 't' (there is: {', '.join(table.columns)})"
        )
    return {
        name: table.numbers(name).values for name in table.columns if name != "t"
    }, table.numbers("t").values
