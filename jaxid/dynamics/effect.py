"""What a model can lack: the places where an effect acts, and what each kind may change."""

from __future__ import annotations

import abc
from collections.abc import Callable, Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, ClassVar, NamedTuple, Self, TypeVar

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from jaxid.dynamics.export_law import ExportLaw, StandsFor
from jaxid.dynamics.mechanism import Mechanism, Signature
from jaxid.dynamics.parameter import Quantity


#: Upper bound of every delay parameter of the library.
LONGEST_DELAY_S = 0.1


class Command(NamedTuple):
    """What arrives from the data at one step: `u` the mean input over the step under the channel's
    stated hold, `other` the same under the other hold (zero-order against linear), `delayed(d)` the
    mean input a time d earlier.
    """

    t: Array
    h: Array
    u: Float[Array, " nu"]
    other: Float[Array, " nu"]
    delayed: Callable[[Float[Array, " nu"]], Float[Array, " nu"]]

    def behind(self, late: Float[Array, " nu"]) -> Command:
        """What arrives where each input is `late`, s."""
        return self._replace(u=self.delayed(late), delayed=lambda d: self.delayed(d + late))


class Signals(NamedTuple):
    """What an effect may look at: the predicted middle of the step."""

    t: Array
    q: Float[Array, " nq"]
    qd: Float[Array, " nq"]
    load: Float[Array, " nq"]  # torque that the drive makes at the joint
    h: Array
    command: Command
    qd0: Float[Array, " nq"]  # joint speed at the step's beginning
    beside: Any = ()  # inputs that are no commands of joints, [k]
    #: Torque [nq] that what hangs on the joint takes, friction and rotors excluded; where an effect
    #: asks.
    transmitted: Any = 0.0
    #: Joint position at the step's beginning [nq]; None: half a step before `q`.
    q0: Any = None


class Effect(eqx.Module):
    """Abstract: one physical effect at one port.

    Class attributes of a final class: `name`, `equation`, `signature` (what it looks like in a
    residual), `source`, `excitation` (what to record to see it), `refines` (the effect without
    which it is not added, or ""), and `probes`: finite strengths for the screen, since some effects
    have zero derivative at their neutral value.
    """

    name: eqx.AbstractClassVar[str]
    equation: eqx.AbstractClassVar[str]
    signature: eqx.AbstractClassVar[str]
    source: eqx.AbstractClassVar[str]
    excitation: eqx.AbstractClassVar[str]
    probes: eqx.AbstractClassVar[tuple[dict[str, Quantity | float], ...]]
    refines: ClassVar[str] = ""
    contains: ClassVar[tuple[str, ...]] = ()  # other effects that it comprises
    location: eqx.AbstractClassVar[
        str
    ]  # "input" | "joint" | "output": the kind of place its parameters are counted by

    def transfer(
        self, omega: Float[Array, " lines"]
    ) -> tuple[Float[Array, "lines n"], Float[Array, "lines n"]] | None:
        """Real and imaginary part of what a linear effect at an input or output does to its n
        channels at omega, rad/s; None: nothing.
        """
        return None

    @classmethod
    def sampled(cls, period: float) -> Self:
        """The effect that does nothing yet, on commands that are recorded every `period` s."""
        return neutral(cls)

    #: Effects of one port act in the order of their stage, then as they were given: what happens to
    #: the command before it reaches the drive comes first, what edits a mechanism before what wraps
    #: it.
    stage: ClassVar[int] = 1
    #: Whether its torque at one joint depends on the speed of another.
    couples: ClassVar[bool] = False
    #: Effects that it may equal on some mechanism or at some of its numbers, however different they
    #: begin: one is compared with the other.
    resembles: ClassVar[tuple[str, ...]] = ()
    #: Effect at the other end of the plant that says the same of every recording where there is one
    #: input and one output, because no mechanism knows what time it is.
    mirrors: ClassVar[str] = ""
    #: What it is a law of: speed, position, load, command, acceleration, reading or time.
    axis: ClassVar[str] = ""
    #: Where it acts (a clause), what it is in plain words, what to look for at the machine;
    #: `{parameter}` is its number with its unit, `{parameter:%}` a share.
    seen: ClassVar[str] = ""
    plain: ClassVar[str] = ""
    check: ClassVar[str] = ""
    #: Those of these sentences that read otherwise on a slide, which has no turns.
    on_slide: ClassVar[Mapping[str, str]] = MappingProxyType({})
    #: The range of that variable in which it acts, from its numbers (None: an open end); None: the
    #: whole of it.
    span: ClassVar[Callable[[dict[str, float]], tuple[float | None, float | None]] | None] = None
    #: Whether a diagnosis that was given no candidates asks it only where the others leave the
    #: answer open: a law that comprises simpler ones, or one that has to be searched for.
    last_resort: ClassVar[bool] = False
    #: At which of its places it makes sense on a mechanism; None: at all.
    offered: ClassVar[Callable[[Mechanism, Signature], tuple[str, ...]] | None] = None
    #: Strengths at which the conformance tests compare it with its equation; (): the first probes.
    examples: ClassVar[tuple[dict[str, Quantity | float], ...]] = ()
    #: What it acts on: timing, command, drive (the torque that it makes), joint, body, sensor or
    #: number.
    acts_on: ClassVar[str] = ""
    #: The number of a robot's file that it is.
    stands_for: ClassVar[StandsFor | None] = None
    #: How an export writes it where no number of the file says it; or why no code beside a
    #: simulator can be it.
    export_law: ClassVar[ExportLaw | str] = ""
    #: Whether what it does along a measured motion depends on the torque that the model needs
    #: there.
    by_torque: ClassVar[bool] = False

    @classmethod
    def quantity(cls) -> str:
        """What of a robot's file it is, "" where it is no number of it."""
        return "" if cls.stands_for is None else cls.stands_for.quantity


#: Effects of the user's own by their names, from when one is first given.
OWN_EFFECTS: dict[str, type[Effect]] = {}


AnEffect = TypeVar("AnEffect", bound=Effect)


def drives(mechanism: Mechanism, signature: Signature) -> tuple[str, ...]:
    """The inputs that are no mere switches or shares."""
    return tuple(name for name, unit in signature.commands if unit != "1")


class InputEffect(Effect):
    """Between command and joint: (u, signals, state) -> u, state."""

    location: ClassVar[str] = "input"
    acts_on: ClassVar[str] = "command"
    offered: ClassVar = staticmethod(drives)
    #: Key of a channel in a dataset that states the same.
    stated_as: ClassVar[str] = ""
    #: Missing torque [time n] by its one number, from the torque [time n] that the model needs and
    #: the step between samples, s; None: the torque of a measured motion does not show it.
    column: ClassVar[Callable[[np.ndarray, float], np.ndarray] | None] = None
    #: Whether it closes a loop: it is told what the encoders read in place of the joints'
    #: positions.
    reads_encoders: ClassVar[bool] = False

    def stiffness(self) -> Array | None:
        """How tightly it holds each joint where it stands at any moment, torque per position; None:
        not at all.
        """
        return None

    def settled(
        self,
        z: Any,
        u: Float[Array, " nu"],
        q: Float[Array, " nq"],
        hold: Callable[[], Float[Array, " nq"]],
    ) -> Any:
        """State `z` of a run that begins at positions q, which the joint torque hold() [nq]
        keeps.
        """
        return z

    def late(self) -> Array | None:
        """By how much it delays each command, s; None: not at all."""
        return None

    def known_gain(self) -> Array | None:
        """Joint torque that a drive is known to make of one unit of each command [nu]; None: it
        says nothing of that.
        """
        return None

    @abc.abstractmethod
    def __call__(
        self, u: Float[Array, " nu"], s: Signals, z: Any
    ) -> tuple[Float[Array, " nu"], Any]: ...

    @abc.abstractmethod
    def start(self, u: Float[Array, " nu"]) -> Any:
        """State after the input `u` has been held for long; () for an effect without state."""


class JointEffect(Effect):
    """At the joint: (signals, state) -> smooth opposing torque, dry levels (minus, plus) >= 0,
    state.
    """

    location: ClassVar[str] = "joint"
    acts_on: ClassVar[str] = "joint"

    #: Whether it looks at the transmitted torque, which a chain works out for such effects alone.
    transmits: ClassVar[bool] = False
    #: Start values (field -> number) read off the force that a measured motion (q, qd, force, each
    #: [samples]) lacks at its joint; None: the probes are start enough.
    read_off: ClassVar[Callable[[np.ndarray, np.ndarray, np.ndarray], dict[str, float]] | None] = (
        None
    )

    @abc.abstractmethod
    def __call__(self, s: Signals, z: Any) -> tuple[Any, Any, Any, Any]: ...

    @abc.abstractmethod
    def start(self, q: Float[Array, " nq"]) -> Any: ...


class BodyEffect(Effect):
    """Wraps or edits the mechanism: mechanism -> mechanism."""

    location: ClassVar[str] = "joint"
    acts_on: ClassVar[str] = "body"

    @abc.abstractmethod
    def __call__(self, mechanism: Mechanism) -> Mechanism: ...


class OutputEffect(Effect):
    """Between mechanism and record: (y, signals, state) -> y, state."""

    location: ClassVar[str] = "output"
    acts_on: ClassVar[str] = "sensor"

    @classmethod
    def is_offset(cls) -> bool:
        """Whether it adds to a reading what a loop that is closed through it is told too."""
        return cls.offset is not OutputEffect.offset

    def offset(self) -> Array | None:
        """By how much each reading is off at all times, which a loop that is closed through it is
        told too; None: not so.
        """
        return None

    @abc.abstractmethod
    def __call__(
        self, y: Float[Array, " ny"], s: Signals, z: Any
    ) -> tuple[Float[Array, " ny"], Any]: ...

    @abc.abstractmethod
    def start(self, y: Float[Array, " ny"], rate: Float[Array, " ny"]) -> Any:
        """State where the outputs have run straight for long, up to y, with this rate of change."""


class NumberEffect(Effect):
    """At numbers of the model, in time: (values [numbers] of all that are fitted, time and length
    of a step) -> values in it.
    """

    location: ClassVar[str] = "number"
    acts_on: ClassVar[str] = "number"

    @abc.abstractmethod
    def __call__(
        self, values: Float[Array, " numbers"], t: Float[Array, ""], h: Float[Array, ""]
    ) -> Float[Array, " numbers"]: ...


class Applied(Effect):
    """Stands in a chain for an effect whose numbers have been put in."""

    name: ClassVar[str] = "applied"
    equation: ClassVar[str] = ""
    signature: ClassVar[str] = ""
    source: ClassVar[str] = ""
    excitation: ClassVar[str] = ""
    location: ClassVar[str] = "joint"
    probes: ClassVar[tuple[dict[str, Quantity | float], ...]] = ()


class RecordEffect(Effect):
    """Between sensor and file: (times [time], series [time ny], the step's length where all are
    equal, rate of change before the series begins [ny]) -> series. The motion knows nothing of it.
    """

    location: ClassVar[str] = "output"
    acts_on: ClassVar[str] = "sensor"

    @abc.abstractmethod
    def __call__(
        self,
        t: Float[Array, " time"],
        y: Float[Array, "time ny"],
        h: Float[Array, ""] | None,
        rate: Float[Array, " ny"],
    ) -> Float[Array, "time ny"]: ...


def neutral(kind: Callable[..., AnEffect]) -> AnEffect:
    """An effect that does nothing: every parameter at its default."""
    return kind()


def chosen(flags: Sequence[bool], ones: Iterable[Any], others: Iterable[Any]) -> tuple:
    """Of each pair the first where its flag is set."""
    found = []
    for flag, one, other in zip(flags, ones, others, strict=True):
        found.append(one if flag else other)
    return tuple(found)
