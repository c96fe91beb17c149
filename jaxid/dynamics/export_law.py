"""How an effect is written into a simulator: the number of a robot's file that it stands for, or an
expression that is printed as code.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple


#: Port -> the signals that an expression there may use: position and speed of the joint, torque of
#: its drive, a command or torque `u`, a true reading `y`.
SIGNALS: Mapping[str, tuple[str, ...]] = {
    "force": ("q", "qd", "load"),
    "dry": ("q", "qd", "load"),
    "command": ("u",),
    "torque": ("u",),
    "reading": ("y",),
}
#: What an expression may call, as NumPy and PyTorch have it; `abs` is Python's.
FUNCTIONS = ("abs", "clip", "cos", "exp", "log", "sign", "sin", "sqrt", "tanh")


class ExportLaw(NamedTuple):
    """`port`: force (opposes positive motion), dry (level of dry friction, where it moves),
    command, torque (of the drive) or reading. `text`: an expression of the effect's numbers by
    their names, of the port's `SIGNALS` and of `FUNCTIONS`. What remembers has a class in its
    place: `memory` is its text; it is made with the effect's numbers and called once a step with
    the signals and the step `dt`, s.
    """

    port: str
    text: str = ""
    memory: str = ""

    @property
    def words(self) -> str:
        """The law as a reader is told it."""
        return self.text or self.memory.split('"""')[1]


class StandsFor(NamedTuple):
    """The number of a robot's file that an effect's `number` is.

    `quantity`: a number of the joint (`damping`, `armature`, ...), `force` (its limits),
    `inertial` (a body) or `gravity`. `fitted`: what a fit of the robot calls it, where the effect
    is a law that the robot itself has. Else it acts beside: `after(joint, value, driven)` gives
    numbers of the joint from those before; `driven`: whether goals drive, by a law. `note`: what
    is to be said of it where they do not.
    """

    quantity: str
    number: str
    fitted: str = ""
    after: Callable[[Any, float, bool], dict[str, float]] | None = None
    note: str = ""


def in_python(law: ExportLaw, numbers: Mapping[str, float], library: str = "xp") -> str:
    """The expression with its numbers put in, for a module that imports `library`.

    Raises `ValueError` for a name that is neither a number, a signal of the port nor a function.
    """
    printed = _Printed(SIGNALS[law.port], numbers, library)
    return ast.unparse(printed.visit(ast.parse(law.text, mode="eval")))


class _Printed(ast.NodeTransformer):
    """Names as they stand in the code."""

    def __init__(self, signals: tuple[str, ...], numbers: Mapping[str, float], library: str):
        self.signals, self.numbers, self.library = signals, numbers, library

    def visit_Name(self, node: ast.Name) -> ast.expr:
        if node.id in self.numbers:
            return _literal(float(self.numbers[node.id]))
        if node.id in self.signals or node.id == "abs":
            return node
        if node.id in FUNCTIONS:
            return ast.Attribute(ast.Name(self.library), node.id)
        raise ValueError(f"{node.id!r} is not a number of the effect, no signal and no function")


def _literal(value: float) -> ast.expr:
    if value < 0:
        return ast.UnaryOp(ast.USub(), ast.Constant(-value))
    return ast.Constant(value)
