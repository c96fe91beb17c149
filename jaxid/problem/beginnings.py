"""By which of its samples it is told how a run begins."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from jaxid.data.dataset import Experiment
from jaxid.simulation.sample_buffers import Record


#: A part of a longer run starts so long before it, and by this many samples at most.
RUN_UP_S, RUN_UP_SAMPLES = 1.0, 500
#: Stretches of a run are these shares of the longest one.
NESTED = (1, 2, 4, 8, 16)
#: Those of a run that touches: where it next touches depends on how well its first moments are
#: followed.
TOUCHING = (*NESTED, 32, 64)


def run_up(e: Experiment) -> int:
    """The sample of an experiment with its past (`whole`) at which its free run begins."""
    t, cut = e.whole.t, len(e.whole) - len(e)
    return max(cut // 2, cut - RUN_UP_SAMPLES, int(np.searchsorted(t, t[cut] - RUN_UP_S)))


def head_samples(e: Experiment) -> int:
    """How many samples a run that is not fitted may use to estimate its start: 20, and at least 0.1
    s, or as stated; of a short run a third at most, so that the rest can be judged.
    """
    if e.initial_window_s is not None:
        return max(4, int(np.searchsorted(e.t, e.t[0] + e.initial_window_s, side="right")))
    return min(
        max(4, len(e.t) // 3), max(20, int(np.searchsorted(e.t, e.t[0] + 0.1 - 1e-9, side="left")))
    )


def standing(e: Experiment) -> int:
    """The sample at which the last of the readings that stand on one value over the first moments
    of a run takes its first step, 0 where none does. A joint at rest anywhere within an encoder's
    step reads the same, however often: only the steps that follow say where it stands.
    """
    n = head_samples(e)
    moved = e.y != e.y[0]
    still = moved.any(0) & ~moved[:n].any(0)
    first = (
        int(np.argmax(moved[:, still], axis=0).max())
        if e.initial_window_s is None and still.any()
        else 0
    )
    return first if first + n <= len(e.t) // 3 else 0


def nested_heads(
    e: Experiment, own: Experiment, part: Callable[[int, int, int], Record], touches: bool
) -> list[Record]:
    """Nested first stretches of a run (`own`, of the whole run `e`), the longest first; of one that
    begins standing still also the stretches as it begins to move. Of a run that `touches` the
    longest is all of it: where it touches depends on how it began.
    """
    cut, begin = len(e) - len(own), run_up(own)
    if touches:
        return [part(begin, cut + max(6, len(own) // k), cut) for k in TOUCHING]
    # by then sensors and springs have forgotten how they began
    settled = begin + (cut - begin) // 4
    n = cut + head_samples(own) - settled
    lengths = tuple(dict.fromkeys(max(6, n // k) for k in NESTED))
    heads = [part(begin, settled + k, settled) for k in lengths]
    # what stands still counts as one sample, unless the model moves otherwise
    still = 0 if cut else standing(e)
    if not still:
        return heads
    return [part(begin, still + k, still - 1) for k in lengths] + heads
