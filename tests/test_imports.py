"""Which way imports point: from what is built on, never back up."""

from __future__ import annotations

import ast
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path

import numpy as np
from scipy.sparse.csgraph import connected_components


ROOT = Path(__file__).parents[1]

#: From the ground up. What stands in one line may import each other. A part of a package that is
#: built on more than the rest has a place of its own: a dataset is a plain value that robots are
#: matched with, but it is read against the model it states.
LAYERS = (
    ("base", "numerics", "runtime"),
    ("data",),
    ("dynamics", "models", "robots"),
    ("dynamics.catalogue",),
    ("data.importers", "data.io", "data.reading"),
    ("simulation",),
    ("force",),
    ("problem",),
    ("conventions",),
    ("fitting",),
    ("fitters",),
    ("identification",),
    ("excitation",),
    ("diagnosis",),
    ("report",),
    ("api",),
    ("benchmark", "hardware", "study", "view"),
    ("cli",),
    ("__main__",),
)
LEVEL = {name: level for level, names in enumerate(LAYERS) for name in names}
#: Methods by which a result exports and saves itself: a class is where a user looks for them. Only
#: they may import upward, when they are called. What shows a value is reached by
#: `jaxid.base.display` alone, what makes a dataset of arrays by `jaxid.base.reader`.
AT_HAND = {
    "export",
    "save",
}


@cache
def modules() -> list[tuple[str, ast.Module]]:
    found = []
    for top in ("jaxid", "models", "fitters"):
        for file in sorted((ROOT / top).rglob("*.py")):
            parts = file.relative_to(ROOT).with_suffix("").parts
            name = ".".join(parts[1:] if top == "jaxid" else parts)
            found.append((name, ast.parse(file.read_text())))
    return found


def imported(node: ast.AST) -> Iterator[str]:
    """The packages of jaxid, or parts of them with a place of their own, that an import statement
    names.
    """
    if isinstance(node, ast.Import):
        names = [a.name for a in node.names]
    elif isinstance(node, ast.ImportFrom) and not node.level:
        names = [f"{node.module}.{a.name}" for a in node.names]
    else:
        return
    yield from {
        place: None
        for name in names
        if (place := place_of(name.removeprefix("jaxid."))) and name.startswith("jaxid.")
    }


def place_of(module: str) -> str | None:
    """The package of a module, or the part of it that has a place of its own, in LAYERS."""
    parts = module.split(".")
    return next((name for n in (2, 1) if (name := ".".join(parts[:n])) in LEVEL), None)


def statements(node: ast.AST, inside: str | None = None) -> Iterator[tuple[ast.AST, str | None]]:
    """Import statements and the function that they stand in; those for type checkers alone are left
    out.
    """
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test):
            continue
        if isinstance(child, ast.Import | ast.ImportFrom):
            yield child, inside
        name = child.name if isinstance(child, ast.FunctionDef) and inside is None else inside
        yield from statements(child, name)


def upward() -> Iterator[tuple[str, str, str | None]]:
    for module, tree in modules():
        if (place := place_of(module)) is None:
            continue
        own = LEVEL[place]
        for node, inside in statements(tree):
            for package in imported(node):
                if LEVEL[package] > own:
                    yield module, package, inside


def test_every_package_has_a_layer():
    known = {m.split(".")[0] for m, _ in modules()} - {"__init__"}
    assert known - set(LEVEL) == set()


def test_no_module_imports_what_stands_on_it():
    assert {(m, p) for m, p, inside in upward() if inside is None} == set()


def test_methods_alone_import_upward_to_make_or_to_show_a_value():
    assert {
        (m, p, inside) for m, p, inside in upward() if inside is not None and inside not in AT_HAND
    } == set()


def test_no_private_name_is_imported():
    found = {
        (module, alias.name)
        for module, tree in modules()
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom)
        and node.module
        and (node.module.startswith("jaxid") or node.level)
        for alias in node.names
        if alias.name.startswith("_") and not alias.name.startswith("__")
    }
    assert found == set()


#: The most files that may lead back to each other, imports within functions counted. It may only fall.
CIRCLE = 9


def full_names() -> dict[str, tuple[bool, ast.Module]]:
    """Dotted name of each module -> whether it is a package, and its tree."""
    found = {}
    for module, tree in modules():
        top = module.split(".")[0]
        package = module.endswith("__init__")
        name = module.removesuffix("__init__").rstrip(".")
        if top in ("models", "fitters") or name:
            name = f"jaxid.{name}"
        found[name or "jaxid"] = (package, tree)
    return found


def named_by(node: ast.AST, module: str, package: bool, known: Iterable[str]) -> Iterator[str]:
    """Dotted names of the modules that an import statement of a module asks for."""
    if isinstance(node, ast.Import):
        yield from (alias.name for alias in node.names)
    if isinstance(node, ast.ImportFrom):
        base = node.module or ""
        if node.level:
            above = module.split(".") if package else module.split(".")[:-1]
            kept = above[: len(above) - node.level + 1]
            base = ".".join([*kept, *filter(None, [node.module])])
        for alias in node.names:
            below = f"{base}.{alias.name}"
            yield below if below in known else base


def test_the_circle_of_all_imports_only_shrinks():
    known = full_names()
    place = {name: k for k, name in enumerate(known)}
    arrows = np.zeros((len(known), len(known)), bool)
    for module, (package, tree) in known.items():
        for node, _ in statements(tree):
            for name in named_by(node, module, package, known):
                if name in place and name != module:
                    arrows[place[module], place[name]] = True
    _, label = connected_components(arrows, connection="strong")
    circles = np.bincount(label)
    names = [name for name, at in place.items() if label[at] == np.argmax(circles)]
    assert circles.max() <= CIRCLE, f"{circles.max()} files lead back to each other: {names}"
