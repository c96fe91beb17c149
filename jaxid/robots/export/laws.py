"""Code for what no field says: laws of effects as expressions that NumPy and PyTorch both run."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

from jaxid.robots.export.sheet import Change


class Law(NamedTuple):
    """`port`: force (opposes positive motion), dry (level of dry friction, where it moves),
    command, torque (of the drive) or reading; `text` an expression of the effect's numbers and of
    q, qd, load (drive torque), u or y; `state` one of `STATES`.
    """

    port: str
    text: str = ""
    state: str = ""


LAWS: Mapping[str, Law] = {
    "stribeck_friction": Law("dry", "{extra} * xp.exp(-(qd / {speed}) ** 2)"),
    "load_dependent_friction": Law("dry", "{mu} * abs(load)"),
    "position_dependent_friction": Law(
        "dry", "{sine} * xp.sin({order} * q) + {cosine} * xp.cos({order} * q)"
    ),
    "asymmetric_friction": Law("force", "{viscous} * abs(qd) + {dry} * abs(xp.sign(qd))"),
    "power_law_friction": Law(
        "force", "{coefficient} * (qd ** 2 + 1e-6) ** (({exponent} - 1) / 2) * qd"
    ),
    "torque_ripple": Law("force", "{sine} * xp.sin({order} * q) + {cosine} * xp.cos({order} * q)"),
    "viscous_friction": Law("force", "{coefficient} * qd"),
    "coulomb_friction": Law("dry", "{level} + 0 * q"),
    "quadratic_drag": Law("force", "{coefficient} * qd * abs(qd)"),
    "constant_torque": Law("force", "{torque} + 0 * q"),
    "spring_torque": Law("force", "{stiffness} * q"),
    "lugre_friction": Law("force", state="LuGre"),
    "hysteresis": Law("force", state="Hysteresis"),
    "temperature_dependent_friction": Law("force", state="Warmth"),
    "dead_zone": Law("command", "u - xp.clip(u, -{width}, {width})"),
    "supply_droop": Law("torque", "u * (1 - {droop} * abs(u))"),
    "torque_scale": Law("torque", "(1 + {gain}) * u"),
    "saturation": Law("torque", "xp.clip(u, -{limit}, {limit})"),
    "back_emf": Law("force", "{constant} * qd"),
    "input_delay": Law("command", state="Delay"),
    "actuator_lag": Law("command", state="Lag"),
    "sensor_bias": Law("reading", "y + {bias}"),
    "sensor_scale": Law("reading", "(1 + {gain}) * y"),
    "sensor_lag": Law("reading", state="Lag"),
    "sensor_delay": Law("reading", state="Delay"),
}

#: Classes with a memory; each is called once a step of `dt` s.
STATES: Mapping[str, str] = {
    "LuGre": '''class LuGre:
    """level (z + relaxation dz/dt), dz/dt = (qd - |qd| z) / presliding."""

    def __init__(self, level, presliding, relaxation=0.0):
        self.level, self.presliding, self.relaxation, self.z = level, presliding, relaxation, 0.0

    def __call__(self, q, qd, load, dt):
        x = qd * dt / self.presliding
        end = xp.sign(x) + (self.z - xp.sign(x)) * xp.exp(-abs(x))
        f = self.level * ((self.z + end) / 2 + self.relaxation * (end - self.z) / dt)
        self.z = end
        return f
''',
    "Hysteresis": '''class Hysteresis:
    """level z, dz/dq = (1 - |z|) / width where |z| grows, 1 / width where it falls."""

    def __init__(self, level, width):
        self.level, self.width, self.z = level, width, 0.0

    def __call__(self, q, qd, load, dt):
        x = qd * dt / self.width
        grows = (xp.sign(x) * self.z > 0) * 1.0
        before = self.z
        self.z = xp.clip(before + x * (1 - grows * abs(before)), -1, 1) + 0 * x
        return self.level * (before + self.z) / 2
''',
    "Warmth": '''class Warmth:
    """change warmth qd, time d(warmth)/dt = qd^2 - warmth; cold at the start."""

    def __init__(self, change, time):
        self.change, self.time, self.warmth = change, time, 0.0

    def __call__(self, q, qd, load, dt):
        self.warmth = self.warmth + (qd ** 2 - self.warmth) * min(1.0, dt / self.time)
        return self.change * self.warmth * qd
''',
    "Lag": '''class Lag:
    """First order, exact for a value that is held over the step."""

    def __init__(self, lag):
        self.lag, self.z = lag, None

    def __call__(self, value, dt):
        share = 1 - 2.718281828459045 ** (-dt / self.lag)
        self.z = value if self.z is None else self.z + (value - self.z) * share
        return self.z
''',
    "Delay": '''class Delay:
    """The value of `delay` s ago, linear between steps."""

    def __init__(self, delay):
        self.delay, self.past = delay, []

    def __call__(self, value, dt):
        self.past.insert(0, value)
        steps = self.delay / dt
        k = int(steps)
        del self.past[k + 2 :]
        old = lambda i: self.past[min(i, len(self.past) - 1)]
        return old(k) + (steps - k) * (old(k + 1) - old(k))
''',
}

PORTS = {
    "force": (
        "FORCE",
        "joint -> torque against positive motion: subtract it from the joint's torque",
    ),
    "dry": (
        "DRY",
        "joint -> level of dry friction beside the file's own: |f| <= level while the joint sticks, level sign(qd) else",
    ),
    "command": ("COMMAND", "channel -> what arrives of a command u"),
    "torque": ("TORQUE", "channel -> what arrives of a drive torque u"),
    "reading": ("READING", "channel -> what the sensor says of a true value y"),
}


def described(effect: str) -> str:
    """The law in words of the code."""
    law = LAWS[effect]
    return (
        law.text.replace("{", "").replace("}", "").replace("xp.", "")
        if law.text
        else STATES[law.state].split('"""')[1]
    )


def code(changes: Iterable[Change], head: str, tail: str = "", library: str = "numpy") -> str:
    """A Python module with the laws of these changes: tables FORCE, DRY, COMMAND, TORQUE,
    READING.
    """
    tables: dict[str, list[str]] = {port: [] for port in PORTS}
    states: dict[str, None] = {}
    for c in changes:
        law = LAWS[c.quantity]
        numbers = {k: repr(float(v)) for k, v in c.value.items()}
        key = c.place if law.port in ("force", "dry") else c.location
        tables[law.port].append(f"    ({key!r}, {_term(law, numbers)}),  # {c.effect}")
        if law.state:
            states[law.state] = None
    body = [f'"""{head}\n"""\n', f"import {library} as xp\n"]
    body += [f"\n{STATES[name]}" for name in states]
    for port, (name, meaning) in PORTS.items():
        if tables[port]:
            body.append(f"\n#: {meaning}\n{name} = [\n" + "\n".join(tables[port]) + "\n]\n")
    return "\n".join(body) + tail


def _term(law: Law, numbers: Mapping[str, str]) -> str:
    if law.state:
        return f"{law.state}({', '.join(f'{k}={v}' for k, v in numbers.items())})"
    arguments = {"force": "q, qd, load, dt", "dry": "q, qd, load, dt", "reading": "y, dt"}.get(
        law.port, "u, dt"
    )
    return f"lambda {arguments}: {law.text.format(**_Lacking(numbers))}"


class _Lacking(dict):
    """Numbers of which one that a result lacks is the neutral 0."""

    def __missing__(self, key: str) -> Any:
        return "0.0"


def lawful(changes: Iterable[Change]) -> list[Change]:
    """Those changes that have code and a place."""
    return [c for c in changes if c.quantity in LAWS and c.place and isinstance(c.value, Mapping)]
