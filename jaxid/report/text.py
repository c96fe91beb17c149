"""Results in words: the numbers, sentences and tables that the terminal and the report share."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, TYPE_CHECKING

from jaxid.base.wording import (
    CLOSE,
    listed,
    number,
    one_line,
    paragraph,
    percent,
    regime_words,
    short,
    table,
    times,
    unit_after,
    value_with_std,
    wrapped,
)
from jaxid.conventions.finding import data_lines
from jaxid.diagnosis.alike import alike
from jaxid.diagnosis.reasons import WithinAStep
from jaxid.report.budget_text import budget_sentence
from jaxid.report.effect_text import alike_words, effect_name, lacks, meaning
from jaxid.report.other_numbers import first_of_all
from jaxid.report.posterior_text import posterior_lines
from jaxid.robots.contacts import NOT_SIMULATED


if TYPE_CHECKING:
    from jaxid.diagnosis.result import Diagnosis, Finding, HowFar, Which
    from jaxid.fitting.result import EffectEstimate, Estimate, Fit
    from jaxid.fitting.simulation import Simulation
    from jaxid.fitting.stated import StatedNumber
    from jaxid.identification.result import Identification


def remark(estimate: Estimate) -> str:
    """What has to be said about a fitted parameter beyond its number, or nothing."""
    if not estimate.identifiable:
        return "not determined by these data"
    if estimate.at_bound:
        return "at its bound"
    return ""


def where_sentence(finding: Finding) -> str:
    """The finding's own sentence, or one made from its numbers."""
    if finding.text:
        return one_line(finding.text)
    start, end = finding.window_s
    return (
        f"At {one_line(finding.location)} during {regime_words(finding.regime)} (seen in"
        f" {one_line(finding.channel)}, strongest from {short(start)} to {short(end)} s):"
        f" {percent(finding.share_of_gap)} of the gap, {times(finding.times_noise_floor)} times the"
        " noise."
    )


#: This many stated numbers are listed.
STATED = 6
#: Up to this many times the noise a gap is near it.
NEAR = 1.5


def measured(how_far: HowFar) -> bool:
    """Whether there is anything on which a gap could be measured."""
    return math.isfinite(how_far.gap_retuned) or not math.isnan(how_far.gap_before)


def stated_sentences(
    stated: Sequence[StatedNumber], named: Sequence[EffectEstimate] = ()
) -> list[str]:
    """Numbers that were stated and that the data refute, worst first: each in a sentence, or all in
    one where they are many. One that is told as an effect that is missing is not told again.
    """
    told: set[tuple[str, float]] = set()
    for e in named:
        told |= {(e.location, p.value) for p in e.parameters.values()}
    refuted = [s for s in stated if s.refuted and (s.joint, s.fitted) not in told]
    refuted.sort(key=lambda s: -abs(s.deviation or 0.0))
    if len(refuted) <= 2:
        return [sentence(s.text) for s in refuted]
    every = [s.parameter for s in stated]
    shown = [_stated_beside_found(s, every) for s in refuted[:STATED]]
    more = f", and {len(refuted) - STATED} more" if len(refuted) > STATED else ""
    off = dict.fromkeys(number(abs(s.deviation or 0.0), 2) for s in (refuted[-1], refuted[0]))
    return [
        f"{len(refuted)} of {len(stated)} numbers that you stated are not those of the data:"
        f" {', '.join(shown)}{more} ({' to '.join(off)} standard deviations off)."
    ]


def _stated_beside_found(s: StatedNumber, every: Sequence[str]) -> str:
    """`armature of elbow_flex 0.1 → 0.2 kg m^2`; `every`: the names of all stated numbers."""
    name = s.parameter
    # "armature of elbow_flex", but not "kp / inertia"
    if " " not in name and (s.link or every.count(name) > 1):
        name = s.text.partition(":")[0]
    best = s.fitted if s.beside is None else s.beside
    unit = unit_after(s.unit)
    return f"{one_line(name)} {number(s.stated)} → {number(best, 4)}{unit}"


#: This many groups of numbers are listed.
GROUPS = 6


def together(fit: Fit) -> str:
    """Numbers that the data determine only together, group by group; empty where there are none."""
    groups: dict[str, None] = {}
    for group in fit.correlated:
        own = [name for name in group if not name.startswith("start of ")]
        if len(own) > 1:
            groups[one_line(", ".join(own))] = None
    if not groups:
        return ""
    shown = "; ".join(list(groups)[:GROUPS])
    more = f"; and {len(groups) - GROUPS} more groups" if len(groups) > GROUPS else ""
    return f"The data determine only together, not one by one: {shown}{more}"


def which_sentence(which: Which, how_far: HowFar | None = None) -> str:
    """The verdict in plain words."""
    if how_far is not None and not measured(how_far):
        return which.text or "Nothing can be judged: the data kept for it stand still."
    if which.verdict in ("named", "partly"):
        return lacks(which, lambda effects: listed(map(alike_words, alike(effects))))
    if which.verdict == "none":
        if WithinAStep.where in which.text:
            return f"Nothing is missing. {which.text}"
        retuned = how_far is not None and how_far.gap_before > NEAR * how_far.gap_retuned
        return (
            "Nothing is missing: the"
            f" model{', its own numbers re-tuned,' if retuned else ' already'} reaches the noise."
        )
    return which.text or "There is a gap, and no known effect explains most of it."


def confusable_sentence(which: Which) -> str:
    if not which.confusable_with:
        return ""
    return (
        f"These data cannot tell it from {listed(effect_name(e) for e in which.confusable_with)}."
    )


def how_far_sentence(how_far: HowFar, verdict: str) -> str:
    """The gaps in multiples of the noise."""
    if not measured(how_far):
        return f"No gap is given: {one_line(how_far.interval_reason).rstrip('.')}."
    before, retuned, after = (
        times(g) for g in (how_far.gap_before, how_far.gap_retuned, how_far.gap_after)
    )
    if verdict == "none":
        stated = f"; as it was stated, {before}" if before != retuned else ""
        away = (
            f" The {how_far.split} data go where the data that were fitted leave numbers of the"
            " model open; within what is known of these it reaches the noise there too."
        )
        return (
            f"What is left, its own numbers re-tuned, is {retuned} times the noise; 1 is the noise"
            f" itself{stated}.{away if not how_far.gap_retuned <= NEAR else ''}"
        )
    if verdict == "unknown":
        worse = before != retuned and how_far.gap_retuned > how_far.gap_before
        led = (
            " Re-tuned to the data that were fitted it is further from these than as it was stated."
            if worse
            else ""
        )
        if retuned == before:
            return f"The gap is {before} times the noise."
        return (
            f"The gap is {before} times the noise, {retuned} after re-tuning the model's own"
            f" parameters.{led}"
        )
    if math.isnan(how_far.gap_before) or math.isnan(how_far.gap_after):
        return (
            f"The gap is {before} times the noise before, {after} after ({retuned} re-tuned alone);"
            " – could not be measured."
        )
    course = "falls" if how_far.gap_after < how_far.gap_before else "does not fall, but goes"
    alone = f" ({retuned} re-tuned alone)" if retuned != before else ""
    return f"The gap {course} from {before} to {after} times the noise{alone}."


def unused(how_far: HowFar) -> str:
    """What the data of the gap were not used for."""
    return (
        "data never fitted nor chosen on"
        if how_far.split == "report"
        else f"{how_far.split} data, which also chose the effect"
    )


def shrinkage_sentence(how_far: HowFar, verdict: str) -> str:
    """The share of the gap that is closed with its interval, or why there is none."""
    if verdict == "unknown" or not measured(how_far):
        return ""
    if verdict == "none" and how_far.gap_before > NEAR * how_far.gap_retuned:
        return "Its own numbers close the gap once they are re-tuned: no effect is needed."
    if how_far.shrinkage is None:
        return (
            f"No shrinkage is given: {one_line(how_far.interval_reason).rstrip('.')}."
            if how_far.interval_reason
            else ""
        )
    share = percent(how_far.shrinkage)
    head = f"{share[:1].upper()}{share[1:]} of its mean square is closed on {unused(how_far)}"
    if how_far.shrinkage_interval_95 is None:
        reason = one_line(how_far.interval_reason).rstrip(".").removeprefix("no interval: ")
        return f"{head} (no interval: {reason})." if reason else f"{head}."
    return f"{head}. {further_run(how_far)}"


def telling(how_far: HowFar) -> list[str]:
    """Channels, those first in which most happens: the error that goes or stays, against the
    noise.
    """

    def size(g):
        return max(abs(g.rmse_before - g.rmse_after), g.rmse_retuned, g.rmse_after) / max(
            g.noise, 1e-300
        )

    order = {name: size(gap) for name, gap in how_far.per_channel.items()}
    return sorted(order, key=lambda name: -order[name] if math.isfinite(order[name]) else -math.inf)


def further_run(how_far: HowFar) -> str:
    """What a further run like the report runs is to show."""
    assert how_far.shrinkage_interval_95 is not None
    lowest, highest = how_far.shrinkage_interval_95
    close = lowest > 1 - CLOSE
    reach = "as much" if close else f"{_share(lowest)} to {_share(highest)}"
    said = f"With 95 % probability a further run closes {reach}."
    if how_far.interval_from != "blocks":
        return said
    return f"{said} How runs differ is not known from fewer than eight report runs."


def _share(closed: float) -> str:
    return "less than nothing" if closed < 0 else percent(min(closed, 1.0))


def channel_sentence(how_far: HowFar, name: str, verdict: str) -> str:
    """A channel's error in its unit."""
    gap = how_far.per_channel[name]
    unit = one_line(gap.unit)
    before, retuned, after = (
        number(gap.rmse_before),
        number(gap.rmse_retuned),
        number(gap.rmse_after),
    )
    course = f"{before} → {after} {unit}" if verdict in ("named", "partly") else f"{before} {unit}"
    if verdict not in ("named", "partly") and retuned != before:
        course += f", {retuned} {unit} re-tuned"
    elif verdict in ("named", "partly") and gap.rmse_after > gap.rmse_retuned and retuned != after:
        course += f", further off than re-tuned alone ({retuned} {unit})"
    return (
        f"{one_line(name)}: rms error {course} (noise {number(gap.noise, 2)} {unit},"
        f" {one_line(gap.noise_source)})"
    )


def sentence(text: str) -> str:
    """A clause as a sentence of its own."""
    return f"{text[:1].upper()}{text[1:].rstrip('.')}."


#: What was compared, where that is no free run.
COMPARED = {
    "windows": ", compared over short windows",
    "inverse_dynamics": ", compared by torque along the measured motion",
    "closed_loop": ", simulated under the recording's controller",
}


def left_out_sentences(notes: Iterable[str]) -> list[str]:
    """Notes that say which parts of the runs were not looked at, as sentences."""
    return [sentence(one_line(note)) for note in notes if NOT_SIMULATED in note]


def diagnosis_text(diagnosis: Diagnosis) -> str:
    """About ten lines: where, which, how far, what next."""
    which, how_far = diagnosis.which, diagnosis.how_far
    channels = telling(how_far)[:3]
    verdict = first_of_all(diagnosis, which_sentence(which, how_far))
    parts = [
        *map(wrapped, data_lines(diagnosis.data)),
        (
            f"{one_line(diagnosis.dataset)}, model"
            f" {one_line(diagnosis.model)}{COMPARED.get(diagnosis.final.simulation, '')}"
        ),
        paragraph("LEFT OUT", left_out_sentences(diagnosis.notes)),
        joint_table(how_far.per_joint),
        paragraph("FIRST", [budget_sentence(diagnosis)]),
        paragraph("STATED", stated_sentences(diagnosis.final.stated, diagnosis.which.effects)),
        (
            ""
            if which.verdict == "none"
            else paragraph("WHERE", (where_sentence(f) for f in diagnosis.where[:2]))
        ),
        paragraph("WHICH", [verdict, *meaning(which), confusable_sentence(which)]),
        paragraph(
            "HOW FAR",
            [
                how_far_sentence(how_far, which.verdict),
                shrinkage_sentence(how_far, which.verdict),
                *(channel_sentence(how_far, name, which.verdict) for name in channels),
            ],
        ),
        paragraph(
            "NUMBERS", [numbers_sentence(diagnosis.final)] if which.verdict == "none" else []
        ),
        paragraph("NEXT", [diagnosis.next_experiment]),
    ]
    return "\n".join(filter(None, parts))


#: Numbers of a fit that its lines say; the page has all of them.
NUMBERS = 8


def numbers_sentence(fit: Fit) -> str:
    """What to write into the simulator where no effect is missing and no number was stated."""
    if fit.stated:
        return ""
    known = {name: p for name, p in fit.parameters.items() if p.identifiable and p.std is not None}
    said = [f"{one_line(name)} {value_with_std(p)}" for name, p in list(known.items())[:NUMBERS]]
    more = f", and {len(known) - NUMBERS} more on the page" if len(known) > NUMBERS else ""
    return f"{', '.join(said)}{more}." if said else ""


def joint_rows(rows: Sequence[Mapping[str, Any]]) -> tuple[list[str], list[tuple[str, ...]]]:
    """Head and rows of each joint's error with the file as it stands, re-tuned and with the
    effects, of the last split alone: the first table of every robot's result.
    """
    last = [r for r in rows if r["split"] == rows[-1]["split"]]
    effects = any(
        r.get("with_effects") is not None and r["with_effects"] != r["retuned"] for r in last
    )
    head = ["joint", "data", last[0]["text"] if last else "", "re-tuned"]
    columns = ["as_it_stands", "retuned"]
    if effects:
        head.append("with the effects")
        columns.append("with_effects")
    found = []
    for r in last:
        errors = [f"{number(r[column])} {r['unit']}" for column in columns]
        found.append((r["joint"], r["split"], *errors))
    return head, found


def joint_table(rows: Sequence[Mapping[str, Any]]) -> str:
    """The same as text; "" without rows."""
    if not rows:
        return ""
    head, body = joint_rows(rows)
    return table(tuple(head), body)


def parameter_rows(fit: Fit) -> list[tuple[str, Estimate]]:
    """The model's parameters, then those of its effects, by the names that they have in a
    fit: `effect.parameter@location`.
    """
    rows = list(fit.parameters.items())
    for effect in fit.effects:
        rows += [
            (f"{effect.effect}.{name}@{effect.location}", p)
            for name, p in effect.parameters.items()
        ]
    return rows


def fit_text(fit: Fit) -> str:
    """Parameters, scores and cost of a fit."""
    names = [fit.model, *(effect_name(e) for e in fit.effects)]
    state = {"budget": "not converged"}.get(fit.state, fit.state)
    parts = [
        *map(wrapped, data_lines(fit.data)),
        wrapped(
            f"{fit.dataset}, model {listed(names)}: {fit.fitter} on {fit.residual}, {state}"
            f" ({fit.stopped_because}), loss {number(fit.loss)} (1 = down to the noise)"
        ),
        joint_table(fit.per_joint),
        table(
            ("parameter", "value", "unit", ""),
            [
                (name, value_with_std(p, unit=False), p.unit, remark(p))
                for name, p in parameter_rows(fit)
            ],
        ),
    ]
    if fit.recursion:
        parts.append(recursion_table(fit))
    parts += posterior_lines(fit.posterior)
    scores = []
    for split, channels in fit.scores.items():
        for channel, s in channels.items():
            error, relative = f"{number(s.rmse)} {s.unit}", percent(s.relative_error)
            scores.append((split, channel, error, percent(s.nrmse), relative))
    if scores:
        parts.append(table(("data", "channel", "rms error", "of its std", "relative"), scores))
    parts += [together(fit)]
    parts += [paragraph("stated", [s.text]) for s in fit.stated]
    parts += [paragraph("note", [note]) for note in fit.notes]
    parts.append(
        f"{fit.evaluations} evaluations, {number(fit.wall_time_s)} s, {number(fit.compile_time_s)}"
        " s of it compiling"
    )
    return "\n".join(filter(None, parts))


def recursion_table(fit: Fit, most: int = 10, columns: int = 4) -> str:
    """The first numbers over the recursions of a fit along its data; of many recursions some, first
    and last among them.
    """
    names, count = list(fit.recursion[0].parameters)[:columns], len(fit.recursion)
    shown = sorted(
        {round(k * (count - 1) / max(1, min(most, count) - 1)) for k in range(min(most, count))}
    )
    rows = []
    for k in shown:
        step = fit.recursion[k]
        values = [number(step.parameters[name][0]) for name in names]
        rows.append((str(k + 1), number(step.t), *values))
    return table(("recursion", "until (s)", *map(one_line, names)), rows)


def simulation_text(simulation: Simulation) -> str:
    """The rms error of every run."""
    rows = []
    for i, channels in enumerate(simulation.rmse, start=1):
        for channel, rmse in channels.items():
            error = f"{number(rmse)} {simulation.units.get(channel, '')}"
            rows.append((f"run_{i}", channel, error))
    head = f"model {one_line(simulation.model)}, {len(simulation.runs)} runs simulated"
    return "\n".join(
        [head, table(("run", "channel", "rms error"), rows), *map(one_line, simulation.notes)]
    )


def identification_text(result: Identification) -> str:
    """The result as tables for a terminal."""
    from jaxid.base.wording import table
    from jaxid.conventions.finding import data_lines
    from jaxid.report.identified import (
        base_rows,
        beside_head,
        error,
        friction_rows,
        headline,
        payload_rows,
    )

    def recording_row(e: Any) -> tuple[str, ...]:
        each = [error(r, 1) for r in e.relative_error_per_joint]
        whole, unfiltered = error(e.relative_error), error(e.unfiltered_relative_error)
        return (e.file, e.split, whole, *each, unfiltered)

    joints = result.labels
    parts = [
        *data_lines(result.data),
        (
            f"{result.dataset}, model {result.model}: {result.method}, friction law {result.law}."
            f" {headline(result)}"
        ),
        *(f"{answer[0].upper()}{answer[1:]}." for answer in result.answers),
        table(
            ("recording", "data", "all joints", *joints, "unfiltered"),
            list(map(recording_row, result.experiments)),
        ),
        table(
            ("friction", *joints),
            [(f"{name} ({unit})", *values) for name, unit, values in friction_rows(result)],
        ),
        table(
            ("base parameter", "value", *beside_head(result), "unit", "stands for", ""),
            base_rows(result),
        ),
    ]
    if result.payload is not None:
        parts.append(table(("payload", "value", "95 % interval"), payload_rows(result)))
    parts.append(
        f"condition number {result.condition_number:.4g} ({result.condition_number_scaled:.4g} with"
        " columns of equal length)"
    )
    parts += [f"note: {n}" for n in (result.filter, *result.notes)]
    return "\n".join(parts)
