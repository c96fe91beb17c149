"""Drive laws of robots: from `[controller]` of a dataset, or from the actuators of an MJCF file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from jaxid.base.errors import nearest, UsageError
from jaxid.base.numbers import is_finite, is_number
from jaxid.data.dataset import Controller, Dataset, ModelSpec, ParameterPrior
from jaxid.dynamics.effect import LONGEST_DELAY_S
from jaxid.robots.beside import rates_of
from jaxid.robots.drive_inputs import driven_by
from jaxid.robots.file_step import beyond_its_step
from jaxid.robots.free_joints import beside_free_joints
from jaxid.robots.tree import Tree


#: Numbers of a law per joint, and what they are where nothing is stated.
NUMBERS = {
    "kp": 0.0,
    "kd": 0.0,
    "ki": 0.0,
    "gain": 1.0,
    "saturation": np.inf,
    "offset": 0.0,
    "delay": 0.0,
}
NEEDED = {"pd": ("kp", "kd"), "pid": ("kp", "ki", "kd"), "cascade": ("kp", "kv")}
VELOCITIES = ("difference", "averaged_difference", "measured")
#: Words and lists of [controller] that are no numbers per joint.
OTHER = (
    "velocity",
    "reference_velocity",
    "sample_time",
    "fit",
    "spread",
    "reference",
    "disturbance",
)
SPREAD = 0.1
#: A number of the law lies within this many standard deviations of what is stated, and is no less
#: than this share of it.
WITHIN, LEAST = 5.0, 0.01


class FittedGain(NamedTuple):
    """A number of a law that is fitted: bounds, and mean and standard deviation of its prior (`std`
    0: none).
    """

    name: str
    lower: float
    upper: float
    mean: float
    std: float

    @property
    def known(self) -> ParameterPrior:
        prior = {"mean": self.mean, "std": self.std} if self.std else None
        return ParameterPrior(None, self.lower, self.upper, prior=prior)


@dataclass(frozen=True)
class DriveLaw:
    """A drive law of n joints. `period` s, 0 where it is continuous; `control` limits of the goal;
    `lag` s of the torque; `rates` channels of the goals' rates; `fit` names of the numbers that are
    fitted and `spread` the relative standard deviation of their priors.
    """

    origin: str
    kind: str
    kp: tuple[float, ...]
    kd: tuple[float, ...]
    ki: tuple[float, ...]
    gain: tuple[float, ...]
    lowest: tuple[float, ...]
    highest: tuple[float, ...]
    offset: tuple[float, ...]
    delay: tuple[float, ...]
    lag: tuple[float, ...]
    control: tuple[tuple[float, float], ...] = ()
    velocity: str = "measured"
    rate: bool = False
    period: float = 0.0
    rates: tuple[str, ...] = ()
    fit: tuple[str, ...] = ()
    spread: tuple[tuple[str, float], ...] = field(default=())

    @property
    def delayed(self) -> bool:
        return "delay" in self.fit or any(self.delay)

    @property
    def undriven(self) -> tuple[int, ...]:
        """Joints at which it does nothing."""
        gains = np.abs([self.kp, self.kd, self.ki]).sum(0)
        return tuple(np.flatnonzero(gains == 0).tolist())

    @property
    def nameless(self) -> DriveLaw:
        """The law without numbers and names: those are told to a program."""
        none: tuple[float, ...] = ()
        return DriveLaw(
            origin="",
            kind=self.kind,
            kp=none,
            kd=none,
            ki=none,
            gain=none,
            lowest=none,
            highest=none,
            offset=none,
            delay=none,
            lag=none,
        )

    @property
    def numbers(self) -> dict[str, np.ndarray]:
        """Fields of a `PositionLaw`."""
        return {
            k: np.array(getattr(self, k))
            for k in ("kp", "kd", "ki", "gain", "lowest", "highest", "offset")
        }

    @property
    def words(self) -> dict[str, Any]:
        return {k: getattr(self, k) for k in ("kind", "velocity", "rate", "period", "control")} | {
            "recorded": bool(self.rates)
        }

    def torque(
        self,
        t: np.ndarray,
        goal: np.ndarray,
        q: np.ndarray,
        rate: np.ndarray | None = None,
        held: bool = True,
    ) -> np.ndarray:
        """Torque that the law asks for along a recording (t [time]; goal, q and the goal's recorded
        rate [time n]).

        What is `held` between samples jumps at each: the torque is the mean of both sides, so that
        a low-pass finds it in phase.
        """
        if self.kind == "pid":
            raise UsageError(
                "the torque of a pid law is not known without its integral's start; record the"
                " torque, or fit instead"
            )
        number = {k: np.array(v) for k, v in self.numbers.items()}
        jump = np.diff(t, prepend=t[0]) / 2 if held and self.period <= 0 else 0.0
        late = _at(t, t[:, None] - np.array(self.delay) - np.reshape(jump, (-1, 1)), goal)
        wanted = self._wanted(t, late, rate, jump)
        speed = self._speed(t, q)
        if self.kind == "cascade":
            v = number["kd"] * (number["kp"] * (late - q) + wanted - speed)
        else:
            v = number["kp"] * (late - q) + number["kd"] * (wanted - speed)
        tau = number["gain"] * np.clip(v + number["offset"], number["lowest"], number["highest"])
        return (
            _at(t, np.tile(t - self.period / 2, (q.shape[1], 1)).T, tau) if self.period > 0 else tau
        )

    def _speed(self, t: np.ndarray, q: np.ndarray) -> np.ndarray:
        if self.velocity == "measured":
            return np.gradient(q, t, axis=0)
        back = (1 if self.velocity == "difference" else 2) * self.period
        return (q - _at(t, np.tile(t - back, (q.shape[1], 1)).T, q)) / back

    def _wanted(
        self, t: np.ndarray, late: np.ndarray, rate: np.ndarray | None, jump: Any
    ) -> np.ndarray:
        if rate is not None:
            return _at(t, t[:, None] - np.array(self.delay) - np.reshape(jump, (-1, 1)), rate)
        if not self.rate:
            return np.zeros_like(late)
        return (late - _at(t, np.tile(t - self.period, (late.shape[1], 1)).T, late)) / self.period

    def size(self, error: np.ndarray) -> np.ndarray:
        """Torque that position errors [samples n] ask for, 99th percentile."""
        kp = np.abs(
            np.array(self.kp)
            * np.array(self.gain)
            * (np.array(self.kd) if self.kind == "cascade" else 1.0)
        )
        return np.minimum(
            np.percentile(np.abs(error), 99, axis=0) * kp,
            np.abs(np.array(self.highest) * np.array(self.gain)),
        )

    def fitted(self, joints: Sequence[str]) -> tuple[FittedGain, ...]:
        """What is fitted: a stated number has a Gaussian prior of its spread, one that is stated as
        0 none.
        """
        out = []
        for name in self.fit:
            field = {"kv": "kd", "saturation": "highest"}.get(name, name)
            spread = dict(self.spread).get(name, SPREAD)
            for joint, value in zip(joints, getattr(self, field), strict=True):
                lower, upper, std = 0.0, self._room(name), 0.0
                if value != 0 and np.isfinite(value):
                    lower, upper = sorted(
                        (value * max(LEAST, 1 - WITHIN * spread), value * (1 + WITHIN * spread))
                    )
                    std = abs(value) * spread
                if name == "delay":
                    lower, upper = 0.0, LONGEST_DELAY_S
                out.append(FittedGain(f"{field}@{joint}", lower, upper, value if std else 0.0, std))
        return tuple(out)

    def _room(self, name: str) -> float:
        """Upper bound of a number that is stated as 0: damping that stops a joint within seconds,
        an integral within 0.01 s.
        """
        kp = max(map(abs, self.kp)) or 1.0
        return {"delay": LONGEST_DELAY_S, "kd": kp, "kv": kp, "ki": 100 * kp, "kp": 1e4}.get(
            name, 1e4
        )

    @property
    def text(self) -> str:
        def listed(a):
            return ", ".join(f"{x:g}" for x in dict.fromkeys(a))

        stated = "; ".join(
            f"{k} = {listed(a)}"
            for k, a in (("kp", self.kp), ("kd", self.kd), ("ki", self.ki))
            if any(a)
        )
        when = "continuous" if self.period <= 0 else f"every {self.period:g} s"
        rate = (
            "the goal's rate less the joint's"
            if self.rate or any(self.rates)
            else "the joint's own rate"
        )
        rates = f", on {rate}" if any(self.kd) else ""
        return f"driven by the {self.kind} law of {self.origin} ({stated}{rates}; {when})"


def _at(t: np.ndarray, when: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Series x [time n] between its samples at times `when` [time n], as at the first one before
    it.
    """
    return np.stack([np.interp(w, t, column) for w, column in zip(when.T, x.T, strict=True)], 1)


def stated_law(controller: Controller, joints: Sequence[str], period: float) -> DriveLaw:
    """The law that a dataset states, for these joints; `period` s between the samples of the
    recording.

    Raises `UsageError` for an unknown kind or setting, a gain that is missing, and a joint or
    number that does not exist.
    """
    kind, settings = controller.kind, dict(controller.settings)
    _check_settings(kind, settings)

    def number(key):
        return per_joint(settings, key, NUMBERS.get(key, 0.0), joints)

    saturation, gain, delay = number("saturation"), number("gain"), number("delay")
    if min(saturation) <= 0 or 0.0 in gain:
        raise UsageError("[controller]: saturation is positive, gain is not zero")
    if min(delay) < 0 or max(delay) > LONGEST_DELAY_S:
        raise UsageError(
            f"[controller]: delay is {settings['delay']!r}; it is from 0 to {LONGEST_DELAY_S:g} s"
        )
    every = settings.get("sample_time", period)
    if not isinstance(every, int | float) or every < 0:
        raise UsageError(
            f"[controller]: sample_time is {every!r}; it is a number of seconds, 0 where the law is"
            " continuous"
        )
    velocity, rate, rates = _words(settings, float(every), kind, joints)
    fit: Any = settings.get("fit", ())
    fit = (fit,) if isinstance(fit, str) else tuple(fit)
    can = (*NEEDED[kind], "saturation", "delay")
    for name in fit:
        if name not in can:
            raise UsageError(
                f"[controller]: fit names {name!r}{nearest(name, can)}; it takes {', '.join(can)}"
            )
    spread = _spread(settings.get("spread", {}), can)
    n = len(joints)
    return DriveLaw(
        origin="[controller]",
        kind=kind,
        kp=number("kp"),
        kd=number("kv" if kind == "cascade" else "kd"),
        ki=number("ki"),
        gain=gain,
        lowest=tuple(-s for s in saturation),
        highest=saturation,
        offset=number("offset"),
        delay=delay,
        lag=(0.0,) * n,
        control=(),
        velocity=velocity,
        rate=rate,
        period=float(every),
        rates=rates,
        fit=fit,
        spread=tuple(spread.items()),
    )


def _check_settings(kind: str, settings: Mapping[str, Any]) -> None:
    """Refuses an unknown kind or setting, one that is missing, and a disturbance."""
    if kind not in NEEDED:
        raise UsageError(f"there is no controller of kind {kind!r}{nearest(kind, NEEDED)}")
    needed = NEEDED[kind]
    allowed = (*needed, *(k for k in NUMBERS if k not in ("kp", "kd", "ki")), *OTHER)
    for key in settings:
        if key not in allowed:
            raise UsageError(
                f"[controller]: kind {kind!r} has no setting {key!r}{nearest(key, allowed)}"
            )
    for key in needed:
        if key not in settings:
            raise UsageError(
                f"[controller]: kind {kind!r} needs {' and '.join(needed)}; {key!r} is missing"
            )
    if settings.get("disturbance"):
        raise UsageError(
            "[controller]: a disturbance is not simulated where the goal drives; make the goals"
            " auxiliary channels"
        )


def _spread(stated: Any, can: Sequence[str]) -> dict[str, float]:
    """The relative standard deviation of each number of a law; a plain number is that of all of
    them.
    """
    spread: dict[str, Any] = (
        dict(stated) if isinstance(stated, Mapping) else {name: stated for name in can}
    )
    for name, value in spread.items():
        if name not in can or not (is_finite(value) and value > 0):
            raise UsageError(
                f"[controller]: spread is {stated!r}; it is a positive number for all that is"
                f" fitted, or a table of them for {', '.join(can)}"
            )
    return {name: float(value) for name, value in spread.items()}


def _words(
    settings: Mapping[str, Any], period: float, kind: str, joints: Sequence[str]
) -> tuple[str, bool, tuple[str, ...]]:
    """(velocity, whether the goal's rate is its difference, channels of that rate)."""
    velocity = settings.get("velocity", "difference" if period > 0 else "measured")
    if velocity not in VELOCITIES:
        raise UsageError(
            f"[controller]: velocity = {velocity!r} is unknown{nearest(str(velocity), VELOCITIES)}"
        )
    if period <= 0 and velocity != "measured":
        raise UsageError(
            f"[controller]: a continuous law (sample_time = 0) has no {velocity}: write velocity ="
            ' "measured"'
        )
    wanted = settings.get(
        "reference_velocity", "none" if period <= 0 or kind == "cascade" else "difference"
    )
    if wanted not in ("none", "difference"):
        return velocity, False, rates_of(wanted, joints)
    if period <= 0 and wanted != "none":
        raise UsageError(
            "[controller]: a continuous law (sample_time = 0) has no difference: write"
            ' reference_velocity = "none"'
        )
    return velocity, wanted == "difference", ()


def per_joint(
    settings: Mapping[str, Any], key: str, default: float, joints: Sequence[str]
) -> tuple[float, ...]:
    """A number for all joints, a list in their order, or a table by name."""
    value = settings.get(key, default)
    if isinstance(value, Mapping):
        for name in value:
            if name not in joints:
                raise UsageError(f"[controller]: {key} names {name!r}{nearest(str(name), joints)}")
        lacking = [j for j in joints if j not in value]
        if lacking and key in ("kp", "kd", "ki", "kv"):
            raise UsageError(f"[controller]: {key} states no number for {', '.join(lacking)}")
        values = [value.get(j, default) for j in joints]
    else:
        values = (
            list(value)
            if isinstance(value, Sequence) and not isinstance(value, str)
            else [value] * len(joints)
        )
    if len(values) != len(joints) or not all(map(is_number, values)):
        raise UsageError(
            f"[controller]: {key} is {value!r}; it is a number, a list of {len(joints)} (in the"
            f" order {', '.join(joints)}), or a table by joint"
        )
    return tuple(map(float, values))


def file_law(tree: Tree, joints: Sequence[str]) -> DriveLaw:
    """The law of the file's position actuators of these joints. Raises `UsageError` naming one that
    has none.
    """
    lacking = [j for j in joints if j not in tree.actuators or tree.actuators[j].kind != "position"]
    if lacking:
        raise UsageError(
            f"{tree.title} states no position actuator for {', '.join(lacking)}:"
            ' state the law that turns goals into torque under [controller] (kind = "pd", kp,'
            " kd), or give torques as NAME_tau"
        )
    own = [tree.actuators[j] for j in joints]
    control = tuple(a.control for a in own)
    return DriveLaw(
        origin=tree.file or "the file",
        kind="pd",
        kp=tuple(a.kp for a in own),
        kd=tuple(a.kd for a in own),
        ki=(0.0,) * len(own),
        gain=(1.0,) * len(own),
        lowest=tuple(a.force[0] for a in own),
        highest=tuple(a.force[1] for a in own),
        offset=tuple(a.offset for a in own),
        delay=tuple(a.delay for a in own),
        lag=tuple(a.lag for a in own),
        control=control if np.isfinite(control).any() else (),
    )


def law_of(tree: Tree, dataset: Dataset) -> DriveLaw:
    """The law under which goals drive: that of the dataset, else that of the file."""
    first = dataset.to_fit[0]
    period = float(np.median(np.diff(first.t)))

    def of(joints: list[str]) -> DriveLaw:
        if dataset.controller is None:
            return file_law(tree, joints)
        return stated_law(dataset.controller, joints, period)

    return beside_free_joints(tree, dataset, of)


def simulator_of(robot: Any, tree: Tree, law: DriveLaw | None, spec: ModelSpec) -> str:
    """Whose steps simulate a robot: those that the dataset states, else under goals the file's own
    where they are known.
    """
    if spec.simulator is not None:
        return spec.simulator
    goals_by_its_steps = law is not None and not beyond_its_step(tree, law)
    return "mujoco" if robot.integrator or goals_by_its_steps else "own"


def stepped(robot: Any, tree: Tree, dataset: Dataset) -> bool:
    """Whether contacts are asked for and a robot is simulated in MuJoCo's steps, as far as its
    drive is stated yet.
    """
    if not asked_for_contacts(dataset):
        return False
    try:
        goals = driven_by(tree.driven, dataset) == "goal"
        law = law_of(tree, dataset) if goals else None
    except UsageError:  # is said by who needs the drive
        return False
    return simulator_of(robot, tree, law, dataset.stated) == "mujoco"


def asked_for_contacts(dataset: Dataset) -> bool:
    """Whether [model] contacts is true."""
    return dataset.stated.contacts is True
