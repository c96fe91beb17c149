"""Results as tables of pandas, which is imported when one is asked for."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TYPE_CHECKING

from jaxid.errors import UsageError


if TYPE_CHECKING:
    import pandas

    from jaxid.diagnosis.result import Diagnosis
    from jaxid.fitting.result import Fit


def frame(rows: Sequence[dict[str, Any]], columns: Sequence[str]) -> pandas.DataFrame:
    """Rows as a data frame with these columns. Raises `UsageError` where pandas is not
    installed.
    """
    try:
        import pandas
    except ImportError as error:
        raise UsageError(
            "a table needs pandas: pip install pandas (to_dict() needs nothing)"
        ) from error
    return pandas.DataFrame(list(rows), columns=list(columns))


def of_fit(fit: Fit) -> pandas.DataFrame:
    """A row for each fitted number."""
    found = dict(fit.parameters)
    for e in fit.effects:
        found |= {
            f"{e.effect}.{name}@{e.location}": estimate for name, estimate in e.parameters.items()
        }
    columns = ("parameter", "value", "std", "unit", "lower", "upper", "at_bound", "identifiable")
    return frame(
        [{"parameter": name, **estimate.to_dict()} for name, estimate in found.items()], columns
    )


def of_diagnosis(diagnosis: Diagnosis) -> pandas.DataFrame:
    """A row for each candidate that was refitted."""
    named = {(e.effect, e.location) for e in diagnosis.which.effects}
    rows = [
        {**r.to_dict(), "named": (r.effect, r.location) in named} for r in diagnosis.which.ranking
    ]
    return frame(rows, ("effect", "location", "named", "validation_gap", "bic", "evidence", "text"))
