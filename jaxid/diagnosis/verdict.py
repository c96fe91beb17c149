"""What is claimed: by fit and validation data, and only as far as it holds on the report data too.

One principle: a verdict is a sentence about every set of data. `named` and `partly` say that with the effects the model comes
nearer to the data than without them, as stated or re-tuned; `none` says that it is at the noise. Fit and validation data choose;
the report data, which choose nothing, withdraw what does not hold on them. A wrong name costs a user more than an honest
`unknown`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from jaxid.diagnosis import how_far as shrinking
from jaxid.diagnosis.breakdown import Share
from jaxid.diagnosis.hypothesis import Hypothesis, Search
from jaxid.diagnosis.thresholds import LIMITS
from jaxid.errors import UsageError
from jaxid.fitting.scores import scored
from jaxid.problem.binding import Binding
from jaxid.simulation.sample_buffers import columns
from jaxid.wording import listed, percent, times


class Diverged(UsageError):
    """No free run of the nominal model stays finite; `by_torque` says whether it can be compared without one."""

    def __init__(self, message: str, by_torque: bool):
        super().__init__(message)
        self.by_torque = by_torque


def judge(search: Search) -> tuple[str, str]:
    """Verdict by fit and validation data, and its sentence."""
    nominal, chosen = search.nominal.validation, search.chosen.validation
    floor = level(nominal.count)
    if not search.chosen.effects:
        if nominal.loss <= floor and search.nominal.fit_loss <= level(search.nominal.path.count):
            return "none", "The model reaches the noise floor on data that were not fitted: there is no gap."
        gap = np.sqrt(max(nominal.loss, search.nominal.fit_loss))
        return (
            "unknown",
            f"There is a gap ({times(gap)} times the noise), and no effect of the library explains it.{closest(search)}",
        )
    closed = shrinking.closed(nominal.loss, chosen.loss)
    names = " and ".join(str(c) for c in search.chosen.effects)
    left = np.sqrt(max(chosen.loss, 1.0))
    each = ", ".join(f"without {c} {times(gap)}" for c, gap in search.without)
    each = f" What each contributes: {each} times the noise." if each else ""
    # Several that leave more than the noise may together only come close to something else.
    close = search.several and max(left, np.sqrt(search.chosen.fit_loss)) > LIMITS.left
    followed = shrinking.closed(search.nominal.fit_loss, search.chosen.fit_loss)
    closed_on_both = closed >= LIMITS.named and (followed >= LIMITS.named or search.chosen.fit_loss <= LIMITS.left**2)
    if chosen.loss <= max(floor, 1.1) or (closed_on_both and not close):
        return "named", f"The model lacks {names}; with it {times(left)} times the noise is left on validation data.{each}"
    if closed >= LIMITS.partly:
        return "partly", (
            f"The model lacks {names}, which explains {np.floor(100 * closed):.0f} % of the gap on validation data; a clear "
            f"remainder ({times(left)} times the noise) stays unexplained.{each}"
        )
    if search.chosen.fit_loss <= 1.1 < search.nominal.fit_loss:
        return "partly", (
            f"The model lacks {names}: with it the fit runs are followed down to the noise. The validation runs go where the fit "
            f"runs do not: there {percent(closed)} of the gap is explained and {times(left)} times the noise is left."
        )
    return "unknown", (
        f"No effect explains most of the gap: {names} explains {percent(closed)} of it on validation data and leaves "
        f"{times(left)} times the noise.{closest(search)}"
    )


def level(count: int) -> float:
    """Mean square up to which residuals are noise: what chance makes of it, and how well the noise itself is known."""
    return 1 + 4 * np.sqrt(2 / max(1, count)) + 0.06


def closest(search: Search) -> str:
    """What comes nearest to the validation data where it is not what was chosen, as the ranking shows it."""
    tried = [h for h in search.tried if h.effects and np.isfinite(h.validation.loss) and np.isfinite(h.fit_loss)]
    top: Hypothesis | None = min(tried, key=lambda h: h.validation.loss, default=None)
    if top is None or top.validation.loss >= min(search.chosen.validation.loss, search.nominal.validation.loss):
        return ""
    share = shrinking.closed(search.nominal.validation.loss, top.validation.loss)
    return (
        f" On validation data alone {' and '.join(str(c) for c in top.effects)} closes {percent(share)} of it; fit and "
        "validation data together do not bear that out."
    )


def upheld(
    verdict: str, text: str, retuned: float, after: float, several: bool = False, before: float = np.inf
) -> tuple[str, str]:
    """A verdict and its sentence once the report data have been seen, where the model re-tuned, the one with the effects
    (`several` of them) and the one as stated leave so many times the noise."""
    room = retuned**2 > LIMITS.alike  # beyond what is known of the noise
    without = min(retuned, before)
    closed = shrinking.closed(retuned**2, after**2)
    if retuned <= LIMITS.seen and (after < retuned or not (room or after**2 > LIMITS.alike * retuned**2)):
        if verdict == "named" and room and closed < LIMITS.partly:
            return "unknown", (
                f"{text.replace('The model lacks', 'Nearest comes', 1)} On the report data {times(after)} times the noise is "
                f"left with it, {times(retuned)} without: that is not most of what little there is, so it is not claimed."
            )
        return verdict, text
    if after >= without:
        stated = f", {times(before)} as it was stated" if before < np.inf and times(before) != times(retuned) else ""
        return "unknown", (
            f"{text} On the report data that model is {times(after)} times the noise away, {times(retuned)} without{stated}: it "
            "is not claimed."
        )
    if verdict == "named" and several and after > LIMITS.left:
        return "partly", f"{text} On the report data {times(after)} times the noise is left."
    if verdict == "named" and (closed < LIMITS.partly or (closed < LIMITS.named and after > LIMITS.left)):
        return "partly", f"{text} On the report data it explains {percent(closed)} of the gap."
    return verdict, text


def astray(runs: Sequence[Share], regimes: Sequence[Share], whole: float) -> list[tuple[str, float]]:
    """Where the re-tuned model is not near the noise on report data, worst first: (run, or direction of a joint, times the
    noise); `whole` is what all of them leave."""
    found = [(s.part, s.retuned) for s in runs]
    found += [(f"{s.joint} moving {s.part}s", s.retuned) for s in regimes if s.part in ("forward", "backward")]
    found = found or [("all report runs", whole)]
    return sorted(
        (place for place in found if not place[1] <= LIMITS.left), key=lambda place: -np.nan_to_num(place[1], nan=np.inf)
    )


def not_reached(places: Sequence[tuple[str, float]], gap: float) -> str:
    """Why a model that follows fit and validation data down to the noise is not said to lack nothing."""
    where = listed(f"{times(left)} times the noise in {name}" for name, left in places[:3])
    worst = f": beyond that it leaves {where}" if where else ""
    return (
        "The model follows fit and validation data down to the noise, but not the report data: re-tuned it is "
        f"{times(gap)} times the noise away there, and what the fit leaves open of its numbers does not account for it{worst}. "
        "What is missing does not show in the data that were fitted."
    )


def standing_still(binding: Binding) -> tuple[str, ...]:
    """Of "validation" and "report" those splits in which no run moves and no input changes: every model predicts them."""
    iu, iy = columns(binding.dataset, binding.chain)
    out = []
    for split in ("validation", "report"):
        runs = binding.experiments(split)
        moves = False
        for e in runs:
            keep = scored(e, split)
            moves |= bool(np.any(np.std(e.y[keep][:, iy], axis=0) > LIMITS.still * binding.sigma)) or _changes(e.u[keep][:, iu])
        if runs and not moves:
            out.append(split)
    return tuple(out)


def _changes(u: np.ndarray) -> bool:
    """Whether any input [time inputs] does more than scatter from sample to sample."""
    if len(u) < 2:
        return False
    return bool(
        np.any(np.std(u, axis=0) > LIMITS.still * np.std(np.diff(u, axis=0), axis=0) / np.sqrt(2) + 1e-12 * np.abs(u).max(0))
    )


def withheld(still: Sequence[str]) -> str:
    """The sentence of a verdict that is not given."""
    kept = "choosing and reporting stand" if "report" in still else "choosing stand"
    return (
        f"The data kept for {kept} still: any model predicts them, so that nothing can be judged on them, neither whether there "
        "is a gap nor what would close it."
    )
