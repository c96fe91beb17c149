"""Recordings whose conventions are broken: 15 kinds on three models, with and without an effect
that the model lacks as well.

    python benchmarks/conventions.py [--seed N] [--simulate] [--diagnose MODEL,...]

The motion is a multisine; the torque that it takes is worked out by the equations of
`jaxid.benchmark`, so no simulation and no line of the product makes the data. Prints what
`jaxid.check` finds: of each kind the finding, its size, and what else was claimed. With --simulate
the findings are confirmed by simulation, as the command does; with --diagnose each recording of
these models is diagnosed, and counted is where an effect is named that only stands in for what is
broken.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np


sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from jaxid.base.errors import DatasetError  # noqa: E402
from jaxid.benchmark.broken import broken, KINDS, MODELS, recording, SoundRecording  # noqa: E402
from jaxid.benchmark.plants import PLANTS, TwinPlant  # noqa: E402


def found(r: SoundRecording, simulate: bool = False) -> list[Any]:
    """What the check says of a recording."""
    from jaxid.conventions import checking, runs
    from jaxid.fitters.short_fit import left_by_short_fit

    try:
        data = r.dataset()
    except DatasetError as error:
        return runs.refused(error)
    return list(
        checking.run_check(
            r.plant.model, data, gap=left_by_short_fit if simulate else None
        ).findings
    )


#: Faults of a clock or of rows that all inputs share, and of a start that all outputs do: found at
#: any of them.
SHARED = {"row_shift": "input", "clock": "input", "not_at_rest": "output"}


def right(finding: Any, kind: str, channel: str, plant: TwinPlant) -> bool:
    """Whether a finding says what was broken."""
    ports = {"input": plant.inputs, "output": plant.outputs}.get(SHARED.get(kind, ""), ())
    at = {channel, *(n for n, _ in ports)}
    return finding.kind == kind and bool(at & {finding.channel, *(c for _, c in finding.same_as)})


#: What a diagnosis is asked for: the usual stand-ins of signs, zeros and units. And what it may
#: name beside the drag of a recording that has it: the effect that is what the finding says.
FEW = ("spring_torque", "torque_ripple", "quadratic_drag")
MEANT = {"saturated": {"saturation"}, "filtered": {"sensor_lag", "sensor_delay"}}


def stand_ins(
    r: SoundRecording, kind: str, effect: str, effects: Sequence[str] | None = FEW
) -> tuple[str, list[str]]:
    """The verdict of a diagnosis (of these effects, else the library), and what is named in place
    of the broken convention.
    """
    import jaxid

    try:
        d = jaxid.diagnose(None, r.dataset(), effects=effects)
    except (DatasetError, jaxid.UsageError) as error:
        return f"refused: {str(error).splitlines()[0][:60]}", []
    meant = MEANT.get(kind, set()) | ({"quadratic_drag"} if effect else set())
    named = [f"{e.effect}@{e.location}" for e in d.which.effects]
    wrong = [n for n in named if d.which.verdict == "named" and n.split("@")[0] not in meant]
    return f"{d.which.verdict} {' '.join(named)}".strip(), wrong


#: The seed of the kept result: taken once, for it alone.
FRESH = 88118


def main(
    seed: int = FRESH, simulate: bool = False, diagnose: Sequence[str] = ("pendulum",)
) -> dict[str, Any]:
    """Of each model how many were found, where they were not or something else was claimed, and
    what diagnoses named instead.
    """
    rows = []
    for model in MODELS:
        kept = ("found", "missed", "something else claimed", "diagnosed", "stands in")
        counted: dict[str, list[str]] = {k: [] for k in kept}
        for kind in KINDS:
            if kind == "swapped_channels" and PLANTS[model].n == 1:
                continue
            for effect in ("", "drag"):
                rng = np.random.default_rng([seed, KINDS.index(kind), len(model)])
                r, channel, value = broken(kind, recording(model, seed, effect), rng)
                findings = found(r, simulate)
                own = [f for f in findings if right(f, kind, channel, r.plant)]
                rest = [f for f in findings if f not in own and f.decisive]
                counted["found" if own else "missed"].append(kind)
                counted["something else claimed"] += [
                    f"{f.kind} of {f.channel}, where {kind} is broken" for f in rest
                ]
                size = (
                    ""
                    if not own
                    else f"{own[0].value} (true {value}) {'decisive' if own[0].decisive else 'question'}"
                )
                print(
                    f"{model:11} {kind:17} {effect or '-':5} {'found' if own else 'MISSED':6} {size}",
                    end="",
                )
                print(
                    "".join(f"  ALSO {f.kind} of {f.channel} {f.value}" for f in rest), flush=True
                )
                if model in diagnose:
                    verdict, wrong = stand_ins(r, kind, effect)
                    counted["diagnosed"].append(kind)
                    counted["stands in"] += [f"{', '.join(wrong)} for {kind}"] if wrong else []
                    print(
                        f"{'':18} diagnosed: {verdict}{'  STANDS IN' if wrong else ''}", flush=True
                    )
        hits, count = len(counted["found"]), len(counted["found"]) + len(counted["missed"])

        def listed(key, own=counted):
            return ", ".join(dict.fromkeys(own[key])) or "-"

        asked = len(counted["diagnosed"])
        rows.append(
            {"model": model, "found": f"{hits} of {count}"}
            | {k: listed(k) for k in ("missed", "something else claimed")}
            | {
                "an effect named in its place": f"{len(counted['stands in'])} of {asked}"
                if asked
                else "not asked"
            }
        )
    text = (
        "Recordings with one convention broken, 15 kinds on three models, with and without a drag that the model lacks; seed "
        f"{seed}, run once. What all inputs or outputs share (a clock, a row, a start in motion) is found at any of them."
    )
    if any(diagnose):
        text += " Recordings are diagnosed too, among a few effects: one that is named in place of what is broken is wrong."
    return {"title": "Broken conventions", "text": text, "rows": rows}


if __name__ == "__main__":
    from jaxid import runtime

    runtime.prepare()
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=5)
    parser.add_argument("--simulate", action="store_true")
    parser.add_argument("--diagnose", default="")
    arguments = parser.parse_args()
    print(
        *main(arguments.seed, arguments.simulate, arguments.diagnose.split(","))["rows"], sep="\n"
    )
