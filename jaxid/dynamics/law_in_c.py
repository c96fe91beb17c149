"""Expressions of effects in C, for plugins of simulators that run no Python."""

from __future__ import annotations

import ast
from collections.abc import Mapping

from jaxid.dynamics.export_law import ExportLaw, SIGNALS


#: Functions of one argument -> their names in `math.h`.
PLAIN = {
    "abs": "fabs",
    "cos": "cos",
    "exp": "exp",
    "log": "log",
    "sin": "sin",
    "sqrt": "sqrt",
    "tanh": "tanh",
}
OPERATORS = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/"}


def in_c(law: ExportLaw, numbers: Mapping[str, float]) -> str:
    """The expression of a law with its numbers put in, of doubles.

    Raises `ValueError` for what is neither arithmetic, a number, a signal of the port nor a
    function.
    """
    known = {name: name for name in SIGNALS[law.port]}
    known |= {name: _number(value) for name, value in numbers.items()}
    return _expression(ast.parse(law.text, mode="eval").body, known)


def _number(value: float) -> str:
    text = repr(float(value))
    return f"({text})" if text.startswith("-") else text


def _expression(node: ast.expr, known: Mapping[str, str]) -> str:
    if isinstance(node, ast.Constant) and isinstance(node.value, int | float):
        return _number(node.value)
    if isinstance(node, ast.Name) and node.id in known:
        return known[node.id]
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        return f"(-{_expression(node.operand, known)})"
    if isinstance(node, ast.BinOp):
        return _operation(node, known)
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
        return _call(node.func.id, [_expression(a, known) for a in node.args])
    raise ValueError(f"{ast.unparse(node)!r} cannot be written in C")


def _operation(node: ast.BinOp, known: Mapping[str, str]) -> str:
    left, right = _expression(node.left, known), _expression(node.right, known)
    if isinstance(node.op, ast.Pow):
        return f"pow({left}, {right})"
    if type(node.op) not in OPERATORS:
        raise ValueError(f"{ast.unparse(node)!r} cannot be written in C")
    return f"({left} {OPERATORS[type(node.op)]} {right})"


def _call(name: str, arguments: list[str]) -> str:
    if name == "sign" and len(arguments) == 1:
        (x,) = arguments
        return f"(({x} > 0) - ({x} < 0))"
    if name == "clip" and len(arguments) == 3:
        x, low, high = arguments
        return f"fmin(fmax({x}, {low}), {high})"
    if name in PLAIN and len(arguments) == 1:
        return f"{PLAIN[name]}({arguments[0]})"
    raise ValueError(f"{name}() cannot be written in C")
