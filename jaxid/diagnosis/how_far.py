"""How far the gap shrinks: report runs only, which were neither fitted nor chosen on."""

from __future__ import annotations

import numpy as np

from jaxid.diagnosis.breakdown import by_regime, by_run
from jaxid.diagnosis.evidence import held_out, HeldOut, memory
from jaxid.estimation import Bench
from jaxid.residual import InverseDynamics, Residual
from jaxid.results import ChannelGap, HowFar
from jaxid.samples import columns


#: An interval needs at least this many independent blocks.
BLOCKS = 8
DRAWS = 2000
#: A model without a gap on fit and validation data is told of one this large (in multiples of the noise) on report data.
UNSEEN = 1.5


def measure(
    bench: Bench,
    residual: Residual,
    before: np.ndarray,
    retuned: np.ndarray,
    after: np.ndarray,
    verdict: str,
    seed: int,
    note: str,
    alike: Bench,
) -> HowFar:
    """Gaps of three parameter vectors on the report runs: as stated, re-tuned without the effect, with the effect; of the free
    run, or of the torque where that is what was compared. `alike` is the bench on which all readings count alike, before it is
    known that their time stamps scatter; else `bench` itself."""
    b = bench.binding
    split = "report" if b.experiments("report") else "validation"
    by_torque = isinstance(residual, InverseDynamics)
    stated = held_out(alike, split, [before, retuned, after], residual if by_torque else None)
    runs = stated if alike is bench else [*stated[:2], *held_out(bench, split, [after])]
    gaps = [r.gap for r in runs]
    per_channel = {}
    compared = bench.runs(residual, split) if by_torque else None
    rms = lambda parts: float(np.sqrt(np.mean(np.concatenate(parts) ** 2)))
    _, iy = columns(b.dataset, b.chain)
    for c, (name, unit) in enumerate(compared.channels if compared else b.chain.signature.outputs):
        sigma = float(compared.noise[c] if compared else b.sigma[c])
        rmse = [sigma * rms([r[:, c] for r in run.residual]) for run in stated]
        source = "scatter of neighbouring samples" if compared else b.noise[name].source
        floor = sigma if alike is bench else rms([e.noise(b.sigma, iy)[:, c] for e in b.experiments(split)])
        per_channel[name] = ChannelGap(unit, rmse[0], rmse[1], rmse[2], floor, source)
    shrinkage = interval = None
    reason = ""
    if verdict == "none":
        reason = "the verdict is none: there is no gap to shrink"
        if gaps[2] > UNSEEN:
            note += (
                f" The {split} runs are {gaps[2]:.3g} times the noise away all the same: they go where fit and validation runs "
                "do not, with numbers that those do not determine. Fit runs that go there tell more."
            )
    elif gaps[0] <= 1.0:
        reason = "the gap was at the noise floor on report data before any effect was added"
    else:
        shrinkage = shrink(gaps[0] ** 2, gaps[2] ** 2)
        interval, reason = bootstrap(runs[0], runs[2], seed)
    text = (
        f"gap on {split} data: {gaps[0]:.3g} times the noise before, {gaps[1]:.3g} after re-tuning the old parameters alone, "
        f"{gaps[2]:.3g} with the effects added"
    )
    return HowFar(
        gaps[0], gaps[1], gaps[2], 1.0, shrinkage, interval, reason, per_channel, f"{text}. {note}".strip(),
        by_run(bench, split, runs), by_regime(bench, split, runs),
    )  # fmt: skip


def shrink(before: float, after: float) -> float:
    """Share of the gap that is closed; arguments are mean squares in units of the noise."""
    return 1 - (after - 1) / (before - 1)


def bootstrap(before: HeldOut, after: HeldOut, seed: int) -> tuple[tuple[float, float] | None, str]:
    """95 % interval of the shrinkage from resampled blocks of the report runs, or the reason why there is none.

    A free run drifts: its error is one slow curve, so blocks are as long as the residual's memory (the longer of both).
    """
    length = 2 * max(memory(before.residual), memory(after.residual))
    pairs = []
    for a, b in zip(before.residual, after.residual, strict=True):
        for k in range(0, len(a) - length + 1, length):
            pairs.append((np.sum(a[k : k + length] ** 2), np.sum(b[k : k + length] ** 2), a[k : k + length].size))
    if len(pairs) < BLOCKS:
        return None, (
            f"no interval: residuals remember themselves for {length // 2} samples, so the report data hold only "
            f"{len(pairs)} independent blocks and {BLOCKS} are needed"
        )
    table = np.array(pairs)
    draw = np.random.default_rng(seed).integers(0, len(table), (DRAWS, len(table)))
    s = table[draw].sum(1)
    first, last = s[:, 0] / s[:, 2], s[:, 1] / s[:, 2]
    values = shrink(np.maximum(first, 1 + 1e-9), last)
    low, high = np.percentile(values, [2.5, 97.5])
    return (float(low), float(high)), ""
