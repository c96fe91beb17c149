"""What sets of effects leave of blocks that were not fitted to them, by algebra alone.

Rows are cut into blocks, and blocks are dealt into folds. Each fold is predicted by numbers that
are fitted to all others. The columns of the model that every set has are projected out once per
fold, so that a set costs a few small systems, however many rows and numbers there are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from jaxid.diagnosis.torque.algebra import ColumnPrior


#: Folds that blocks are dealt into.
FOLDS = 8
#: Blocks of all runs together: at least so many, and at most.
FEWEST, MOST = 6, 40
#: Rows come at four times the cutoff of their filter: so many of them share their noise.
SHARED = 2.0
#: A direction of the scaled columns that has less than this share of the data is held.
WEAK = 1e-8


@dataclass(frozen=True, eq=False)
class JudgedRun:
    """The rows of one run: columns and, last, target [samples n p + 1]; what each row weighs where
    numbers are fitted [samples n], and the standard deviation of its noise [samples n]; which
    joints move [n].
    """

    rows: np.ndarray
    weight: np.ndarray
    noise: np.ndarray
    moves: np.ndarray


@dataclass(frozen=True, eq=False)
class _Products:
    """Sums of products of the columns `at` that act at one joint, and the target, of each fold
    [folds c + 1 c + 1]: as fitted, and in units of the noise.
    """

    at: np.ndarray
    fitted: np.ndarray
    judged: np.ndarray


def cut(lengths: Sequence[int], memory: float) -> list[tuple[int, np.ndarray]]:
    """Blocks (run, samples) of runs of these lengths, of at least `memory` samples where the runs
    have room for it.
    """
    total = sum(lengths)
    length = np.clip(memory, total / MOST, max(total / FEWEST, 1.0))
    blocks = []
    for run, count in enumerate(lengths):
        pieces = max(1, round(count / length))
        parts = np.array_split(np.arange(count), pieces)
        blocks += [(run, part) for part in parts if len(part)]
    return blocks


class HeldOutRows:
    """Sums of products of every fold and joint of some runs, from which sets are judged.

    `known`: what is known of all columns beforehand. `memory`: over how many rows what the
    re-tuned model leaves is alike.
    """

    def __init__(self, runs: Sequence[JudgedRun], known: ColumnPrior, memory: float):
        self.known = known
        self.size = runs[0].rows.shape[2] - 1
        n = runs[0].rows.shape[1]
        blocks = cut([len(r.rows) for r in runs], memory)
        self.folds = min(FOLDS, len(blocks))
        moving = np.array([len(r.rows) * r.moves for r in runs], float)
        #: Independent rows of each joint [n].
        self.rows = moving.sum(0) / SHARED
        self.joints = [self._of_joint(runs, blocks, j) for j in range(n)]
        self.total = np.zeros((self.size + 1, self.size + 1))
        for products in self.joints:
            at = np.append(products.at, self.size)
            self.total[at[:, None], at] += products.fitted.sum(0)

    def _of_joint(
        self, runs: Sequence[JudgedRun], blocks: Sequence[tuple[int, np.ndarray]], joint: int
    ) -> _Products:
        own = [r.rows[:, joint] for r in runs]
        acts = np.any([np.any(x[:, :-1] != 0, axis=0) for x in own], axis=0)
        at = np.flatnonzero(acts)
        shape = (self.folds, len(at) + 1, len(at) + 1)
        fitted, judged = np.zeros(shape), np.zeros(shape)
        columns = np.append(at, self.size)
        for number, (run, samples) in enumerate(blocks):
            if not runs[run].moves[joint]:
                continue
            x = own[run][samples][:, columns]
            weighed = x * runs[run].weight[samples, joint, None]
            scaled = x / runs[run].noise[samples, joint, None]
            fitted[number % self.folds] += weighed.T @ weighed
            judged[number % self.folds] += scaled.T @ scaled
        return _Products(at, fitted, judged)

    def beside(self, base: np.ndarray, asked: np.ndarray) -> ColumnsBeside:
        """The question which of the columns `asked` stand beside the columns `base`."""
        return ColumnsBeside(self, base, asked)


class ColumnsBeside:
    """Columns that are asked beside others, which are projected out: what sets of them leave."""

    def __init__(self, data: HeldOutRows, base: np.ndarray, asked: np.ndarray):
        self.data, self.asked = data, np.asarray(asked, int)
        n, b = len(data.joints), len(base)
        columns = np.concatenate([base, self.asked, [data.size]]).astype(int)
        self._place = np.full(data.size + 1, -1)
        self._place[columns] = np.arange(len(columns))
        prior = _as_products(data.known, columns[:-1])
        whole = data.total[np.ix_(columns, columns)] + prior
        self.whole, kept = self._reduced(whole, b)
        #: What the numbers of a set cost by what is known of them, as products like the others.
        self.cost = kept.T @ prior @ kept
        self.systems, self.judged = [], []
        for fold in range(data.folds):
            system, kept = self._reduced(whole - self._of_fold(fold, len(columns)), b)
            self.systems.append(system)
            each = [self._judged(fold, joint, kept) for joint in range(n)]
            self.judged.append(each)

    def _of_fold(self, fold: int, size: int) -> np.ndarray:
        out = np.zeros((size, size))
        for products in self.data.joints:
            here = self._place[np.append(products.at, self.data.size)]
            inside = here >= 0
            own = products.fitted[fold][np.ix_(inside, inside)]
            out[np.ix_(here[inside], here[inside])] += own
        return out

    def _judged(self, fold: int, joint: int, kept: np.ndarray) -> np.ndarray:
        products = self.data.joints[joint]
        here = self._place[np.append(products.at, self.data.size)]
        inside = here >= 0
        own = products.judged[fold][np.ix_(inside, inside)]
        basis = kept[here[inside]]
        return basis.T @ own @ basis

    @staticmethod
    def _reduced(products: np.ndarray, first: int) -> tuple[np.ndarray, np.ndarray]:
        """Products of what is left of columns and target once the `first` columns are projected
        out, and the basis [p + 1 rest] that does so.
        """
        H = products[:first, :first]
        size = np.sqrt(np.maximum(np.diag(H), 0.0))
        size = np.where(size > 0, size, 1.0)
        scaled = H / size / size[:, None] + WEAK * np.eye(first)
        inside = np.linalg.solve(scaled, products[:first, first:] / size[:, None])
        rest = products.shape[0] - first
        kept = np.concatenate([-inside / size[:, None], np.eye(rest)])
        return kept.T @ products @ kept, kept

    def numbers(self, sets: np.ndarray, system: np.ndarray | None = None) -> np.ndarray:
        """Numbers [sets k] of sets of k of the asked columns, given by their indices [sets k]."""
        S = self.whole if system is None else system
        H, b = S[sets[:, :, None], sets[:, None, :]], S[sets, -1]
        size = np.sqrt(np.maximum(np.einsum("sii->si", H), 0.0))
        size = np.where(size > 0, size, 1.0)
        H = H / size[:, :, None] / size[:, None, :] + WEAK * np.eye(sets.shape[1])
        return np.linalg.solve(H, (b / size)[:, :, None])[:, :, 0] / size

    def left(self, sets: np.ndarray) -> np.ndarray:
        """Sums of squares [sets n] of each joint over all folds, each predicted from the others,
        in units of the noise.
        """
        out = np.zeros((len(sets), len(self.data.joints)))
        for system, judged in zip(self.systems, self.judged, strict=True):
            theta = self.numbers(sets, system)
            for joint, products in enumerate(judged):
                out[:, joint] += _squares(products, sets, theta)
        return out / SHARED

    def costs(self, sets: np.ndarray) -> np.ndarray:
        """How far the numbers of sets are from what is known beforehand [sets], chi-square."""
        return _squares(self.cost, sets, self.numbers(sets))

    def explained(self, sets: np.ndarray) -> np.ndarray:
        """By how much the weighed sum of squares of all that was fitted falls [sets]."""
        theta = self.numbers(sets)
        return self.whole[-1, -1] - _squares(self.whole, sets, theta)


def _squares(products: np.ndarray, sets: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """Sum of squares [sets] of what numbers theta [sets k] of the columns `sets` [sets k] leave."""
    H = products[sets[:, :, None], sets[:, None, :]]
    crossed = np.einsum("sk,sk->s", products[sets, -1], theta)
    own = np.einsum("skl,sk,sl->s", H, theta, theta)
    return np.maximum(products[-1, -1] - 2 * crossed + own, 0.0)


def _as_products(known: ColumnPrior, at: np.ndarray) -> np.ndarray:
    """What is known of the columns `at` beforehand as products of columns and target."""
    P, mean = known.information[np.ix_(at, at)], known.mean[at]
    toward = P @ mean
    return np.block([[P, toward[:, None]], [toward[None], np.array([[mean @ toward]])]])
