"""Results as tables of pandas, which is imported when one is asked for."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TYPE_CHECKING

from jaxid.base.errors import UsageError


if TYPE_CHECKING:
    import pandas


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
