"""Fits mechanical models to measured data and says where a simulator is wrong, which effect is
missing, how far the gap shrinks.

`import jaxid` loads nothing heavy and changes no setting: each name is imported when it is first
used.
"""

from importlib import import_module as _import_module
from pathlib import Path as _Path
from typing import TYPE_CHECKING as _TYPE_CHECKING

# Forks are watched from the beginning.
from jaxid.numerics import forked as _forked  # noqa: F401


if _TYPE_CHECKING:
    from jaxid import fitters as fitters, models as models, runtime as runtime
    from jaxid.api import (
        check as check,
        compare as compare,
        diagnose as diagnose,
        fit as fit,
        replay as replay,
        simulate as simulate,
    )
    from jaxid.base.errors import DatasetError as DatasetError, UsageError as UsageError
    from jaxid.data.dataset import Channel as Channel, Dataset as Dataset, Experiment as Experiment
    from jaxid.data.io import load_dataset as load_dataset, save_dataset as save_dataset
    from jaxid.diagnosis.result import Diagnosis as Diagnosis
    from jaxid.dynamics.chain import Chain as Chain
    from jaxid.excitation.design import excite as excite
    from jaxid.fitting.comparison import Comparison as Comparison
    from jaxid.fitting.pure import make_problem as make_problem
    from jaxid.fitting.result import Fit as Fit
    from jaxid.identification.run import identify as identify


# Public name -> the module that holds it; None: the name is itself a sub-package.
_HOME = {
    "Chain": "jaxid.dynamics.chain",
    "Channel": "jaxid.data.dataset",
    "Comparison": "jaxid.fitting.comparison",
    "Dataset": "jaxid.data.dataset",
    "DatasetError": "jaxid.base.errors",
    "Diagnosis": "jaxid.diagnosis.result",
    "Experiment": "jaxid.data.dataset",
    "Fit": "jaxid.fitting.result",
    "UsageError": "jaxid.base.errors",
    "check": "jaxid.api",
    "compare": "jaxid.api",
    "diagnose": "jaxid.api",
    "excite": "jaxid.excitation.design",
    "fit": "jaxid.api",
    "fitters": None,
    "identify": "jaxid.identification.run",
    "load_dataset": "jaxid.data.io",
    "make_problem": "jaxid.fitting.pure",
    "models": None,
    "replay": "jaxid.api",
    "runtime": None,
    "save_dataset": "jaxid.data.io",
    "simulate": "jaxid.api",
}

__all__ = list(_HOME)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str):
    if name == "__version__":
        from importlib.metadata import version

        return version("jaxid")
    if name not in _HOME:
        raise AttributeError(f"module 'jaxid' has no attribute {name!r}")
    home = _HOME[name]
    value = _import_module(f"jaxid.{name}") if home is None else getattr(_import_module(home), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


# Installed, models/ and fitters/ lie in this folder; in a checkout beside it (in it are only stubs
# for type checkers).
if not (_Path(__file__).parent / "models" / "__init__.py").is_file():
    __path__.append(str(_Path(__file__).parents[1]))
