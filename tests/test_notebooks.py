"""Every notebook runs from its first cell to its last, with the small budgets, and shows what it
says it shows.
"""

from __future__ import annotations

import ast
import sys
from pathlib import Path

import pytest


ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "notebooks"
NAMES = sorted(
    p.stem for p in FOLDER.glob("*.py") if p.stem not in ("budget", "recording")
)  # recording: test_hardware_end_to_end

#: Run by `make test`; the others take minutes of compiling and are run by `make test-all`, `make
#: notebooks` and `make docs`.
QUICK = ("00_tour", "diagnose_your_robot")

jupytext = pytest.importorskip("jupytext")


def test_notebooks_are_text_in_the_percent_format():
    assert (
        "/notebooks/*.ipynb" in (ROOT / ".gitignore").read_text().split()
    )  # what a user makes of them stays out
    for name in NAMES:
        book = jupytext.read(FOLDER / f"{name}.py")
        assert book.metadata["kernelspec"]["name"] == "python3", name
        assert book.cells[0].cell_type == "markdown" and book.cells[0].source.startswith("# "), name
        assert [c for c in book.cells if c.cell_type == "code"], name


@pytest.mark.timeout(900)
@pytest.mark.parametrize(
    "name", [n if n in QUICK else pytest.param(n, marks=pytest.mark.slow) for n in NAMES]
)
def test_notebook(name, monkeypatch):
    """Cell by cell as Jupyter does it: the last expression of a cell is shown."""
    pytest.importorskip("IPython")
    from matplotlib import pyplot

    monkeypatch.setenv("JAXID_NOTEBOOKS", "small")
    monkeypatch.chdir(FOLDER)
    monkeypatch.setattr(sys, "path", [str(FOLDER), *sys.path])
    monkeypatch.delitem(sys.modules, "budget", raising=False)
    pyplot.switch_backend("Agg")
    space: dict = {"__name__": "__main__"}
    shown = 0
    try:
        for number, cell in enumerate(jupytext.read(FOLDER / f"{name}.py").cells):
            if cell.cell_type != "code":
                continue
            tree = ast.parse(cell.source)
            last = tree.body.pop() if tree.body and isinstance(tree.body[-1], ast.Expr) else None
            where = f"{name}.py, cell {number}"
            exec(compile(tree, where, "exec"), space)
            if isinstance(last, ast.Expr):
                value = eval(compile(ast.Expression(last.value), where, "eval"), space)
                shown += bool(getattr(value, "_repr_html_", lambda: repr(value))())
            for figure in map(pyplot.figure, pyplot.get_fignums()):
                for axes in figure.axes:  # every picture says what its axes hold
                    assert not axes.axison or axes.get_xlabel() or axes.get_ylabel(), where
                figure.canvas.draw()
                shown += 1
            pyplot.close("all")
    finally:
        pyplot.close("all")
        sys.modules.pop("budget", None)
    assert shown >= 3


def test_notebooks_and_budgets_name_the_same_things():
    """Every cell compiles, and every setting of the budgets is used by a notebook: one that is not
    is a leftover.
    """
    sources = {p.stem: p.read_text(encoding="utf-8") for p in FOLDER.glob("*.py")}
    for name, source in sources.items():
        compile(source, name, "exec")
    settings = {
        target.id
        for node in ast.walk(ast.parse(sources.pop("budget")))
        if isinstance(node, ast.Assign)
        for group in node.targets
        for target in ast.walk(group)
        if isinstance(target, ast.Name)
    }
    text = "\n".join(sources.values())
    assert {s for s in settings if s not in text and s != "ROOT"} == set()
