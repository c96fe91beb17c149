"""Makes docs/_static/gap.svg, the picture of the README, from the shipped example:

    python docs/make_picture.py

The same bytes come out for the same example and code; run it again when either changes.
"""

from __future__ import annotations

from pathlib import Path

from jaxid.runtime import prepare  # noqa: E402


prepare()

import numpy as np  # noqa: E402

import jaxid  # noqa: E402
from jaxid.base import wording  # noqa: E402
from jaxid.report import plot  # noqa: E402
from jaxid.report.budget_picture import draw_gap  # noqa: E402


ROOT = Path(__file__).resolve().parents[1]
#: The candidates of the picture; the whole library (`make demo`) names the same one.
CANDIDATES = ("dead_zone", "input_delay", "stribeck_friction", "quadratic_drag")


def picture(diagnosis: jaxid.Diagnosis) -> str:
    (named,) = diagnosis.which.effects
    trace = next(t for t in diagnosis.traces if t.split == "report")
    before, after = list(trace.simulated)[0], list(trace.simulated)[-1]

    def draw(figure):
        left, right = figure.subplots(1, 2, width_ratios=[3, 2])
        left.plot(
            *plot.thin(trace.t, trace.measured, 600), color=plot.BLACK, lw=2.6, label="measured"
        )
        left.plot(
            *plot.thin(trace.t, trace.simulated[before], 600),
            color=plot.VERMILLION,
            lw=1.3,
            label="nominal model",
        )
        left.plot(
            *plot.thin(trace.t, trace.simulated[after], 600), color=plot.SKY, lw=1.2, ls=(0, (4, 2)),
            label=f"with {named.effect.replace('_', ' ')}",
        )  # fmt: skip
        left.set(
            xlabel="time in a recording that was never fitted (s)",
            ylabel=plot.with_unit(trace.channel, trace.unit),
        )
        left.margins(x=0)
        left.legend(
            loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, fontsize=8.5, borderaxespad=0.2
        )
        draw_gap(right, diagnosis)
        closed = wording.percent(diagnosis.how_far.shrinkage)
        right.set_title(f"{closed} of the gap closed", fontsize=9, loc="left")
        right.set_xlabel("gap, multiples of the noise (logarithmic)")

    return plot.element("readme", (9.2, 2.7), draw)


if __name__ == "__main__":
    diagnosis = jaxid.diagnose(
        None, jaxid.load_dataset(ROOT / "examples" / "servo_pendulum"), effects=CANDIDATES
    )
    assert np.isfinite(diagnosis.how_far.gap_after)
    (ROOT / "docs" / "_static" / "gap.svg").write_text(picture(diagnosis), encoding="utf-8")
