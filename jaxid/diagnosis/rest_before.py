"""Runs that begin at rest with a command that does not keep them there: what was commanded before.

A run is simulated as if its first command had held before it. From rest that cannot be where the
first command moves the joints, and a delay then looks like nothing that a library has.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np

from jaxid.base.stopping import Interrupted
from jaxid.base.wording import times
from jaxid.data.dataset import Dataset
from jaxid.data.experiment import Experiment
from jaxid.diagnosis.last_resort import SAYS_MORE
from jaxid.diagnosis.result import Diagnosis
from jaxid.dynamics import catalogue
from jaxid.dynamics.chain import Chain
from jaxid.dynamics.effect import Command, LONGEST_DELAY_S
from jaxid.numerics.precision import float64
from jaxid.simulation.sample_buffers import columns, STEP


#: Share of the largest command that one before a run differs by, to be another one.
OTHER = 1e-6


def asked_from_rest(
    found: Diagnosis,
    dataset: Dataset,
    allowed: Sequence[str],
    ask: Callable[[tuple[str, ...], Dataset], Diagnosis],
) -> Diagnosis:
    """The answer with such commands before the runs, where that says more. What is about when
    something happens is asked again, of what is `allowed`, beside what was named; `ask` diagnoses
    with such candidates.
    """
    before = found.which.verdict
    timing = [n for n in allowed if catalogue.effect_class(n).acts_on == "timing"]
    chain = found.nominal.chain
    if before not in SAYS_MORE or not timing or chain is None:
        return found
    rested = with_rest_before(dataset, chain)
    if rested is None:
        return found
    names = dict.fromkeys([*(e.effect for e in found.which.effects), *timing])
    try:
        again = ask(tuple(names), rested)
    except Interrupted as stop:
        raise Interrupted(found) from stop
    if again.which.verdict not in SAYS_MORE[before]:
        return found
    note = (
        "before runs from rest the command is taken that keeps the model there and is nearest their"
        f" first one; as if the first one had held, the answer was {before} with"
        f" {times(found.how_far.gap_after)} times the noise left"
    )
    return dataclasses.replace(again, notes=(*again.notes, note))


def with_rest_before(dataset: Dataset, chain: Chain) -> Dataset | None:
    """The dataset whose runs from rest have a sample before them, with the command nearest their
    first one that keeps the model `chain` at rest; None where the first ones do so, or no run
    tells.
    """
    if not chain.direct or any(channel.hold == "linear" for channel in dataset.inputs):
        return None
    runs = [_with_past(e, dataset, chain) for e in dataset.experiments]
    if all(run is e for run, e in zip(runs, dataset.experiments, strict=True)):
        return None
    return dataclasses.replace(dataset, experiments=tuple(runs))


def _with_past(e: Experiment, dataset: Dataset, chain: Chain) -> Experiment:
    inputs, outputs = columns(dataset, chain)
    readings = chain.joint_outputs
    if not e.at_rest or e.past is not None or not inputs or len(readings) < chain.nq:
        return e
    q = e.motion()[0, outputs][list(readings)]
    first = e.u[0, inputs]
    before = keeps_at_rest(chain, q, first)
    if np.all(np.abs(before - first) <= OTHER * np.max(np.abs(e.u[:, inputs]))):
        return e
    held = e.u[:1].copy()
    held[0, inputs] = before
    past = Experiment(
        name=e.name,
        split=e.split,
        t=e.t[:1] - LONGEST_DELAY_S,
        u=held,
        y=e.y[:1],
        auxiliary={name: values[:1] for name, values in e.auxiliary.items()},
        at_rest=True,
    )
    return dataclasses.replace(e, past=past)


def keeps_at_rest(chain: Chain, q: np.ndarray, first: np.ndarray) -> np.ndarray:
    """The command [nu] nearest `first` under which the model stays at rest at the positions q."""
    with float64():
        body = chain.body().prepare(None)
        still = jnp.zeros(chain.nq)

        def balance(u):
            now = jnp.zeros(())
            command = Command(now, jnp.asarray(STEP), u, u, lambda d: u + 0 * d)
            z = chain.start(jnp.asarray(q), still, u, body).z
            left, minus, plus, _ = chain.balance(command, z, jnp.asarray(q), still, still)
            return left, left - jnp.clip(left, -minus, plus)

        u = jnp.asarray(first, float)
        _, beyond = balance(u)
        slope = jax.jacfwd(lambda u: balance(u)[0])(u)
        return np.asarray(first - jnp.linalg.pinv(slope) @ beyond)
