"""Free runs of a model with given parameters on the inputs of a dataset."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxid.base.errors import UsageError
from jaxid.base.numbers import parameter_value
from jaxid.base.wording import names_of
from jaxid.data.dataset import Dataset
from jaxid.dynamics.chain import Chain
from jaxid.dynamics.model_file import sha256_of
from jaxid.dynamics.parameter_vector import ParameterVector
from jaxid.fitting.problem_builder import estimate_starts, ProblemBuilder
from jaxid.fitting.scores import free_runs, scored
from jaxid.fitting.simulation import Simulation
from jaxid.numerics.precision import float64
from jaxid.problem.binding import bind, Binding, resolve_model
from jaxid.problem.solver import solver_name, solver_notes, with_solver
from jaxid.simulation import sample_buffers as samples
from jaxid.simulation.animation import motion, OutlineMotion


def simulate_dataset(
    content: Mapping[str, Any] | None, dataset: Dataset, model: object, solver: Any = None
) -> Simulation:
    """See `jaxid.simulate`; without content with the numbers of the model itself. A run without a
    stated start estimates it from its first samples, which leave the rmse.
    """
    content = own_numbers(resolve_model(model, dataset)) if content is None else content
    binding, theta = _bound(content, dataset, model)
    binding = with_solver(binding, solver, None)
    bench = ProblemBuilder(binding)
    runs: dict[str, dict[str, np.ndarray]] = {}
    rmse: dict[str, dict[str, float]] = {}
    starts: dict[str, np.ndarray] = {}
    names = binding.chain.signature.output_names
    _, iy = samples.columns(binding.dataset, binding.chain)
    for split in dict.fromkeys(e.split for e in dataset.experiments):
        begin = estimate_starts(bench, split, [theta])
        predictions = free_runs(bench, split, [theta], begin)[0]
        for e, y, x in zip(binding.experiments(split), predictions, begin[0], strict=True):
            starts[e.name] = x
            runs[e.name] = {"t": e.t, **dict(zip(names, y.T, strict=True))}
            keep = scored(e, "simulate")[:, None] & e.read[:, iy]
            error = np.where(keep, y - e.y[:, iy], 0.0)
            size = np.sqrt(np.sum(error**2, 0) / np.maximum(keep.sum(0), 1))
            rmse[e.name] = dict(zip(names, size.tolist(), strict=True))

    def moving(i: int) -> OutlineMotion | None:
        e = dataset.experiments[i]
        own = theta.copy()
        for name, value in e.constants.items():
            own[binding.layout.index(name)] = value
        with float64():
            chain = binding.layout.model(jnp.asarray(own))
            return motion(chain, binding.dataset, e, starts[e.name], binding.sigma)

    order = names_of(dataset.experiments)
    return Simulation(
        model=binding.chain.mechanism.name,
        runs=tuple(runs[n] for n in order),
        rmse=tuple(rmse[n] for n in order),
        units=dict(binding.chain.signature.outputs),
        notes=(*dataset.notes, *solver_notes(binding)),
        motion=moving,
        solver=solver_name(binding),
        starts=tuple(np.asarray(starts[n]) for n in order),
        model_sha256=sha256_of(binding.chain.mechanism),
    )


def _bound(
    content: Mapping[str, Any], dataset: Dataset, model: object
) -> tuple[Binding, np.ndarray]:
    """Model and data, and the numbers of a fit on them."""
    effects = content.get("effects", [])
    parameters = content.get("parameters", {})
    if not isinstance(parameters, Mapping) or not isinstance(effects, list | tuple):
        raise UsageError(
            'parameters must look like {"parameters": {"inertia": {"value": 0.08}}, "effects": []}'
        )
    model = model or content.get("model")
    # Its own laws have their numbers among the parameters.
    known = resolve_model(model, dataset).contents
    added = [e for e in effects if not (isinstance(e, Mapping) and e.get("effect") in known)]
    binding = bind(model, dataset, effects=[_label(e) for e in added], splits=False)
    theta = binding.theta.copy()
    for name, value in parameters.items():
        theta[binding.layout.index(name)] = parameter_value(name, value)
    for e in effects:
        if not isinstance(e, Mapping):
            continue
        numbers = binding.layout.of_effect(e["effect"], e.get("location"))
        for field, value in e.get("parameters", {}).items():
            indices = [i for i in numbers if binding.layout.entries[i].field == field]
            if not indices:
                raise UsageError(f"effect {e['effect']} has no parameter {field!r}")
            theta[indices] = parameter_value(f"{e['effect']}.{field}", value)
    return binding, theta


def own_numbers(chain: Chain) -> dict[str, Any]:
    """The numbers that a chain holds, as the content of a fit.json; constants are left to the
    dataset.
    """
    layout = ParameterVector(chain)
    numbers = zip(layout.entries, layout.values, strict=True)
    return {
        "parameters": {
            e.name: {"value": float(v)} for e, v in numbers if not e.spec.fixed and np.isfinite(v)
        }
    }


def _label(effect: Any) -> str:
    if isinstance(effect, str):
        return effect
    if not isinstance(effect, Mapping) or "effect" not in effect:
        raise UsageError(
            'an effect must look like {"effect": "dead_zone", "location": "tau", "parameters":'
            " {...}}"
        )
    place = effect.get("location")
    return effect["effect"] + (f"@{place}" if place else "")
