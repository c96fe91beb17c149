"""Packages that only some commands need: a command whose package is missing says what to install;
the core runs without.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from jaxid.base import extras
from jaxid.base.errors import UsageError


ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
OPTIONAL = PROJECT["optional-dependencies"]
#: Package on disk -> its name where it is installed from.
DISTRIBUTIONS = {
    "dynamixel_sdk": "dynamixel-sdk",
    "rtde_control": "ur-rtde",
    "serial": "pyserial",
}
#: Hides the packages of all extras from a Python, as if `pip install jaxid` were all that was done.
WITHOUT_EXTRAS = f"""
import sys
for package in {sorted(extras.EXTRAS)!r}:
    sys.modules[package] = None
from jaxid.cli.app import main
sys.exit(main(sys.argv[1:]))
"""


def core(*words: str) -> subprocess.CompletedProcess[str]:
    """A command of jaxid in a Python that has no package of any extra."""
    command = [sys.executable, "-c", WITHOUT_EXTRAS, *words]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, env=dict(os.environ))


@pytest.mark.parametrize("package", extras.EXTRAS)
def test_each_package_is_in_the_extra_that_is_named(package):
    extra, _ = extras.EXTRAS[package]
    names = {Requirement(line).name for line in OPTIONAL[extra]}
    assert DISTRIBUTIONS.get(package, package) in names
    assert extra in Requirement(OPTIONAL["all"][0]).extras


def test_what_the_core_requires_is_in_no_extra():
    required = {Requirement(line).name for line in PROJECT["dependencies"]}
    optional = {DISTRIBUTIONS.get(package, package) for package in extras.EXTRAS}
    assert not required & optional
    assert len(required) <= 15


@pytest.mark.parametrize(
    "words, extra",
    [
        (("record", "dynamixel", "--port", "/dev/null", "--id", "1", "--out", "OUT"), "hardware"),
        (
            ("record", "ur10", "--host", "127.0.0.1", "--play", "P", "--live", "--out", "OUT"),
            "hardware",
        ),
        (("batch", "STUDY"), "batch"),
        (("view", "examples", "--dataset", "examples/servo_pendulum"), "view"),
        (("watch", "OUT"), "view"),
        (("fit", "examples/servo_pendulum", "--out", "OUT", "--posterior"), "posterior"),
    ],
)
def test_a_command_names_the_extra_that_it_misses(
    words: tuple[str, ...], extra: str, tmp_path: Path
):
    study = tmp_path / "study.toml"
    study.write_text('name = "x"\nstore = "store"\n[[runs]]\ncommand = "fit"\ndatasets = ["d"]\n')
    places = {"OUT": str(tmp_path / "out"), "STUDY": str(study)}
    run = core(*[places.get(word, word) for word in words])
    assert run.returncode == 2
    assert f'pip install "jaxid[{extra}]"' in run.stderr
    assert "Traceback" not in run.stderr


def test_the_core_reads_and_lists_without_any_extra():
    commands: tuple[tuple[str, ...], ...] = (
        ("effects",),
        ("check", "examples/servo_pendulum"),
        ("record", "--help"),
    )
    for words in commands:
        run = core(*words)
        assert run.returncode == 0, run.stderr


def test_a_package_that_is_missing_is_named_with_its_user(monkeypatch):
    monkeypatch.setitem(sys.modules, "mcap", None)
    monkeypatch.setitem(sys.modules, "mcap.reader", None)
    with pytest.raises(UsageError, match=r"MCAP file needs the package mcap.*jaxid\[ros\]"):
        extras.needed("mcap.reader")
