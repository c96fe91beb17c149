"""How far the gap shrinks run by run and regime by regime: whether what was found holds elsewhere,
and where it does not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from jaxid.base.wording import names_of
from jaxid.diagnosis.evidence import HeldOut
from jaxid.diagnosis.missing import joint_load, Missing
from jaxid.diagnosis.regimes import situations
from jaxid.fitting.problem_builder import ProblemBuilder
from jaxid.fitting.scores import scored


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
        own = {
            "samples": self.samples,
            "gap_before": self.before,
            "gap_retuned": self.retuned,
            "gap_after": self.after,
        }
        return (
            {"regime": self.part, "joint": self.joint} if self.joint else {"experiment": self.part}
        ) | own


def by_run(bench: ProblemBuilder, split: str, models: Sequence[HeldOut]) -> tuple[Share, ...]:
    """Of every run of a split; `models` as stated, re-tuned, with the effects."""
    names = names_of(bench.binding.experiments(split))
    if any(len(m.residual) != len(names) for m in models):
        return ()
    return tuple(
        _share(name, "", [[m.residual[k]] for m in models]) for k, name in enumerate(names)
    )


def by_regime(bench: ProblemBuilder, split: str, models: Sequence[HeldOut]) -> tuple[Share, ...]:
    """Of the situations that the machine was in, joint by joint; none where joints are not measured
    or torques are compared.
    """
    b = bench.binding
    runs = b.experiments(split)
    if (
        not b.motions
        or b.chain.mechanism.hidden_states
        or any(e.name not in b.motions for e in runs)
    ):
        return ()
    keep = [scored(e, split) for e in runs]
    if any([len(r) for r in m.residual] != [int(np.sum(k)) for k in keep] for m in models):
        return ()
    out = []
    moved = []
    for e in runs:
        m = b.motions[e.name]
        load = joint_load(b, e, m)
        none = np.zeros((0, len(e.t), b.chain.nq))
        moved.append(
            Missing(
                experiment=e,
                keep=np.ones(len(e.t), bool),
                q=m.q,
                qd=m.qd,
                qdd=m.qdd,
                load=load,
                force=none,
                null=none,
            )
        )
    for j, joint in enumerate(b.chain.signature.joints):
        for name, inside in situations(moved, j).items():
            own = [mask[kept] for mask, kept in zip(inside, keep, strict=True)]
            if sum(int(x.sum()) for x in own) >= SAMPLES:
                parts = [[r[x] for r, x in zip(m.residual, own, strict=True)] for m in models]
                out.append(_share(name, joint, parts))
    return tuple(out)


def _share(part: str, joint: str, residuals: Sequence[Sequence[np.ndarray]]) -> Share:
    gaps = [float(np.sqrt(np.mean(np.concatenate(r) ** 2))) for r in residuals]
    return Share(part, joint, sum(len(r) for r in residuals[0]), *gaps)
