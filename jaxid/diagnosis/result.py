"""What a diagnosis returns: plain data that prints and saves itself as JSON."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from itertools import product
from typing import Any, TYPE_CHECKING

import numpy as np

from jaxid.base.display import Displayed, displays
from jaxid.base.frames import frame
from jaxid.base.serialise import model_digest, SCHEMA
from jaxid.base.versions import versions
from jaxid.conventions.finding import as_data, DataFinding
from jaxid.diagnosis.alike import alike
from jaxid.diagnosis.belief import Belief
from jaxid.diagnosis.budget import budget, Step
from jaxid.diagnosis.cause import words
from jaxid.fitting.exportable import Exportable
from jaxid.fitting.result import EffectEstimate, Fit, Trace, with_origin


if TYPE_CHECKING:
    import pandas
    from matplotlib.axes import Axes

    from jaxid.diagnosis.breakdown import Share
    from jaxid.diagnosis.unseen import Unseen
    from jaxid.excitation.discriminate import Rivals
    from jaxid.excitation.result import Excitation


#: What is clearly more than chance makes it is so many times as much.
STANDS_OUT = 1.1


@dataclass(frozen=True)
class Finding:
    """One place where the gap lies. `times_noise_floor` is the missing signal there over what noise
    would show there; `variable` what the force is a law of (or what tells the regime), `range`
    where in it (None: an open end). `value` is what is missing there, rms in `unit`; `direction` of
    the motion in which it is (forward, backward, both; "" where that is not told).
    """

    channel: str
    location: str
    regime: str
    window_s: tuple[float, float]
    share_of_gap: float
    times_noise_floor: float
    text: str
    variable: str = ""
    range: tuple[float | None, float | None] | None = None
    direction: str = ""
    value: float | None = None
    unit: str = ""

    def to_dict(self) -> dict[str, Any]:
        return {
            "channel": self.channel,
            "location": self.location,
            "regime": self.regime,
            "window_s": list(self.window_s),
            "share_of_gap": self.share_of_gap,
            "times_noise_floor": self.times_noise_floor,
            "variable": self.variable,
            "range": None if self.range is None else list(self.range),
            "direction": self.direction,
            "value": self.value,
            "unit": self.unit,
            "text": self.text,
        }


@dataclass(frozen=True)
class Regime:
    """Strength of the missing force in one regime of one joint, against what noise alone would
    give.
    """

    joint: str
    regime: str
    ratio: float  # rms of the missing force in this regime / rms over all samples
    null: tuple[float, float]  # the same ratio for a perfect model, 2.5 % and 97.5 %
    samples: int
    supplied: float | None = (
        None  # the same ratio for the force that named effects supply, which has no noise
    )

    @property
    def strength(self) -> float:
        """The ratio, without noise where that is known."""
        return self.ratio if self.supplied is None else self.supplied

    @property
    def stands_out(self) -> bool:
        """Whether the force is clearly stronger here than elsewhere, and than chance makes it."""
        least = max(1.0, self.null[1]) if self.supplied is None else 1.0
        return self.strength > STANDS_OUT * least


@dataclass(frozen=True)
class MissingForce:
    """Generalised force that the model lacks at one joint, along one experiment (torque residual,
    filtered).
    """

    joint: str
    unit: str  # of the force
    q_unit: str
    qd_unit: str
    experiment: str
    t: np.ndarray
    q: np.ndarray
    qd: np.ndarray
    load: np.ndarray
    before: np.ndarray
    after: np.ndarray
    floor: np.ndarray  # one standard deviation of what noise alone would show at each sample

    def plot(self, after: bool = False, ax: Axes | None = None) -> Axes:
        """Draws the motion in the phase plane, coloured by the missing force: a band along an axis
        is a law of velocity or position. `after`: what is still missing with the effect, in the
        same colours.
        """
        return displays().picture(self, after, ax)


@dataclass(frozen=True)
class Ranked:
    """One candidate after its refit: gaps in multiples of the noise on validation data, and the
    evidence for it.
    """

    effect: str
    location: str
    validation_gap: float
    bic: float
    evidence: (
        float  # validation log-likelihood gained over the nominal model, per independent block
    )
    text: str
    beside: tuple[str, ...] = ()  # effects that had been added before it

    @property
    def round(self) -> int:
        """In which round it was asked: 1 with nothing beside it."""
        return 1 + len(self.beside)

    def to_dict(self) -> dict[str, Any]:
        return {**asdict(self), "beside": list(self.beside), "round": self.round}


@dataclass(frozen=True)
class Which:
    verdict: str  # named | partly | none | unknown
    effects: tuple[EffectEstimate, ...]
    confusable_with: tuple[EffectEstimate, ...]
    ranking: tuple[Ranked, ...]
    text: str = ""
    doubts: dict[str, str] = field(
        default_factory=dict
    )  # "effect at location" -> why it is not to be believed as it stands
    belief: Belief | None = None  # probabilities, where a way of asking gives them

    def to_dict(self) -> dict[str, Any]:
        belief = self.belief or Belief({})
        if self.verdict != "none":
            belief = belief.of_a_gap()
        places: dict[tuple[str, str], Sequence[str]] = {}
        for group in alike(self.effects):
            at = group.locations
            places |= dict.fromkeys(product([group.common.effect], at), at)
        return {
            "verdict": self.verdict,
            **belief.to_dict(),
            "effects": [
                self._effect(e, belief, places[e.effect, e.location]) for e in self.effects
            ],
            "confusable_with": [
                {"effect": e.effect, "location": e.location} for e in self.confusable_with
            ],
            "ranking": [r.to_dict() for r in self.ranking],
            "text": self.text,
            "doubts": self.doubts,
        }

    @staticmethod
    def _effect(e: EffectEstimate, belief: Belief, places: Sequence[str]) -> dict[str, Any]:
        return {
            **e.to_dict(),
            "locations": list(places),
            **belief.of(e.effect, e.location),
            "text": words(e, "plain"),
            "check": words(e, "check"),
        }


@dataclass(frozen=True)
class ChannelGap:
    unit: str
    rmse_before: float
    rmse_retuned: float
    rmse_after: float
    noise: float
    noise_source: str

    def to_dict(self) -> dict[str, Any]:
        return asdict(self)


@dataclass(frozen=True)
class HowFar:
    """Gaps on report data, as multiples of the noise floor (1 = down to the noise; nan, null in
    JSON, where these stand still).

    `shrinkage` is that of all report data; `shrinkage_interval_95` that of one further run like
    them, made of `interval_from`: "runs", or "blocks" of fewer than eight runs, which do not know
    how runs differ.
    """

    gap_before: float
    gap_retuned: float
    gap_after: float
    noise_floor: float
    shrinkage: float | None
    shrinkage_interval_95: tuple[float, float] | None
    interval_reason: str
    per_channel: dict[str, ChannelGap]
    text: str = ""
    per_run: tuple[Share, ...] = ()
    per_regime: tuple[Share, ...] = ()
    interval_from: str = ""
    split: str = "report"  # of the data: "validation" where none is kept for the report
    #: Of a robot: error of each joint with the file as it stands, re-tuned, with effects.
    per_joint: tuple[dict[str, Any], ...] = ()
    ceiling: float | None = (
        None  # share of the re-tuned gap that a free law at the joints would close there
    )

    def to_dict(self) -> dict[str, Any]:
        return {
            "gap_before": self.gap_before,
            "gap_retuned": self.gap_retuned,
            "gap_after": self.gap_after,
            "noise_floor": self.noise_floor,
            "shrinkage": self.shrinkage,
            "shrinkage_interval_95": (
                None if self.shrinkage_interval_95 is None else list(self.shrinkage_interval_95)
            ),
            "interval_reason": self.interval_reason,
            "interval_from": self.interval_from,
            "split": self.split,
            "ceiling": self.ceiling,
            "per_channel": {k: v.to_dict() for k, v in self.per_channel.items()},
            "per_experiment": [s.to_dict() for s in self.per_run],
            "per_regime": [s.to_dict() for s in self.per_regime],
            "per_joint": list(self.per_joint),
            "text": self.text,
        }


@dataclass(frozen=True, repr=False)
class Diagnosis(Displayed, Exportable):
    """Where the simulator is wrong, which effect is missing, how far the gap shrinks once it is
    added.
    """

    model: str
    dataset: str
    dataset_sha256: str
    seed: int
    residual: str
    where: tuple[Finding, ...]
    which: Which
    how_far: HowFar
    next_experiment: str
    wall_time_s: float
    nominal: Fit
    final: Fit
    traces: tuple[Trace, ...] = ()
    missing_force: tuple[MissingForce, ...] = ()
    regimes: tuple[Regime, ...] = ()
    notes: tuple[str, ...] = ()
    unseen: tuple[Unseen, ...] = ()
    rivals: Rivals | None = field(default=None, repr=False, compare=False)
    data: tuple[DataFinding, ...] = ()  # what the recording says about itself
    complete: bool = True  # whether the search came to its end
    trust: dict[str, Any] = field(default_factory=dict)  # see `jaxid.problem.trust`
    accuracy: dict[str, float] = field(default_factory=dict)  # channel -> what was asked for, SI

    @property
    def budget(self) -> tuple[Step, ...]:
        """Gaps from the model as stated to what is left, step by step, on held-out runs."""
        stated = self.nominal.stated or self.final.stated
        law = None if self.which.belief is None else self.which.belief.free_law
        return budget(self.how_far, stated, self.which.verdict, "" if law is None else law.over)

    def next_run(self, **settings: Any) -> Excitation:
        """What to record next: the input that best tells the two leading hypotheses apart, within
        what the recorded runs reached, as a dataset to play: `.save(folder)`, then `jaxid record
        --play`. Settings: see `jaxid.excitation.discriminate.separate`.

        Raises `UsageError` where no second hypothesis is left, or no input can be designed.
        """
        from jaxid.excitation.discriminate import separate

        return separate(self.rivals, **settings)

    def to_frame(self) -> pandas.DataFrame:
        """A row for each candidate that was refitted, best first. Raises `UsageError` without
        pandas.
        """
        named = {(e.effect, e.location) for e in self.which.effects}
        rows = []
        for r in self.which.ranking:
            rows.append({**r.to_dict(), "named": (r.effect, r.location) in named})
        columns = ("effect", "location", "named", "validation_gap", "bic", "evidence", "text")
        return frame(rows, columns)

    def to_dict(self) -> dict[str, Any]:
        return {
            "schema": SCHEMA,
            "kind": "diagnosis",
            "model": self.model,
            "dataset": self.dataset,
            "dataset_sha256": self.dataset_sha256,
            **model_digest(self.final.model_sha256),
            "seed": self.seed,
            "residual": self.residual,
            "where": [f.to_dict() for f in self.where],
            "which": self.which.to_dict(),
            "how_far": {
                **self.how_far.to_dict(),
                "budget": [step.to_dict() for step in self.budget],
            },
            "next_experiment": self.next_experiment,
            "unseen": [u.to_dict() for u in self.unseen],
            "parameters": {k: v.to_dict() for k, v in self.final.parameters.items()},
            "stated": [s.to_dict() for s in self.final.stated],
            **with_origin(self.final),
            "trust": self.trust,
            "accuracy": self.accuracy,
            "complete": self.complete,
            "wall_time_s": self.wall_time_s,
            "notes": list(self.notes),
            "versions": versions(),
            **as_data(self.data),
        }

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draws the gap before, after retuning and with the missing effect, on new axes or the
        given ones.
        """
        return displays().picture(self, ax)
