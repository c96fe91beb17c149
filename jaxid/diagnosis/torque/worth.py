"""What each named effect is worth on held-out runs: closed by itself, and missed without it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from jaxid.base.wording import percent
from jaxid.diagnosis.belief import Worth
from jaxid.diagnosis.torque.algebra import BLOCKS
from jaxid.diagnosis.torque.answer import Answer, of_model
from jaxid.diagnosis.torque.choose import Chooser, Model
from jaxid.diagnosis.torque.held_out import cut
from jaxid.diagnosis.torque.study import TorqueRows, TorqueStudy


#: Times that blocks are drawn anew for an interval.
DRAWS = 400
#: Effects of which the answer says it.
SAID = 3


def worth(
    study: TorqueStudy, rows: TorqueRows, chooser: Chooser, chosen: Model, which: Sequence[int]
) -> dict[tuple[str, str], Worth]:
    """Of each effect of the `chosen` model, by the runs `which`; nothing where the re-tuned model
    leaves no more than the noise there, or what is left is no number.
    """
    if not which:
        return {}
    left = _LeftOver(study, rows, which)
    before, after = left.of(chooser.nominal), left.of(chosen)
    out: dict[tuple[str, str], Worth] = {}
    for u in chosen.units:
        alone = chooser.model((u,))
        without = chooser.lively([v for v in chosen.units if v != u]) or chooser.nominal
        if alone is None:
            continue
        told = left.shares(before, after, left.of(alone), left.of(without))
        if told is not None:
            out[chooser.units[u].place] = told
    return out


class _LeftOver:
    """What models leave of the blocks of some runs."""

    def __init__(self, study: TorqueStudy, rows: TorqueRows, which: Sequence[int]):
        self.study, self.rows = study, rows
        lengths = [len(rows.rows[k]) for k in which]
        self.blocks = [(which[k], part) for k, part in cut(lengths, sum(lengths) / BLOCKS)]
        moving = [np.sum(study.runs[k].moves) * len(part) for k, part in self.blocks]
        self.count = np.array(moving, float)
        # Every draw counts each block so many times: the first as often as it was recorded.
        rng = np.random.default_rng(0)
        size = len(self.blocks)
        drawn = rng.multinomial(size, np.full(size, 1 / size), DRAWS)
        self.times = np.concatenate([np.ones((1, size)), drawn])

    def of(self, model: Model) -> np.ndarray:
        """Mean square of what a model leaves above the noise in each draw, noise 1."""
        answer: Answer = of_model(self.study, self.rows, model)
        squares = np.zeros(len(self.blocks))
        for b, (k, part) in enumerate(self.blocks):
            moves = self.study.runs[k].moves
            left = (answer.residual(k) / self.study.noise_of(k))[part][:, moves]
            squares[b] = np.sum(left**2)
        mean = self.times @ squares / np.maximum(self.times @ self.count, 1.0)
        return np.maximum(mean - 1.0, 0.0)

    @staticmethod
    def shares(
        before: np.ndarray, after: np.ndarray, alone: np.ndarray, without: np.ndarray
    ) -> Worth | None:
        """Of what is left in each draw by the re-tuned model, by that with all effects, with one
        alone, and with all but that.
        """
        inside = before > 0
        if not inside[0]:
            return None
        missed = (without[inside] - after[inside]) / before[inside]
        closes = float((before[0] - alone[0]) / before[0])
        if not np.isfinite([closes, *missed]).all():
            return None
        low, high = np.percentile(missed, [2.5, 97.5])
        return Worth(closes, float(missed[0]), (float(low), float(high)))


def worth_sentences(found: dict[tuple[str, str], Worth]) -> list[str]:
    """What is said of several effects: the share of each, or that another could stand for it."""
    if len(found) < 2:
        return []
    out = []
    ordered = sorted(found.items(), key=lambda entry: -entry[1].missed_without)
    for (effect, place), own in ordered[:SAID]:
        missed = percent(max(own.missed_without, 0.0))
        if own.share:
            out.append(f"{missed} of the gap is that of {effect} at {place}.")
        else:
            alone = percent(max(own.alone, 0.0))
            out.append(
                f"{effect} at {place} closes {alone} by itself, and {missed} is missed without it:"
                " another named effect could stand for a part."
            )
    return out
