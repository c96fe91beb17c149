"""Report pages: one self-contained HTML file without scripts. One section is one module and its
template.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from jaxid.base.atomic_files import replace_files
from jaxid.base.serialise import json_bytes
from jaxid.base.wording import one_line
from jaxid.report import (
    answer,
    background,
    breakdown,
    carry,
    checked,
    compared,
    fitted,
    identified,
    missing_force,
    parameters,
    posterior,
    ranking,
    recorded,
    traces,
    unseen,
    yardstick,
)
from jaxid.report.page import render, render_fragment, Section


if TYPE_CHECKING:
    from jaxid.conventions.finding import Checked
    from jaxid.data.dataset import Dataset
    from jaxid.diagnosis.result import Diagnosis
    from jaxid.fitting.comparison import Comparison
    from jaxid.fitting.result import Fit
    from jaxid.identification.result import Identification


def diagnosis_page(diagnosis: Diagnosis) -> str:
    """The page of a diagnosis. Like every page it carries the name and the SHA-256 of its JSON file
    in `meta` tags.
    """
    sections = [
        checked.before(diagnosis.data),
        answer.section(diagnosis),
        carry.section(
            diagnosis.final, "diagnosis.json", believed=diagnosis.which.verdict != "unknown"
        ),
        checked.asked(diagnosis.data),
        yardstick.section(
            diagnosis.how_far.per_joint, diagnosis.final.stated, diagnosis.how_far.per_channel
        ),
        unseen.section(diagnosis.unseen),
        traces.section(diagnosis.traces),
        breakdown.section(diagnosis),
        missing_force.section(diagnosis.missing_force, diagnosis.regimes, diagnosis.where),
        ranking.section(diagnosis.which),
        parameters.section(diagnosis.final, diagnosis.nominal if diagnosis.which.effects else None),
        Section("words.html", {}),
        background.of_diagnosis(diagnosis),
    ]
    return render(
        f"{one_line(diagnosis.dataset)}: diagnosis",
        sections,
        "diagnosis.json",
        json_bytes(diagnosis),
    )


def fit_page(fit: Fit) -> str:
    """The page of a fit."""
    sections = [
        checked.before(fit.data),
        fitted.section(fit),
        carry.section(fit, "fit.json"),
        checked.asked(fit.data),
        yardstick.section(fit.per_joint, fit.stated),
        parameters.section(fit),
        posterior.section(fit.posterior),
        traces.section(fit.traces),
        background.of_fit(fit),
    ]
    return render(f"{one_line(fit.dataset)}: fit", sections, "fit.json", json_bytes(fit))


def comparison_page(comparison: Comparison) -> str:
    """The page of a comparison."""
    sections = [
        checked.before(comparison.data),
        compared.section(comparison),
        checked.asked(comparison.data),
        background.of_comparison(comparison),
    ]
    return render(
        f"{one_line(comparison.dataset)}: comparison",
        sections,
        "comparison.json",
        json_bytes(comparison),
    )


def identification_page(result: Identification) -> str:
    """The page of an identification."""
    sections = [
        checked.before(result.data),
        identified.section(result),
        carry.section(result, "identification.json"),
        checked.asked(result.data),
    ]
    return render(
        f"{one_line(result.dataset)}: identification",
        sections,
        "identification.json",
        json_bytes(result),
    )


def check_page(result: Checked) -> str:
    """The page of a check."""
    return render(
        f"{one_line(result.dataset)}: check",
        [checked.section(result)],
        "check.json",
        json_bytes(result),
    )


def comparison_fragment(comparison: Comparison) -> str:
    """Table and pictures as an HTML fragment, for a notebook."""
    return render_fragment([compared.section(comparison)])


def check_fragment(result: Checked) -> str:
    """The findings of a check as an HTML fragment, for a notebook."""
    return render_fragment([checked.section(result)])


def identification_fragment(result: Identification) -> str:
    """The page of an identification as an HTML fragment, for a notebook."""
    return render_fragment([identified.section(result)])


def diagnosis_fragment(diagnosis: Diagnosis) -> str:
    """The first section of the page as an HTML fragment, for a notebook."""
    return render_fragment([answer.section(diagnosis)])


def fit_fragment(fit: Fit) -> str:
    """Scores and parameters of a fit as an HTML fragment, for a notebook."""
    return render_fragment([fitted.section(fit, history=False), parameters.section(fit)])


def dataset_fragment(data: Dataset) -> str:
    """Channels, runs and notes of a dataset as an HTML fragment, for a notebook."""
    return render_fragment([recorded.section(data)])


def write_page(html: str, path: str | Path) -> Path:
    """Writes a page whole or not at all and returns its path. Raises `NotSaved`."""
    path = Path(path)
    return replace_files(path.parent, {path.name: html.encode()}) / path.name
