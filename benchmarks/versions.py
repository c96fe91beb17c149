"""The shipped example and the core of tests with every Python found here and the versions of JAX;
writes docs/versions.md.

    python benchmarks/versions.py [--python 3.12] [--jax 0.9.2] [--no-tests]

One environment a Python (in out/versions), into which pip puts one JAX after the other, with what
pip chooses beside it. What was run stays in out/versions/rows.json until it is run again, so that a
part can be repeated.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import re
import subprocess
import time
import tomllib
from pathlib import Path
from typing import Any


ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "out" / "versions"
ROWS = FOLDER / "rows.json"
PAGE = ROOT / "docs" / "versions.md"
#: From the oldest version that is stated to the newest: of each 0.x the last, and the first ones
#: since programs have a new form.
JAX = ("0.7.2", "0.8.3", "0.9.2", "0.10.2", "0.11.0", "0.11.2", "0.12.0", "0.12.0.1")
BESIDE = ("equinox", "diffrax", "numpy", "scipy")
#: The command, with what our own code is told about its future as an error.
DIAGNOSE = r"""
import sys, warnings
warnings.filterwarnings("error", category=DeprecationWarning, module="jaxid")
from jaxid.cli.app import main
sys.exit(main())
"""
#: Largest deviation from the first row (standard deviations) that counts as equal.
EQUAL = 0.01


def interpreters() -> dict[str, str]:
    """Version -> interpreter."""
    found = subprocess.run(
        [ROOT / ".ci" / "pythons"], capture_output=True, text=True, check=True
    ).stdout.splitlines()
    asks = "import sys; print('%d.%d' % sys.version_info[:2])"
    return {
        subprocess.run(
            [p, "-c", asks], capture_output=True, text=True, check=True
        ).stdout.strip(): p
        for p in found
    }


def run(command: list[Any], cache: Path, timeout_s: float = 1800) -> tuple[int, str]:
    """Exit code, and what was said on both streams."""
    environment = {**os.environ, "JAXID_CACHE_DIR": str(cache), "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(
        list(map(str, command)),
        cwd=ROOT,
        env=environment,
        text=True,
        timeout=timeout_s,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
    )
    return done.returncode, done.stdout


def row(python: str, interpreter: str, jax: str, tests: bool) -> dict[str, Any]:
    """What one combination gives; `problem` says where it stopped."""
    environment, cache = FOLDER / f"python{python}", FOLDER / f"programs_{python}_{jax}"
    own, out = environment / "bin" / "python", FOLDER / f"{python}_{jax}"
    result: dict[str, Any] = {"python": python, "jax": jax}
    if not own.exists():
        run([interpreter, "-m", "venv", environment], cache)
    code, said = run(
        [
            own,
            "-m",
            "pip",
            "install",
            "-q",
            "--disable-pip-version-check",
            "-e",
            ".[test]",
            f"jax=={jax}",
        ],
        cache,
    )
    if code:
        none = "No matching distribution found for jax==" in said
        return {
            **result,
            "problem": f"no release for Python {python}"
            if none
            else f"pip: {said.strip().splitlines()[-1]}",
        }
    asks = "import json, sys; from importlib.metadata import version; print(json.dumps({n: version(n) for n in sys.argv[1:]}))"
    result["beside"] = json.loads(run([own, "-c", asks, *BESIDE], cache)[1])
    result["python_exact"] = run(
        [own, "-c", "import platform; print(platform.python_version())"], cache
    )[1].strip()
    began = time.perf_counter()
    code, said = run(
        [own, "-c", DIAGNOSE, "diagnose", "examples/servo_pendulum", "--out", out], cache
    )
    result["seconds"] = round(time.perf_counter() - began)
    if code:
        return {**result, "problem": f"exit {code}: {said.strip().splitlines()[-1][:200]}"}
    result["quick"] = "RuntimeWarning" not in said
    diagnosis = json.loads((out / "diagnosis.json").read_text())
    result |= {"verdict": diagnosis["which"]["verdict"], "numbers": numbers(diagnosis)}
    result["effects"] = [f"{e['effect']} at {e['location']}" for e in diagnosis["which"]["effects"]]
    if tests:
        core = re.findall(r"^CORE := (.*)$", (ROOT / "Makefile").read_text(), re.M)[0].split()
        code, said = run(
            [own, "-m", "pytest", "-q", "-p", "no:cacheprovider", *core],
            FOLDER / f"tests_{python}_{jax}",
        )
        ends = re.findall(r"(\d+ (?:passed|failed)[^\n]*?) in ", said)
        result["tests"] = (
            ends[-1] if ends else f"exit {code}: {said.strip().splitlines()[-1][:100]}"
        )
    return result


def numbers(diagnosis: dict[str, Any]) -> dict[str, list[float]]:
    """Value and standard deviation of every parameter."""
    groups = {
        "": diagnosis["parameters"],
        **{f"{e['effect']}.": e["parameters"] for e in diagnosis["which"]["effects"]},
    }
    return {
        group + name: [p["value"], p["std"]]
        for group, found in groups.items()
        for name, p in found.items()
    }


def deviation(found: dict[str, list[float]], reference: dict[str, list[float]]) -> float:
    """Largest difference of two answers in standard deviations; infinite where they name other
    numbers.
    """
    if found.keys() != reference.keys():
        return float("inf")
    return max(
        abs(value - reference[name][0]) / reference[name][1] for name, (value, _) in found.items()
    )


def page(rows: list[dict[str, Any]]) -> str:
    """The table as Markdown."""
    stated = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["dependencies"]
    bounds = next(d for d in stated if d.startswith("jax>"))
    reference = next(r for r in rows if "numbers" in r)
    lines = [
        "# Versions of Python and JAX",
        "",
        f"The package asks for Python 3.11 or newer and `{bounds}`; both bounds are versions that were run.",
        "With an older JAX every command stops at once and says what to type; with a newer one it warns and goes on.",
        "",
        "Each row is an environment as pip makes it with that JAX. It diagnoses the shipped example (`make demo`) from nothing,",
        "then runs the core of tests (`make test-core`) where the last column has a count. *Deviation* is the largest difference",
        f"of any parameter from the first row, in standard deviations; {EQUAL} and less count as equal. *Quick* says that the",
        "loop over time was laid out for vector code. Where a JAX writes its programs in a form that jaxid does not know,",
        "`jax.vmap` does the same more slowly and a warning says so. Seconds include all compiling, on a busy machine.",
        "",
        "| Python | JAX | equinox | diffrax | NumPy | SciPy | verdict | effect | deviation | quick | s | core tests |",
        "| --- " * 12 + "|",
    ]
    for r in rows:
        head = [
            r.get("python_exact", r["python"]),
            r["jax"],
            *(r.get("beside", {}).get(n, "") for n in BESIDE),
        ]
        if "problem" in r:
            lines.append("| " + " | ".join([*head, r["problem"], *[""] * 5]) + " |")
            continue
        far = deviation(r["numbers"], reference["numbers"])
        told = [
            r["verdict"],
            ", ".join(r["effects"]),
            f"{far:.1g}",
            "yes" if r["quick"] else "no",
            str(r["seconds"]),
        ]
        lines.append("| " + " | ".join([*head, *told, r.get("tests", "not run")]) + " |")
    done = [r for r in rows if "numbers" in r]
    alike = all(
        (r["verdict"], r["effects"]) == (reference["verdict"], reference["effects"]) for r in done
    )
    worst = max(deviation(r["numbers"], reference["numbers"]) for r in done)
    lines += [
        "",
        f"{'Verdict and effect are the same in all rows' if alike else 'Verdicts or effects DIFFER'}; the largest deviation is "
        f"{worst:.1g} standard deviations.",
        "",
        f"Run on {platform.system()} ({platform.machine()}) by `make test-versions` (`benchmarks/versions.py`).",
        "macOS and Windows: not run by us. `ur-rtde`, which moves a UR, has no wheel from Python 3.13 on: there it is not",
        "installed, motion of a UR says so, and everything else works, recording from a UR included.",
        "",
    ]
    return "\n".join(lines)


def order(r: dict[str, Any]) -> tuple:
    """Rows by JAX, newest first, then by Python."""
    return [-int(n) for n in (r["jax"] + ".0").split(".")[:4]], [
        int(n) for n in r["python"].split(".")
    ]


def run_all() -> None:
    found = interpreters()
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--python", action="append", choices=found, help="default: each that is found"
    )
    parser.add_argument("--jax", action="append", help=f"default: {', '.join(JAX)}")
    parser.add_argument("--no-tests", action="store_true", help="the example alone")
    arguments = parser.parse_args()
    FOLDER.mkdir(parents=True, exist_ok=True)
    for python in arguments.python or found:
        for jax in arguments.jax or JAX:
            new = row(python, found[python], jax, not arguments.no_tests)
            print(json.dumps({k: v for k, v in new.items() if k != "numbers"}), flush=True)
            rows = json.loads(ROWS.read_text()) if ROWS.exists() else []
            rows = sorted(
                [r for r in rows if (r["python"], r["jax"]) != (python, jax)] + [new], key=order
            )
            ROWS.write_text(json.dumps(rows, indent=1))
            if any("numbers" in r for r in rows):
                PAGE.write_text(page(rows))


if __name__ == "__main__":
    run_all()
