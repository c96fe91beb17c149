"""Versions of JAX outside of those that jaxid was run with, and ways that lanes take with the one
that is installed.
"""

from __future__ import annotations

import tomllib
import warnings
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from jaxid.base import errors, versions
from jaxid.base.errors import UsageError
from jaxid.cli import app as cli


CONFIG = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text())
STATED = next(r for r in map(Requirement, CONFIG["project"]["dependencies"]) if r.name == "jax")


@pytest.fixture
def installed(monkeypatch):
    """Pretends that a version of JAX is installed."""

    def pretend(jax: str) -> None:
        monkeypatch.setattr(versions, "requires", lambda name: [str(STATED)])
        monkeypatch.setattr(versions, "version", lambda name: jax)
        versions.check_jax.cache_clear()

    yield pretend
    versions.check_jax.cache_clear()


def bounds() -> list[str]:
    return [bound.version for bound in STATED.specifier]


def test_stated_bounds_are_versions_that_were_run():
    table = (Path(__file__).parents[1] / "docs" / "versions.md").read_text()
    for version in bounds():
        assert f"| {version} |" in table
    assert {bound.operator for bound in STATED.specifier} == {">=", "<="}  # both are in


@pytest.mark.parametrize("jax", bounds())
def test_versions_within_the_bounds_say_nothing(installed, jax):
    installed(jax)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        versions.check_jax()


@pytest.mark.parametrize("jax", ["0.5.3", "0.6.2", "0.7.1"])
def test_an_older_jax_is_refused_with_the_remedy(installed, jax, capsys, tmp_path):
    installed(jax)
    with pytest.raises(UsageError, match=rf"JAX {jax} .* -m pip install 'jax<=.*,>=.*'"):
        versions.check_jax()
    assert cli.main(["fit", "examples/servo_pendulum", "--out", str(tmp_path)]) == errors.BAD_INPUT
    assert f"JAX {jax} is installed" in capsys.readouterr().err


def test_a_newer_jax_is_named_once(installed):
    installed("9.1.0")
    with pytest.warns(RuntimeWarning, match=r"JAX 9\.1\.0 .* -m pip install 'jax<=") as said:
        versions.check_jax()
        versions.check_jax()
    assert len(said) == 1
