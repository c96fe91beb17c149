"""jaxid's own entry of the public benchmark: its check and its diagnosis within a budget of time, in
the words of the page of rules (docs/benchmark.md).
"""

from __future__ import annotations

import dataclasses
import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from jaxid.benchmark.case import CONVENTIONS, DEPENDS_ON, SIZES, VARIABLES


Answer = dict[str, Any]
#: Seconds on the clock that a case may take; what is known then is the answer.
BUDGET_S = 150.0
#: What is said where nothing is known yet: in about one case of seven nothing is missing.
BEFOREHAND: Answer = {"nothing": 0.15, "other": 0.25}
#: Probabilities, where the diagnosis gives a verdict alone; and the most that is ever said.
BY_VERDICT = {"named": 0.9, "partly": 0.6}
NOTHING = {"none": 0.9, "unknown": 0.1, "partly": 0.02, "named": 0.02}
OTHER = {"none": 0.03, "unknown": 0.7, "partly": 0.25, "named": 0.03}
MOST = 0.98
#: A finding of the check: one that it applies, and one that it asks about.
DECISIVE, ASKED = 0.95, 0.6
#: Of two effects that the recording does not tell apart, the share of the one that is named.
OF_TWO = 0.6
#: Probability from which an effect is mentioned that is not claimed.
LEAST = 0.02
#: Numbers of a robot's file that are effects of the list, and by how much of itself each may be off
#: without a gap, as the page of rules says of the sets.
NUMBERS = {
    "frictionloss": "coulomb_friction",
    "damping": "viscous_friction",
    "armature": "reflected_inertia",
}
TOLERANCE = {"arms": 0.05, "loose": 0.4}
#: By so much of itself a number has to be off, where the file is exact; how sure a number is.
EXACT, NUMBER = 0.02, 0.8


def answer(folder: Path, budget_s: float = BUDGET_S) -> Answer:
    """The answer to one case."""
    import jaxid

    began = time.monotonic()
    asked = json.loads((folder / "case.json").read_text())
    try:
        data = jaxid.load_dataset(folder)
    except jaxid.DatasetError as refusal:
        return _of_refusal(str(refusal), asked)
    model = str(folder / asked["robot"]) if "robot" in asked else None
    checked = jaxid.check(model, data)
    conventions = dict(_conventions(checked.findings, asked))
    left = max(budget_s - (time.monotonic() - began), 1.0)
    try:
        found = jaxid.diagnose(
            model,
            checked.mended or data,
            residual=asked.get("residual"),
            seconds=left,
            as_recorded=True,
        )
    except jaxid.UsageError as reason:
        print(f"{asked['case']}: {reason}", flush=True)
        return _joined({**BEFOREHAND, "missing": {}}, conventions)
    return _joined(_of_diagnosis(found, asked, data, folder), conventions)


def _of_refusal(text: str, asked: Answer) -> Answer:
    """A recording that is refused, with the convention that the refusal names."""
    joint = asked["joints"][0]
    named = [kind for kind in CONVENTIONS if kind in text]
    missing = {f"{kind}@{joint}": DECISIVE for kind in named[:1]}
    return {**BEFOREHAND, "missing": missing, "nothing": 0.02}


def _conventions(findings: Any, asked: Answer) -> Iterator[tuple[str, float]]:
    for finding in findings:
        if finding.kind in CONVENTIONS:
            sure = DECISIVE if finding.decisive else ASKED
            yield f"{finding.kind}@{_joint(finding.channel, asked)}", sure


def _joined(said: Answer, conventions: dict[str, float]) -> Answer:
    """With broken conventions: then something is wrong, and perhaps nothing else."""
    surest = max(conventions.values(), default=0.0)
    said["missing"] = said["missing"] | conventions
    said["nothing"] = said["nothing"] * (1 - surest)
    said["other"] = said["other"] * (1 - surest)
    return said


def _of_diagnosis(found: Any, asked: Answer, data: Any, folder: Path) -> Answer:
    said = found.to_dict()
    which = said["which"]
    verdict = which["verdict"]
    missing, sizes = _named(which, asked)
    if verdict == "unknown":
        missing = _possible(found, asked)
    out: Answer = {"missing": missing, "size": sizes}
    out["nothing"], out["other"] = NOTHING[verdict], OTHER[verdict]
    if verdict == "unknown":
        open_ = 1 - max(missing.values(), default=0.0)
        out["nothing"], out["other"] = out["nothing"] * open_, out["other"] * open_
    by_numbers = _told_by_numbers(found, asked)
    if verdict == "none" and by_numbers:
        out["missing"] = {name: NUMBER for name in by_numbers}
        out["size"] = by_numbers
        out["nothing"] = 1 - NUMBER
    out["where"] = depends_on(out["missing"])
    law = which["free_law"]
    if verdict == "unknown" and law is not None:
        out["where"] = _where_of(law)
    elif verdict == "unknown":
        out["where"] |= _where_it_lies(found)
    if "exam" in asked:
        out |= _exam(folder, asked, data, found)
    interval = said["how_far"]["shrinkage_interval_95"]
    if interval is not None and "exam" in out:
        out["how_far"] = sorted(float(np.clip(end, -1.0, 1.0)) for end in interval)
    return out


def _named(which: Answer, asked: Answer) -> tuple[dict[str, float], dict[str, float]]:
    """Probabilities and sizes of the effects that are named, and of what stands for each."""
    missing: dict[str, float] = {}
    sizes: dict[str, float] = {}
    mates = [(one["effect"], one["location"]) for one in which["confusable_with"]]
    for effect in which["effects"]:
        sure = effect["probability"]
        if sure is None:
            sure = BY_VERDICT.get(which["verdict"], 0.0)
            own = sure * OF_TWO if mates else sure
            instead, together = mates, sure
        else:
            own = sure
            instead, together = _family(which, effect)
        for place in effect["locations"]:
            name = f"{effect['effect']}@{_joint(place, asked)}"
            missing[name] = min(own, MOST)
            number = SIZES.get(effect["effect"], ("",))[0]
            if number in effect["parameters"]:
                sizes[name] = effect["parameters"][number]["value"]
        for name, place in instead:
            if name in DEPENDS_ON:
                share = max(together - own, 0.0) / len(instead)
                missing.setdefault(f"{name}@{_joint(place, asked)}", min(share, MOST))
    return missing, sizes


def _possible(found: Any, asked: Answer) -> dict[str, float]:
    """Probabilities of what is not sure enough to be claimed."""
    if found.which.belief is None:
        return {}
    missing: dict[str, float] = {}
    for (effect, place), p in found.which.belief.places.items():
        name = f"{effect}@{_joint(place, asked)}"
        if effect in DEPENDS_ON and p >= LEAST:
            missing[name] = max(missing.get(name, 0.0), min(p, MOST))
    return missing


def _where_it_lies(found: Any) -> dict[str, float]:
    """What the missing force is a law of, where no effect says it."""
    words: dict[str, float] = {}
    for finding in found.where:
        if finding.variable in VARIABLES:
            share = float(np.clip(finding.share_of_gap, 0.0, 1.0))
            words[finding.variable] = max(words.get(finding.variable, 0.0), share)
    return words


def _family(which: Answer, effect: Answer) -> tuple[list[tuple[str, str]], float]:
    """The other effects, with their place, that may be there instead of a named one, and the
    probability that it or one of them is.
    """
    for family in which["families"]:
        if effect["effect"] in family["effects"] and effect["location"] == family["location"]:
            names = [name for name in family["effects"] if name != effect["effect"]]
            return [(name, family["location"]) for name in names], family["probability"]
    return [], effect["probability"]


def _joint(place: str, asked: Answer) -> str:
    """The joint of a channel: its own name, what stands before _cmd or _tau, else by its place."""
    joints = asked["joints"]
    for end in ("", "_cmd", "_tau"):
        if place.endswith(end) and place.removesuffix(end) in joints:
            return place.removesuffix(end)
    for joint in joints:
        if place.endswith(joint[-5:]) or joint[-1] == place[-1]:
            return joint
    return joints[0]


def _told_by_numbers(found: Any, asked: Answer) -> dict[str, float]:
    """Numbers that are stated and are off by more than the rules say of the set, as effects with
    their size: the furthest, by its share.
    """
    allowed = TOLERANCE.get(asked["set"], EXACT)
    off: dict[str, float] = {}
    sizes: dict[str, float] = {}
    for row in found.nominal.stated:
        name = _effect_of(row, found.nominal.chain, asked)
        if not name or not row.stated:
            continue
        share = row.fitted / row.stated - 1
        spread = 2 * (row.std or np.inf) / abs(row.stated)
        if share - spread > allowed:
            off[name], sizes[name] = share, row.fitted - row.stated
    if not off:
        return {}
    furthest = max(off, key=lambda name: off[name])
    return {furthest: sizes[furthest]}


def _effect_of(row: Any, chain: Any, asked: Answer) -> str:
    """The effect at a joint that a stated number is, of a robot's file or of a model in Python; ""
    of others.
    """
    if row.parameter in NUMBERS and row.joint in asked["joints"]:
        return f"{NUMBERS[row.parameter]}@{row.joint}"
    builtin = () if chain is None else chain.mechanism.builtin
    for joint in asked["joints"]:
        for effect, names in builtin:
            own = [name.format(joint=joint) for name in names.values()]
            if row.parameter in own and effect.name in DEPENDS_ON:
                return f"{effect.name}@{joint}"
    return ""


def depends_on(missing: dict[str, float]) -> dict[str, float]:
    """Words for what the gap depends on, by the effects that are held likely."""
    words: dict[str, float] = {}
    for name, p in missing.items():
        for word in DEPENDS_ON.get(name.partition("@")[0], ())[:1]:
            words[word] = min(1.0, words.get(word, 0.0) + p)
    return words


def _where_of(law: Answer) -> dict[str, float]:
    words = [word for word in ("position", "speed", "time") if law["over"].startswith(word)]
    return dict.fromkeys(words, 0.7)


def _exam(folder: Path, asked: Answer, data: Any, found: Any) -> Answer:
    """Free runs of the amended model; none by torque, whose answer is no free run."""
    import jaxid
    from jaxid.data.experiment import Experiment

    if any(name.endswith("_tau") for name in asked["exam"]["outputs"]):
        return {}
    path = folder / "exam.csv"
    names = path.read_text().split("\n", 1)[0].split(",")
    columns = dict(zip(names, np.loadtxt(path, delimiter=",", skiprows=1).T, strict=True))
    rest = np.zeros((len(columns["t"]), len(data.outputs)))
    run = Experiment(
        name="exam",
        split="fit",
        t=columns["t"],
        u=np.column_stack([columns[c.name] for c in data.inputs]),
        y=rest,
        at_rest=True,
    )
    model = str(folder / asked["robot"]) if "robot" in asked else None
    alone = dataclasses.replace(data, experiments=(run,))
    first: Any = jaxid.simulate(model, alone, found).runs[0]
    rows = asked["exam"]["rows"]
    return {"exam": {n: np.asarray(first[n])[rows].tolist() for n in asked["exam"]["outputs"]}}
