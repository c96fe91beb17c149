"""What a solver process does with a batch: fits and diagnoses, with data, models and programs kept
from batch to batch.
"""

from __future__ import annotations

import itertools
import socket
import warnings
from collections import OrderedDict
from collections.abc import Callable, Iterator
from typing import Any

import jaxid
from jaxid.api import resolve_fitter, resolve_residual
from jaxid.base.errors import UsageError
from jaxid.base.serialise import finite
from jaxid.data.dataset import Dataset
from jaxid.data.model_names import is_model_file
from jaxid.diagnosis.result import Diagnosis
from jaxid.dynamics.model_file import own_model, sha256_of
from jaxid.fitters import LevenbergMarquardt
from jaxid.fitting.result import Fit
from jaxid.fitting.run import fit_seeds, ProblemBuilders
from jaxid.problem.binding import bind


#: Datasets and bound models that are kept.
KEPT = 4


class Workshop:
    """Answers batches; see `jaxid.study.solver.Work`."""

    def __init__(self):
        self._data: OrderedDict[Any, Dataset] = OrderedDict()
        self._benches: OrderedDict[Any, ProblemBuilders] = OrderedDict()

    def work(self, tasks: list[dict[str, Any]]) -> Iterator[dict[str, Any]]:
        """Seeds of one Levenberg-Marquardt fit together, everything else one by one."""
        for _, group in itertools.groupby(tasks, key=lambda t: t["group"]):
            yield from self._same(list(group))

    def _same(self, tasks: list[dict[str, Any]]) -> Iterator[dict[str, Any]]:
        first = tasks[0]
        fitter = (
            resolve_fitter(first["fitter"], first["loss"] or "sum_of_squares")
            if first["command"] == "fit"
            else None
        )
        together = [tasks] if isinstance(fitter, LevenbergMarquardt) else [[t] for t in tasks]
        for part in together:
            yield {"begin": [t["key"] for t in part]}
            if fitter is None:
                yield _diagnosed(part[0], self._diagnose(part[0]))
                continue
            for task, fit in zip(part, self._fits(fitter, part), strict=True):
                yield _fitted(task, fit)

    def _fits(self, fitter: Any, tasks: list[dict[str, Any]]) -> list[Fit]:
        t = tasks[0]
        wanted = t["residual"] or getattr(fitter, "residual_name", None)
        return fit_seeds(
            self._bound(t).binding,
            fitter,
            resolve_residual(wanted),
            t["loss"] or "sum_of_squares",
            [task["seed"] for task in tasks],
            t["budget"],
            benches=self._bound(t),
        )

    def _diagnose(self, t: dict[str, Any]) -> Diagnosis:
        return jaxid.diagnose(
            _model(t),
            self._dataset(t),
            max_effects=t["max_effects"] or 3,
            effects=t["effects"] or None,
            without=t["without"],
            residual=t["residual"],
            seed=t["seed"],
        )

    def _dataset(self, t: dict[str, Any]) -> Dataset:
        def load() -> Dataset:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # each stands in the result
                data = jaxid.load_dataset(t["dataset"])
            if data.sha256 != t["dataset_sha256"]:
                raise UsageError(
                    f"{t['dataset']} on {socket.gethostname()} is not the dataset that the study"
                    " began with"
                )
            return data

        return _kept(self._data, (t["dataset"], t["dataset_sha256"]), load)

    def _bound(self, t: dict[str, Any]) -> ProblemBuilders:
        key = (
            t["dataset_sha256"],
            t["model"],
            t["model_sha256"],
            tuple(t["effects"] or ()),
            tuple(t["without"]),
        )

        def make():
            return ProblemBuilders(
                bind(_model(t), self._dataset(t), effects=t["effects"] or (), without=t["without"])
            )

        return _kept(self._benches, key, make)


def _model(t: dict[str, Any]) -> Any:
    """The model of a task; a file of the user's own is the one that the study began with."""
    name = t["model"]
    if not is_model_file(name):
        return name
    model = own_model(name)()
    if sha256_of(model) != t["model_sha256"]:
        raise UsageError(
            f"{name} on {socket.gethostname()} is not the file that the study began with: start it"
            " again"
        )
    return model


def _kept(kept: OrderedDict[Any, Any], key: Any, make: Callable[[], Any]) -> Any:
    """The value of a key, made if it is not there; the one longest unused goes."""
    if key not in kept:
        kept[key] = make()
    kept.move_to_end(key)
    while len(kept) > KEPT:
        kept.popitem(last=False)
    return kept[key]


def _fitted(task: dict[str, Any], fit: Fit) -> dict[str, Any]:
    parameters = {name: e.value for name, e in fit.parameters.items()}
    for effect in fit.effects:
        parameters |= {
            f"{effect.effect}.{name}@{effect.location}": e.value
            for name, e in effect.parameters.items()
        }
    return finite(
        {
            "done": task["key"],
            "status": "failed" if fit.failed else "converged" if fit.converged else "stopped",
            "reason": fit.stopped_because,
            "loss": fit.loss,
            "evaluations": fit.evaluations,
            "wall_time_s": fit.wall_time_s,
            "compile_time_s": fit.compile_time_s,
            "parameters": parameters,
            "history": fit.history,
            "result": fit.to_dict(),
        }
    )


def _diagnosed(task: dict[str, Any], diagnosis: Diagnosis) -> dict[str, Any]:
    message = _fitted(task, diagnosis.final)
    message |= {
        "verdict": diagnosis.which.verdict,
        "named": [str(e).replace(" at ", "@") for e in diagnosis.which.effects],
    }
    if diagnosis.nominal.failed:
        message |= {
            "status": "failed",
            "reason": f"the nominal fit failed: {diagnosis.nominal.stopped_because}",
        }
    return message | finite(
        {"wall_time_s": diagnosis.wall_time_s, "result": diagnosis.to_dict(), "history": ()}
    )
