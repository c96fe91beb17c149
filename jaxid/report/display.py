"""How each kind of value shows itself: `text` for the terminal, `fragment` for a notebook, `page`
as a file, `picture` on axes. Values come here by `jaxid.base.display`.
"""

from __future__ import annotations

from functools import singledispatch
from pathlib import Path
from typing import Any, TYPE_CHECKING

from jaxid import report
from jaxid.conventions.finding import Checked
from jaxid.conventions.words import checked_text
from jaxid.data.dataset import Dataset
from jaxid.diagnosis.result import Diagnosis, MissingForce
from jaxid.fitting.comparison import Comparison
from jaxid.fitting.profiles import Profile
from jaxid.fitting.replay import Replay
from jaxid.fitting.result import Fit, Trace
from jaxid.fitting.simulation import Simulation
from jaxid.identification.result import Identification
from jaxid.report import figures, posterior
from jaxid.report.carried_text import export_text, replay_text
from jaxid.report.compared import comparison_picture
from jaxid.report.comparison_text import comparison_text
from jaxid.report.text import diagnosis_text, fit_text, identification_text, simulation_text
from jaxid.robots.export.run import Exported


if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from jaxid.fitting.posterior import Posterior


def _nothing_for(value: Any) -> Any:
    raise TypeError(f"jaxid.report has nothing of this kind for a {type(value).__name__}")


@singledispatch
def text(value: Any) -> str:
    """What the command line prints of a value. Raises `TypeError` where it has no text."""
    return _nothing_for(value)


@singledispatch
def page(value: Any) -> str:
    """The report page as HTML. Raises `TypeError` for a value without one."""
    return _nothing_for(value)


@singledispatch
def fragment(value: Any) -> str:
    """HTML for a notebook. Raises `TypeError` for a value without one."""
    return _nothing_for(value)


@singledispatch
def picture(value: Any, *args: Any) -> Axes:
    """Draws a value on axes. Raises `TypeError` for a value without a picture."""
    return _nothing_for(value)


def image(value: Posterior) -> bytes:
    """The picture of a posterior as a PNG."""
    return posterior.corner_file(value)


def write(value: Any, path: str | Path) -> Path:
    """Writes the page of a value, whole or not at all, and returns its path. Raises `NotSaved`."""
    return report.write_page(page(value), path)


text.register(Checked, checked_text)
text.register(Comparison, comparison_text)
text.register(Diagnosis, diagnosis_text)
text.register(Exported, export_text)
text.register(Fit, fit_text)
text.register(Identification, identification_text)
text.register(Replay, replay_text)
text.register(Simulation, simulation_text)

page.register(Checked, report.check_page)
page.register(Comparison, report.comparison_page)
page.register(Diagnosis, report.diagnosis_page)
page.register(Fit, report.fit_page)
page.register(Identification, report.identification_page)

fragment.register(Checked, report.check_fragment)
fragment.register(Comparison, report.comparison_fragment)
fragment.register(Dataset, report.dataset_fragment)
fragment.register(Diagnosis, report.diagnosis_fragment)
fragment.register(Fit, report.fit_fragment)
fragment.register(Identification, report.identification_fragment)

picture.register(Comparison, comparison_picture)
picture.register(Dataset, figures.dataset)
picture.register(Diagnosis, figures.diagnosis)
picture.register(Fit, figures.fit)
picture.register(MissingForce, figures.missing_force)
picture.register(Profile, figures.profile)
picture.register(Trace, figures.trace)
