"""The package as it is installed and imported."""

from __future__ import annotations

import importlib
import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

import numpy as np
import pytest

import jaxid


ROOT = Path(__file__).parents[1]
CONFIG = tomllib.loads((ROOT / "pyproject.toml").read_text())
SETUPTOOLS = CONFIG["tool"]["setuptools"]


def run(code: str, **environment: str) -> str:
    result = subprocess.run(
        [sys.executable, "-c", code],
        cwd=ROOT,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
    )
    assert result.returncode == 0, result.stderr
    return result.stdout.strip()


def test_every_folder_with_code_is_packaged():
    folders = {
        str(file.parent.relative_to(ROOT))
        for top in ("jaxid", "models", "fitters")
        for file in (ROOT / top).rglob("*.py")
        if "__pycache__" not in file.parts
    }
    assert folders == set(SETUPTOOLS["package-dir"].values())
    assert set(SETUPTOOLS["packages"]) == set(SETUPTOOLS["package-dir"])


def test_every_configured_folder_exists():
    folders = [
        *CONFIG["tool"]["pyright"]["include"],
        *CONFIG["tool"]["pytest"]["ini_options"]["testpaths"],
    ]
    assert [f for f in folders if not (ROOT / f).is_dir()] == []


def test_stubs_name_every_sub_package():
    """Type checkers see jaxid.models through these; without one they see nothing and say
    nothing.
    """
    for name in SETUPTOOLS["packages"]:
        folder = SETUPTOOLS["package-dir"][name]
        if folder.startswith("jaxid"):
            continue
        stub = ROOT / "jaxid" / folder
        candidates = [stub.with_suffix(".pyi"), stub / "__init__.pyi"]
        assert any(c.is_file() for c in candidates), f"no stub for {name}"


@pytest.mark.parametrize("name", ["models", "fitters"])
def test_bare_import_is_refused(name):
    with pytest.raises(ImportError, match=f"jaxid.{name}"):
        importlib.import_module(name)
    sys.modules.pop(name, None)


def test_public_names():
    assert len(jaxid.__all__) <= 23
    assert jaxid.__all__ == sorted(jaxid.__all__)
    for name in jaxid.__all__:
        assert getattr(jaxid, name) is not None
        assert name in dir(jaxid)
    with pytest.raises(AttributeError, match="nonsense"):
        jaxid.nonsense  # noqa: B018


def test_no_module_hides_a_public_function():
    """A module jaxid/fit.py would replace the function jaxid.fit as soon as it is imported."""
    modules = {p.stem for p in (ROOT / "jaxid").iterdir() if p.suffix == ".py" or p.is_dir()}
    assert modules & (set(jaxid.__all__) - {"models", "fitters", "runtime"}) == set()


def test_import_loads_nothing_heavy():
    heavy = (
        "jax",
        "scipy",
        "matplotlib",
        "numpy",
        "pydantic",
        "pandas",
        "pyarrow",
        "jinja2",
    )
    loaded = run(f"import sys, jaxid; print([m for m in {heavy!r} if m in sys.modules])")
    assert loaded == "[]"


def test_a_recording_in_parquet_is_read_without_pandas(tmp_path):
    """pyarrow imports it on the way to NumPy, which takes longer than reading the file."""
    t = np.arange(50) / 100
    data = jaxid.Dataset.from_arrays(
        t, {"tau": np.sin(t)}, {"q": t}, units={"tau": "N m", "q": "rad"}, model="pendulum"
    )
    jaxid.save_dataset(data, tmp_path / "data")
    load = f"import sys, jaxid; d = jaxid.load_dataset({str(tmp_path / 'data')!r})"
    assert run(f"{load}; print(d.experiments[0].y[-1, 0], 'pandas' in sys.modules)") == "0.49 False"


def test_import_changes_no_setting():
    code = """
import json, locale, os, signal, sys, warnings
import jax, matplotlib, numpy
def state():
    return [
        dict(os.environ),
        list(map(str, warnings.filters)),
        sys.getrecursionlimit(),
        locale.setlocale(locale.LC_ALL),
        str(signal.getsignal(signal.SIGINT)),
        repr(numpy.geterr()),
        repr(numpy.get_printoptions()),
        {k: repr(v) for k, v in jax.config.values.items()},
        {k: repr(v) for k, v in matplotlib.rcParams.items()},
    ]
before = state()
import jaxid
for name in jaxid.__all__:
    getattr(jaxid, name)
after = state()
print(json.dumps([i for i, (a, b) in enumerate(zip(before, after)) if a != b]))
"""
    assert json.loads(run(code)) == []


def test_lazy_submodules():
    assert (
        run("import jaxid; print(jaxid.models.__name__, jaxid.fitters.__name__)")
        == "jaxid.models jaxid.fitters"
    )


def test_prepare_sets_the_environment(tmp_path):
    code = """
import json, os; from jaxid.runtime import prepare; prepare(); prepare(); set_ = dict(os.environ)
import jax; from jaxid.numerics.precision import float64; float64()
print(json.dumps(set_ | {"kept": jax.config.values["jax_compilation_cache_dir"]}))
"""
    plain = {"XLA_FLAGS": "--xla_x=1", "JAXID_CACHE_DIR": str(tmp_path / "cache"), "JAXID_XLA": "1"}
    names = ("JAX_COMPILATION_CACHE_DIR", "JAX_PLATFORMS")
    for name in names:
        plain[name] = os.environ.get(name, "")
    code = f"import os; [os.environ.pop(n) for n in {names}];" + code
    after = json.loads(run(code, **plain))
    assert after["XLA_FLAGS"].startswith("--xla_x=1 --xla_backend_extra_options=")
    assert [
        after["XLA_FLAGS"].count(f)
        for f in ("xla_backend_extra_options", "xla_backend_optimization_level")
    ] == [1, 1]
    chosen = json.loads(run(code, **{**plain, "XLA_FLAGS": "--xla_backend_optimization_level=2"}))
    assert (
        chosen["XLA_FLAGS"].count("xla_backend_optimization_level") == 1
    )  # what the user has set wins
    assert after["JAX_PLATFORMS"] == "cpu"
    assert after["TF_CPP_MIN_LOG_LEVEL"] == "3"  # no line of XLA on the terminal
    assert after["kept"] == str(tmp_path / "cache") and "JAX_COMPILATION_CACHE_DIR" not in after
    assert (tmp_path / "cache").is_dir()

    off = json.loads(
        run(code, **{**plain, "JAXID_XLA": "0", "JAXID_CACHE_DIR": "/dev/null/nowhere"})
    )
    assert off["XLA_FLAGS"] == "--xla_x=1"
    assert off["kept"] is None


def test_a_streaming_program_is_called_by_its_own_thread():
    """No other thread wakes up for a program of a few operations; without `streaming` two do."""
    code = """
from jaxid.runtime import prepare
prepare(streaming=True)
import pathlib, jax, jax.numpy as jnp
program = jax.jit(lambda x: [jnp.sin(x @ x + k) for k in range(8)])
x = jax.block_until_ready(jnp.ones((40, 40)))
run = lambda: [jax.block_until_ready(program(x)) for _ in range(200)]
switches = lambda: {t.name: sum(int(l.split()[1]) for l in (t / "status").read_text().splitlines() if "ctxt_switches" in l)
                    for t in pathlib.Path("/proc/self/task").iterdir()}
run(); before = switches(); run()
print(sum(n - before.get(t, 0) > 50 for t, n in switches().items()))
"""
    assert run(code) == "0"


#: Files to be parted, and the lines that they have; they may only shrink.
LONG = {
    "jaxid/diagnosis/goals/study.py": 505,
    "jaxid/dynamics/chain.py": 530,
    "jaxid/study/papers/flexible_link.py": 553,
    "models/robot.py": 567,
}


def test_files_stay_readable():
    long = {
        name: n
        for top in ("jaxid", "models", "fitters")
        for p in (ROOT / top).rglob("*.py")
        if (n := len(p.read_text(encoding="utf-8").splitlines()))
        > LONG.get(name := p.relative_to(ROOT).as_posix(), 500)
    }
    assert long == {}
    page = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    written, _, _ = page.partition("<!-- figures -->")
    assert len(written.splitlines()) <= 60


def test_documents_link_only_to_what_exists():
    for document in ("README.md", "CONTRIBUTING.md"):
        content = (ROOT / document).read_text(encoding="utf-8")
        for target in re.findall(r"\]\((?!https?:|#|mailto:)([^)#]+)", content):
            assert (ROOT / target).exists(), f"{document} links to {target}"


def in_the_repository() -> set[str]:
    """Every file of the checkout that a clone would have."""
    ignored = shutil.ignore_patterns(
        "__pycache__", "*.egg-info", "*.ipynb", "*.partial", ".*_cache", "generated"
    )
    found = set()
    for top in sorted(ROOT.iterdir()):
        if top.is_file() and top.name not in (".git", "setup.cfg", "PKG-INFO"):
            found.add(top.name)
        elif top.name in (
            ".ci",
            "jaxid",
            "models",
            "fitters",
            "tests",
            "notebooks",
            "docs",
            "benchmarks",
            "examples",
        ):
            for folder, folders, files in os.walk(top):
                left_out = ignored(folder, [*folders, *files])
                folders[:] = [
                    f
                    for f in folders
                    if f not in left_out and Path(folder, f) != ROOT / "docs" / "notebooks"
                ]
                found |= {
                    str(Path(folder, f).relative_to(ROOT)) for f in files if f not in left_out
                }
    return found


def test_what_is_built(tmp_path):
    """Wheel and source distribution, built from a copy so that no build folder is left in the
    checkout.
    """
    pytest.importorskip("setuptools", minversion="77")
    source, files = tmp_path / "source", in_the_repository()
    for file in files:
        (source / file).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / file, source / file)
    (source / "tests" / "__pycache__").mkdir()
    (source / "tests" / "__pycache__" / "left.pyc").touch()
    build = "from setuptools import build_meta as b; print(b.build_wheel('.'), b.build_sdist('.'))"
    result = subprocess.run(
        [sys.executable, "-c", build], cwd=source, capture_output=True, text=True
    )
    assert result.returncode == 0, result.stderr
    assert "would be ignored" not in result.stderr + result.stdout, (
        "a folder that setuptools knows twice"
    )
    with tarfile.open(next(source.glob("*.tar.gz"))) as archive:
        members = {m.name.split("/", 1)[1] for m in archive.getmembers() if m.isfile()}
    assert files - members == set(), (
        "the source distribution misses files; name them in MANIFEST.in"
    )
    assert {m for m in members - files if ".egg-info/" not in m} <= {"PKG-INFO", "setup.cfg"}
    wheel = zipfile.ZipFile(next(source.glob("*.whl")))
    names = set(wheel.namelist())
    for expected in (
        "jaxid/cli/app.py",
        "jaxid/py.typed",
        "jaxid/report/page.html",
        "jaxid/report/recorded.html",
        "jaxid/report/style.css",
        "jaxid/models/ur10_consistent.json",
        "jaxid/models/__init__.py",
        "jaxid/models/effects/__init__.py",
        "jaxid/fitters/__init__.py",
    ):
        assert expected in names
    assert not [
        n for n in names if n.endswith(".pyi") or n.startswith(("models/", "fitters/", "tests/"))
    ]
    installed = tmp_path / "installed"
    wheel.extractall(installed)
    code = (
        f"import sys; sys.path.insert(0, {str(installed)!r}); import jaxid, jaxid.models.effects, jaxid.fitters;"
        "print(jaxid.__file__, jaxid.models.__file__, len(jaxid.__path__))"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True
    )
    assert result.returncode == 0, result.stderr
    package, models, entries = result.stdout.split()
    assert (
        package.startswith(str(installed)) and models.startswith(str(installed)) and entries == "1"
    )


def test_the_module_is_the_command():
    """`python -m jaxid`, where the script is not on the path."""
    run = subprocess.run(
        [sys.executable, "-m", "jaxid", "--version"], capture_output=True, text=True, check=True
    )
    assert run.stdout.strip() == f"jaxid, version {jaxid.__version__}"
