"""What makes code hard to see and to change, counted over the package.

    python tests/measure_house.py           # prints the figures
    python tests/measure_house.py --write   # writes them into CONTRIBUTING.md

A decision is an if, for, while, except, with or assert, a ternary, a comprehension, and each further
`and` or `or`. For comparison, decisions per 100 lines of functions: optimistix 2.8, diffrax 8.8,
mujoco.sysid 10.8.
"""

from __future__ import annotations

import ast
import re
import sys
from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path


ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "jaxid"
PAGE = ROOT / "CONTRIBUTING.md"
BEGIN, END = "<!-- figures -->", "<!-- end of figures -->"
BRANCHES = (
    ast.If,
    ast.For,
    ast.While,
    ast.ExceptHandler,
    ast.IfExp,
    ast.comprehension,
    ast.Assert,
    ast.With,
)
COMPREHENSIONS = (ast.ListComp, ast.GeneratorExp, ast.SetComp, ast.DictComp)
Comprehension = ast.ListComp | ast.GeneratorExp | ast.SetComp | ast.DictComp
#: Decisions of one function, positional arguments of one call, and columns of a line beyond which each counts.
MANY_DECISIONS, MANY_ARGUMENTS, COLUMNS = 15, 8, 100
#: What a table of thresholds says where the case that set one is not known.
NO_CASE = "not recorded"
WITHOUT_CASE = "thresholds without a recorded case"
DENSITY = "decisions per 100 lines of functions"


def effect_ids() -> set[str]:
    """Ids of the effects, read from their files."""
    found = set()
    for path in (ROOT / "models" / "effects").glob("*.py"):
        found |= set(re.findall(r'^\s+(?:name|id): .*?= "([a-z_]+)"', path.read_text(), re.M))
    return found


def decisions(function: ast.AST) -> int:
    """Decisions within a function, those of functions inside it too."""
    count = 0
    for node in ast.walk(function):
        count += isinstance(node, BRANCHES)
        if isinstance(node, ast.BoolOp):
            count += len(node.values) - 1
    return count


def nested(comprehension: Comprehension) -> bool:
    """Whether a comprehension holds another one, a choice, or a second loop."""
    for node in ast.walk(comprehension):
        if node is not comprehension and isinstance(node, (*COMPREHENSIONS, ast.IfExp)):
            return True
    return len(comprehension.generators) > 1


def _of_text(text: str) -> Iterator[tuple[str, int]]:
    long = [line for line in text.splitlines() if len(line) > COLUMNS]
    yield "lines", text.count("\n")
    yield "fmt: skip", text.count("# fmt: skip")
    yield "lines over 100 columns", len(long)


def _of_node(node: ast.AST) -> Iterator[tuple[str, int]]:
    if isinstance(node, ast.FunctionDef):
        count = decisions(node)
        yield "functions", 1
        yield "decisions", count
        yield "function lines", (node.end_lineno or node.lineno) - node.lineno + 1
        yield "functions of more than 15 decisions", count > MANY_DECISIONS
    elif isinstance(node, ast.Call):
        yield "calls with 8 or more positional arguments", len(node.args) >= MANY_ARGUMENTS
    elif isinstance(node, COMPREHENSIONS):
        yield "comprehensions with a loop or choice inside", nested(node)
    elif isinstance(node, ast.Assign) and isinstance(node.value, ast.Lambda):
        yield "named lambdas", 1
    elif isinstance(node, ast.Constant) and node.value == NO_CASE:
        yield WITHOUT_CASE, 1


@cache
def sources(package: Path) -> list[tuple[Path, str, ast.Module]]:
    """Path, text and tree of each file."""
    found = []
    for path in sorted(package.rglob("*.py")):
        text = path.read_text()
        found.append((path, text, ast.parse(text)))
    return found


def quoted_ids(package: Path = PACKAGE) -> set[str]:
    """Ids of effects that stand as texts in the code of the package, but for the benchmark: its
    twins are written apart and say what they withhold.
    """
    ids = effect_ids()
    found = set()
    for path, _, tree in sources(package):
        if path.parent == package / "benchmark":
            continue
        for node in ast.walk(tree):
            if isinstance(node, ast.Constant) and node.value in ids:
                found.add(node.value)
    return found


def figures(package: Path = PACKAGE) -> dict[str, float]:
    """The counts, by what they count."""
    count: Counter[str] = Counter({WITHOUT_CASE: 0})
    classes: Counter[str] = Counter()
    for _, text, tree in sources(package):
        count["files"] += 1
        for name, number in _of_text(text):
            count[name] += number
        for node in ast.walk(tree):
            for name, number in _of_node(node):
                count[name] += number
            if isinstance(node, ast.ClassDef):
                classes[node.name] += 1
    twice = [name for name, number in classes.items() if number > 1]
    density = 100 * count.pop("decisions") / count.pop("function lines")
    found: dict[str, float] = {DENSITY: round(density, 1), **count}
    found["class names in two or more modules"] = len(twice)
    found["effect ids quoted"] = len(quoted_ids(package))
    return found


def table(found: dict[str, float]) -> str:
    """The figures as a table of Markdown."""
    rows = [f"| {name} | {number:,} |" for name, number in found.items()]
    return "\n".join(["| counted over `jaxid/` | now |", "|---|---|", *rows])


def written(page: str, found: dict[str, float]) -> str:
    """The page with the figures in their place."""
    before, _, rest = page.partition(BEGIN)
    _, _, after = rest.partition(END)
    return f"{before}{BEGIN}\n{table(found)}\n{END}{after}"


if __name__ == "__main__":
    found = figures()
    if "--write" in sys.argv:
        PAGE.write_text(written(PAGE.read_text(), found))
    print(table(found))
