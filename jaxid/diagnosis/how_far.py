"""How far the gap shrinks: report runs only, which were neither fitted nor chosen on."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.special import stdtrit

from jaxid.base.wording import times
from jaxid.diagnosis.breakdown import by_regime, by_run, Share
from jaxid.diagnosis.budget import shrink
from jaxid.diagnosis.evidence import held_out, HeldOut, memory
from jaxid.diagnosis.result import ChannelGap, HowFar
from jaxid.diagnosis.thresholds import LIMITS
from jaxid.fitting.problem_builder import ProblemBuilder
from jaxid.problem.binding import Binding
from jaxid.problem.residual import Residual
from jaxid.robots.match import is_robot
from jaxid.robots.yardstick import as_it_stands
from jaxid.simulation.sample_buffers import columns


#: An interval needs at least this many runs, or independent blocks of fewer runs.
BLOCKS = 8


def measure(
    bench: ProblemBuilder,
    residual: Residual,
    before: np.ndarray,
    retuned: np.ndarray,
    after: np.ndarray,
    verdict: str,
    note: str,
    alike: ProblemBuilder,
    still: Sequence[str] = (),
) -> HowFar:
    """Gaps of three parameter vectors on the report runs: as stated, re-tuned without the effect,
    with the effect; of what was compared: free runs or windows. `alike` is the bench on which all
    readings count alike, before it is known that their time stamps scatter; else `bench` itself.
    Splits that stand `still` have no gap; without any other there is none.
    """
    b = bench.binding
    splits = [s for s in ("report", "validation") if b.experiments(s) and s not in still]
    if not splits:
        nothing = float("nan")
        reason = (
            "what is kept for choosing and reporting stands still: there is no gap to measure on it"
        )
        return HowFar(
            gap_before=nothing,
            gap_retuned=nothing,
            gap_after=nothing,
            noise_floor=1.0,
            shrinkage=None,
            shrinkage_interval_95=None,
            interval_reason=reason,
            per_channel={},
            text=reason,
        )
    split = splits[0]
    stated = held_out(alike, split, [before, retuned, after], residual)
    runs = stated
    if alike is not bench:
        runs = [*stated[:2], *held_out(bench, split, [after], residual)]
    if residual.windows:
        note += (
            " Gaps are over windows of the runs, each with its own start, as models were compared."
        )
    if still:
        note += f" The {' and '.join(still)} runs stand still and tell nothing."
    gaps = [r.gap for r in runs]
    # What is left where the starts of the runs are moved within what is known.
    beyond = max(1.0, float(np.sqrt(runs[2].loss)))
    if gaps[2] > LIMITS.left and beyond < gaps[2] / 2:
        note += (
            f" Of the {gaps[2]:.3g} that are left all but {beyond:.3g} is what the starts of the"
            f" {split} runs leave open: they begin in motion, and their first samples tell only so"
            " much. Runs that begin at rest (at_rest), with a stated start (initial) or with a"
            " longer initial_window_s tell more."
        )
    if verdict == "none" and beyond > LIMITS.left:
        note += (
            f" The {split} runs are {times(gaps[2])} times the noise away all the same: they go"
            " where fit and validation runs do not, with numbers that those do not determine."
            " Fit runs that go there tell more."
        )
    text = gap_text(split, gaps, verdict)
    shrinkage = _shrinkage(runs[0], runs[2], verdict, split)
    by_runs = by_run(bench, split, [whole_runs(bench, residual, split, r) for r in runs])
    return HowFar(
        gap_before=gaps[0],
        gap_retuned=gaps[1],
        gap_after=gaps[2],
        noise_floor=1.0,
        shrinkage=shrinkage.share,
        shrinkage_interval_95=shrinkage.interval,
        interval_reason=shrinkage.reason,
        per_channel=_per_channel(b, stated, split, alike_noise=alike is bench),
        text=f"{text}. {note}".strip(),
        per_run=by_runs,
        per_regime=by_regime(bench, split, runs),
        interval_from=shrinkage.made_of,
        split=split,
    )


def _per_channel(
    b: Binding, models: Sequence[HeldOut], split: str, alike_noise: bool
) -> dict[str, ChannelGap]:
    """Output channel -> what the three models leave in it, in its unit, and its noise: the same at
    all readings (`alike_noise`), or their own.
    """
    _, iy = columns(b.dataset, b.chain)
    floors = b.sigma
    if not alike_noise:
        each = np.stack([e.noise_rms(b.sigma, iy) for e in b.experiments(split)])
        floors = np.sqrt(np.mean(each**2, 0))
    out = {}
    for c, (name, unit) in enumerate(b.chain.signature.outputs):
        rmse = []
        for model in models:
            left = np.concatenate([r[:, c] for r in model.residual])
            rmse.append(float(b.sigma[c]) * float(np.sqrt(np.mean(left**2))))
        before, retuned, after = rmse
        out[name] = ChannelGap(unit, before, retuned, after, float(floors[c]), b.noise[name].source)
    return out


class _Shrinkage(NamedTuple):
    """By which share the gap shrinks, its interval in a further run and of what that is made, or
    the reason why there is none.
    """

    share: float | None = None
    interval: tuple[float, float] | None = None
    made_of: str = ""
    reason: str = ""


def _shrinkage(before: HeldOut, after: HeldOut, verdict: str, split: str) -> _Shrinkage:
    share, reason = share_of_gap(before.gap, after.gap, verdict, split, "on report data ")
    if share is None:
        return _Shrinkage(reason=reason)
    interval, made_of, reason = interval_of_further_run(before, after)
    if interval is not None:
        interval = interval[0], min(interval[1], 1.0)
    return _Shrinkage(share, interval, made_of, reason)


def share_of_gap(
    before: float, after: float, verdict: str, split: str, where: str = ""
) -> tuple[float | None, str]:
    """By which share a gap shrinks; or None, and the reason why that is not said."""
    if verdict == "none":
        return None, "the verdict is none: there is no gap to shrink"
    unknown = not_measured(before, after)
    if unknown is not None:
        return None, unknown
    if before <= 1.0:
        return None, f"the gap was at the noise floor {where}before any effect was added"
    exact = shrink(before**2, after**2)
    if exact < 0:
        return None, f"on {split} data the gap does not shrink"
    return min(exact, 1.0), ""


def gap_text(split: str, gaps: Sequence[float], verdict: str) -> str:
    """The gaps of a model as stated, re-tuned, and with the effects that a verdict names."""
    before, retuned, after = map(times, gaps)
    text = (
        f"gap on {split} data: {before} times the noise before, {retuned} after re-tuning the old"
        " parameters alone"
    )
    if verdict in ("named", "partly"):
        text += f", {after} with the effects added"
    return text


def model_before(binding: Binding, retuned: np.ndarray) -> tuple[np.ndarray, str]:
    """The model before anything was fitted: a robot's file as it stands; of other models the values
    that the dataset states, and what it does not state re-tuned.
    """
    if is_robot(binding.chain.mechanism):
        theta, what = as_it_stands(binding)
        return theta, f"Before is {what}."
    theta = retuned.copy()
    stated = [i for i in binding.free if i in binding.stated]
    if not stated:
        note = "The dataset states no parameter values, so the gap before is that of the re-tuned"
        return theta, f"{note} model."
    theta[stated] = binding.theta[stated]
    return theta, ""


def whole_runs(bench: ProblemBuilder, residual: Residual, split: str, held: HeldOut) -> HeldOut:
    """What is held out window by window, run by run."""
    if not residual.windows:
        return held
    runs = bench.runs(residual, split)
    of = [runs.record(number).experiment for number in runs.records]
    if len(of) != len(held.residual):
        return held
    by_run: dict[int, list[np.ndarray]] = {number: [] for number in sorted(set(of))}
    for number, part in zip(of, held.residual, strict=True):
        by_run[number].append(part)
    return replace(held, residual=[np.concatenate(own) for own in by_run.values()])


def parts(
    bench: ProblemBuilder, residual: Residual, split: str, held: HeldOut
) -> tuple[tuple[Share, ...], tuple[Share, ...]]:
    """Gaps of one model run by run and regime by regime after the own uncertainty of starts and
    numbers is taken out.
    """
    settled = replace(held, residual=held.settled)
    whole = whole_runs(bench, residual, split, settled)
    return by_run(bench, split, [whole] * 3), by_regime(bench, split, [settled] * 3)


def not_measured(*gaps: float) -> str | None:
    """Why nothing is said of gaps that are no numbers; None where all are."""
    if all(map(math.isfinite, gaps)):
        return None
    if any(map(math.isnan, gaps)):
        return "no sample of these data could be compared"
    return "a simulation does not stay finite, so that its gap has no size"


def interval_of_further_run(
    before: HeldOut, after: HeldOut
) -> tuple[tuple[float, float] | None, str, str]:
    """95 % interval of the shrinkage in a further run like the report runs; what it is made of; or
    the reason why there is none.

    Student's prediction interval. Eight runs or more are its samples: now and then a run goes where
    errors grow a thousandfold, which shows between runs and not within one, so shares left are
    taken as the inverse hyperbolic sine, whose linear part is what noise alone scatters. Of fewer
    runs it is blocks of what each sample moves the share by (its influence); a free run drifts, its
    error is one slow curve, so they are twice as long as the memory of that and of the residual
    with the effect. What the model had left before may be slower than both: where nothing of it is
    left that says no more than how much a further run's gap may be smaller, by which the interval
    widens (a logarithmic normal of as much scatter).
    """
    if len(after.residual) >= BLOCKS:

        def squares(held):
            return np.array([np.mean(r**2) for r in held.residual])

        return _from_runs(squares(before), squares(after), after.count), "runs", ""

    def above(held):
        return [np.mean(r**2, axis=1, keepdims=True) - 1 for r in held.residual]

    a, b = above(before), above(after)
    every = np.concatenate(a)
    gap = max(float(np.mean(every)), 1e-9)
    left = float(np.mean(np.concatenate(b))) / gap
    own = [(y - left * x) / gap for x, y in zip(a, b, strict=True)]
    length = 2 * max(memory(own), memory(after.residual))
    means = []
    for x in own:
        whole = len(x) // length * length
        means += [np.mean(block) for block in x[:whole].reshape(-1, length)]
    blocks = np.array(means)
    n = len(blocks)
    if n < BLOCKS:
        reason = (
            f"no interval: residuals remember themselves for {length // 2} samples, so the report"
            f" data hold only {n} independent {'block' if n == 1 else 'blocks'} and {BLOCKS} are"
            " needed"
        )
        return None, "", reason
    # A further run's mean about the mean of these: its variance, by that of a sample.
    further = (len(a) + 1) / len(every)
    smaller = float(np.var(every)) / gap**2 * memory(a) * further
    reach = (
        float(stdtrit(n - 1, 0.975) * np.sqrt((len(own) + 1) / n) * blocks.std(ddof=1))
        * (1 + smaller) ** 1.5
    )
    return (1 - left - reach, 1 - left + reach), "blocks", ""


def _from_runs(before: np.ndarray, after: np.ndarray, samples: int) -> tuple[float, float]:
    """From mean squares of runs, of this many samples together."""
    n = len(after)
    scatter = np.sqrt(2 * n / samples)
    gap = np.maximum(before - 1, scatter)
    scale = scatter / np.median(gap)
    left = np.arcsinh((after - 1) / gap / scale)
    reach = stdtrit(n - 1, 0.975) * np.sqrt(1 + 1 / n) * left.std(ddof=1)
    low, high = np.sinh(np.clip([left.mean() - reach, left.mean() + reach], -300.0, 300.0)) * scale
    return float(1 - high), float(1 - low)
