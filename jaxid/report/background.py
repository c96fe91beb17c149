"""What cannot be told apart, what to record next, notes, cost and versions."""

from __future__ import annotations

from typing import TYPE_CHECKING

from jaxid.base import wording
from jaxid.base.versions import versions
from jaxid.report.effect_text import effect_name
from jaxid.report.page import Section


if TYPE_CHECKING:
    from jaxid.diagnosis.result import Diagnosis
    from jaxid.fitting.comparison import Comparison
    from jaxid.fitting.result import Fit


def of_diagnosis(diagnosis: Diagnosis) -> Section:
    final = diagnosis.final
    notes = dict.fromkeys([*diagnosis.notes, *final.notes])
    notes |= dict.fromkeys(
        f"nominal model: {note}" for note in diagnosis.nominal.notes if note not in notes
    )
    return Section(
        "background.html",
        {
            "named": wording.listed(effect_name(e) for e in diagnosis.which.effects),
            "several": len(diagnosis.which.effects) > 1,
            "confusable": [effect_name(e) for e in diagnosis.which.confusable_with],
            "next_experiment": diagnosis.next_experiment,
            "notes": list(notes),
            "facts": [
                ("dataset", f"{diagnosis.dataset} (sha256 {diagnosis.dataset_sha256[:16]})"),
                ("residual", diagnosis.residual),
                ("fitter", final.fitter),
                ("seed", str(diagnosis.seed)),
                ("time", f"{wording.number(diagnosis.wall_time_s)} s"),
                *version_facts(),
            ],
        },
    )


def of_fit(fit: Fit) -> Section:
    return Section(
        "background.html",
        {
            "named": "",
            "confusable": [],
            "next_experiment": "",
            "notes": list(fit.notes),
            "facts": [
                ("dataset", f"{fit.dataset} (sha256 {fit.dataset_sha256[:16]})"),
                ("loss", fit.loss_name),
                ("seed", str(fit.seed)),
                ("evaluations", str(fit.evaluations)),
                (
                    "time",
                    (
                        f"{wording.number(fit.wall_time_s)} s, {wording.number(fit.compile_time_s)}"
                        " s of it compiling"
                    ),
                ),
                *version_facts(),
            ],
        },
    )


def of_comparison(comparison: Comparison) -> Section:
    return Section(
        "background.html",
        {
            "named": "",
            "confusable": [],
            "next_experiment": "",
            "notes": list(comparison.notes),
            "facts": [
                ("dataset", f"{comparison.dataset} (sha256 {comparison.dataset_sha256[:16]})"),
                ("residual", comparison.residual),
                ("loss", comparison.loss_name),
                ("runs", f"{len(comparison.runs)}, one after the other"),
                ("time", f"{wording.number(comparison.wall_time_s)} s"),
                *version_facts(),
            ],
        },
    )


def version_facts() -> list[tuple[str, str]]:
    return [("made with", ", ".join(f"{name} {version}" for name, version in versions().items()))]
