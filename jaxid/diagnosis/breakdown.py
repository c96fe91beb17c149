"""How far the gap shrinks run by run and regime by regime: whether what was found holds elsewhere,
and where it does not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from jaxid.base.wording import names_of
from jaxid.data.experiment import Experiment
from jaxid.diagnosis.evidence import HeldOut
from jaxid.diagnosis.missing import joint_load, Missing
from jaxid.diagnosis.regimes import situations
from jaxid.fitting.problem_builder import ProblemBuilder
from jaxid.fitting.scores import scored
from jaxid.problem.binding import Binding


#: A regime with fewer samples is left out.
SAMPLES = 20


@dataclass(frozen=True)
class Share:
    """Gap of a part of the held-out data, in multiples of the noise: the model as stated, re-tuned,
    and with the effects.
    """

    part: str
    joint: str
    samples: int
    before: float
    retuned: float
    after: float

    def to_dict(self) -> dict[str, float | str | int]:
        where = {"experiment": self.part}
        if self.joint:
            where = {"regime": self.part, "joint": self.joint}
        return where | {
            "samples": self.samples,
            "gap_before": self.before,
            "gap_retuned": self.retuned,
            "gap_after": self.after,
        }


def by_run(bench: ProblemBuilder, split: str, models: Sequence[HeldOut]) -> tuple[Share, ...]:
    """Of every run of a split; `models` as stated, re-tuned, with the effects."""
    names = names_of(bench.binding.experiments(split))
    if any(len(m.residual) != len(names) for m in models):
        return ()
    shares = []
    for name, *residuals in zip(names, *(m.residual for m in models), strict=True):
        shares.append(_share(name, "", residuals))
    return tuple(shares)


def by_regime(bench: ProblemBuilder, split: str, models: Sequence[HeldOut]) -> tuple[Share, ...]:
    """Of the situations that the machine was in, joint by joint; none where joints are not measured
    or torques are compared.
    """
    b = bench.binding
    runs = b.experiments(split)
    if not runs or b.chain.mechanism.hidden_states or not b.motions.keys() >= set(names_of(runs)):
        return ()
    kept = np.concatenate([scored(e, split) for e in runs])
    residuals = [np.concatenate(m.residual) for m in models]
    if any(len(residual) != np.sum(kept) for residual in residuals):
        return ()
    moved = [_moved(b, e) for e in runs]
    out = []
    for j, joint in enumerate(b.chain.signature.joints):
        for name, inside in situations(moved, j).items():
            own = np.concatenate(inside)[kept]
            if np.sum(own) >= SAMPLES:
                out.append(_share(name, joint, [residual[own] for residual in residuals]))
    return tuple(out)


def _moved(b: Binding, e: Experiment) -> Missing:
    """A run's motion and what loads its joints, without a force that is missing."""
    m = b.motions[e.name]
    none = np.zeros((0, len(e.t), b.chain.nq))
    return Missing(
        experiment=e,
        keep=np.ones(len(e.t), bool),
        q=m.q,
        qd=m.qd,
        qdd=m.qdd,
        load=joint_load(b, e, m),
        force=none,
        null=none,
    )


def _share(part: str, joint: str, residuals: Sequence[np.ndarray]) -> Share:
    """Of residuals [samples] of each model."""
    gaps = [float(np.sqrt(np.mean(r**2))) for r in residuals]
    return Share(part, joint, len(residuals[0]), *gaps)
