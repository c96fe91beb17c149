"""The documentation: its code runs, its commands exist, its links lead somewhere, and the site
builds without a warning.
"""

from __future__ import annotations

import ast
import importlib
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import click
import jax
import pytest

import jaxid
from chromium import BROWSER, Chromium, DESKTOP, PHONE
from jaxid.dynamics import catalogue
from jaxid.fitters.by_name import fitter_names


ROOT = Path(__file__).resolve().parents[1]
#: Pages whose blocks need a robot, a store or a cluster: what they import exists, and the tests of
#: those parts run it.
ELSEWHERE = [ROOT / "docs" / name for name in ("hardware.md", "batch.md")]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def blocks(page: Path, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", page.read_text(encoding="utf-8"), re.S)


def test_python_blocks_run(tmp_path, monkeypatch, capsys, request):
    """Those of the pages, with few candidates; the README's own run in full in test_readme."""
    shutil.copytree(ROOT / "examples" / "servo_pendulum", tmp_path / "my_robot")
    monkeypatch.chdir(tmp_path)
    before = jax.config.read("jax_enable_x64")  # a block sets it
    request.addfinalizer(lambda: jax.config.update("jax_enable_x64", before))
    whole = jaxid.diagnose
    found: dict = {}

    def few(model, data, **settings):
        key = type(model).__name__, data.sha256
        if key not in found:
            found[key] = whole(model, data, effects=("dead_zone", "input_delay"), **settings)
        return found[key]

    monkeypatch.setattr(jaxid, "diagnose", few)
    count = 0
    for page in PAGES:
        if page.name == "README.md" or page in ELSEWHERE:
            continue
        for code in [
            *blocks(page, "python"),
            *(b for b in blocks(page, "text") if b.startswith("import jaxid")),
        ]:
            if "jaxid." not in code:
                continue
            exec(compile(code, page.name, "exec"), {})
            count += 1
    assert count >= 2 and "dead_zone" in capsys.readouterr().out
    assert (tmp_path / "report.html").is_file()


def test_blocks_that_need_more_than_this_computer_import_what_there_is():
    for page in ELSEWHERE:
        for code in blocks(page, "python"):
            for node in ast.walk(ast.parse(code)):
                if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("jaxid"):
                    module = importlib.import_module(node.module or "")
                    assert [a.name for a in node.names if not hasattr(module, a.name)] == [], (
                        page.name
                    )


def test_the_picture_is_one():
    """A browser shows it: well-formed, with the names of the lines as text."""
    from xml.dom import minidom

    picture = minidom.parse(str(ROOT / "docs" / "_static" / "gap.svg"))
    texts = [n.firstChild for n in picture.getElementsByTagName("text")]
    words = " ".join(text.data for text in texts if text)  # type: ignore[attr-defined]
    assert picture.documentElement.tagName == "svg"  # type: ignore[union-attr]
    assert "measured" in words and "with dead zone" in words and "noise" in words


def commands() -> list[tuple[str, str]]:
    out = []
    for page in PAGES:
        lines = "\n".join(blocks(page, "sh")).replace("\\\n", " ").splitlines()
        out += [(page.name, line.split("#")[0].strip()) for line in lines]
    return [(p, line) for p, line in out if re.match(r"(\.venv/bin/)?jaxid ", line)]


@pytest.mark.parametrize(("page", "line"), commands())
def test_commands_of_the_pages_parse(page, line):
    """Every command and option that a page shows exists; nothing is run."""
    from jaxid.cli.app import cli

    words = shlex.split(line)[1:]
    context = cli.make_context("jaxid", [], resilient_parsing=True)
    group: Any = cli
    arguments = words
    while True:
        name, command, arguments = group.resolve_command(context, arguments)
        assert command is not None, name
        if not isinstance(command, click.Group):
            break
        group = command
    command.make_context(name, list(arguments))


def test_every_command_is_documented():
    from jaxid.cli.app import cli

    readme, contract = (
        (ROOT / f).read_text(encoding="utf-8") for f in ("README.md", "docs/contract.md")
    )
    for name in cli.list_commands(cli.make_context("jaxid", [], resilient_parsing=True)):
        assert f"`jaxid {name}" in readme, f"README: jaxid {name}"
        assert f"`jaxid {name}" in contract, f"docs/contract.md: jaxid {name}"


def test_what_the_contract_promises_is_there():
    """The ids in the first or second column of the tables of section 4, and the fitters' names."""
    contract = (ROOT / "docs" / "contract.md").read_text(encoding="utf-8")
    section = contract.split("## 4. ")[1].split("## 5. ")[0]
    tables = [line.split("|")[1:-1] for line in section.splitlines() if line.startswith("|")]
    models = {m for row in tables if len(row) == 4 for m in re.findall(r"`(\w+)`", row[0])}
    without_remarks = [re.sub(r"\([^()]*\)", "", row[1]) for row in tables if len(row) == 2]
    effects = {e for ids in without_remarks for e in re.findall(r"`(\w+)`", ids)}
    assert len(models) >= 12 and len(effects) >= 38
    assert models <= set(catalogue.model_names())
    assert effects <= set(catalogue.effect_names())
    fitters = re.findall(
        r"`(\w+)`", re.sub(r"\([^()]*\)", "", contract.split("Fitters: ")[1].split(".\n")[0])
    )
    assert len(fitters) >= 14 and set(fitters) <= set(fitter_names())


def test_links_lead_somewhere():
    for page in PAGES:
        for target in re.findall(
            r"\]\((?!https?:|#|mailto:)([^)#]+)", page.read_text(encoding="utf-8")
        ):
            if target.startswith("generated/"):
                assert target.removeprefix("generated/") in (
                    "effects",
                    "models",
                    "fitters",
                    "benchmarks",
                    "leaderboard",
                    "notebooks",
                ), target
            elif target.startswith("notebooks/") and page.parent == ROOT / "docs":
                assert (ROOT / f"{target}.py").is_file(), target
            else:
                near = page.parent / target
                assert near.exists() or near.with_suffix(".md").exists(), (
                    f"{page.name} links to {target}"
                )


def test_every_effect_has_a_place_in_the_atlas(monkeypatch, tmp_path):
    monkeypatch.syspath_prepend(str(ROOT / "docs"))
    import generate  # pyright: ignore[reportMissingImports]

    page = generate.effects(
        tmp_path,
        {
            "pendulum": {
                "equivalent": [[{"effect": "input_delay"}, {"effect": "sensor_delay"}]],
                "absorbed": [],
            }
        },
    )
    for name in catalogue.effect_names():
        info = catalogue.describe_effect(name)
        assert f"### {name}\n" in page
        assert info.signature and info.what_to_record and info.source, name
    assert "`sensor_delay` on `pendulum`" in page.split("### input_delay\n")[1].split("###")[0]
    for model in catalogue.model_names():
        assert f"## {model}\n" in generate.models()
    for fitter in fitter_names():
        assert f"## {fitter}\n" in generate.fitters()


def test_every_effect_has_a_page_of_its_own(monkeypatch, tmp_path):
    monkeypatch.syspath_prepend(str(ROOT / "docs"))
    import effect_pages  # pyright: ignore[reportMissingImports]

    effect_pages.write(tmp_path, tmp_path, lambda name: "")
    written = {file.stem: file.read_text() for file in tmp_path.glob("*.md")}
    assert set(written) == set(catalogue.effect_names())
    for name, page in written.items():
        heads = [line for line in page.splitlines() if line.startswith("## ")]
        wanted = ("looks like", "Where", "Equation", "confused", "record", "simulator")
        assert all(any(word in head for head in heads) for word in wanted), name
        assert catalogue.describe_effect(name).equation in page
    assert "u - clip(u, -width, width)" in written["dead_zone"]
    assert "[COMMAND] --> drive --> joint" in written["dead_zone"]
    for name, page in written.items():
        kind = catalogue.effect_class(name)
        assert ("changes a number of the model" in page) == (kind.acts_on == "number"), name
    assert "[COMMAND] -->" in written["input_delay"] and "[SENSOR]" in written["sensor_delay"]
    assert "`damping`" in written["viscous_friction"]
    assert "mend the time stamps" in written["timestamp_jitter"]
    for name, page in written.items():
        assert not re.search(r"\{\w+(:[^}]*)?\}", page), f"{name}: a number's place, not its name"
        looks = page.split("## What it looks like\n\n")[1]
        assert looks[:1] == looks[:1].upper(), name
    told = effect_pages.page("dead_zone", drawn=False, mates=None)
    assert "from every other effect" not in told, "nothing was computed of it"


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Path:
    """The site, every warning an error. Notebooks are without their outputs, which `make docs`
    computes; built in a copy, for the build writes pages beside its sources.
    """
    for module in ("furo", "myst_nb", "jupytext", "sphinx"):
        pytest.importorskip(module)
    home = tmp_path_factory.mktemp("site")
    source = home / "source"
    leave = shutil.ignore_patterns("__pycache__", "generated", "*.ipynb", "ipynb_checkpoints")
    for folder in ("docs", "notebooks", "examples"):
        shutil.copytree(ROOT / folder, source / folder, ignore=leave)
    pictures = shutil.ignore_patterns("*.jsonl")
    shutil.copytree(
        ROOT / "benchmarks" / "results", source / "benchmarks" / "results", ignore=pictures
    )
    shutil.copytree(ROOT / "benchmarks" / "leaderboard", source / "benchmarks" / "leaderboard")
    for file in ("RESULTS.md", "public.py", "gallery.py"):
        shutil.copy(ROOT / "benchmarks" / file, source / "benchmarks")
    for folder in ("jaxid", "models"):
        (source / folder).symlink_to(ROOT / folder)
    done = subprocess.run(
        [
            sys.executable,
            "-m",
            "sphinx",
            "-q",
            "-W",
            "--keep-going",
            "-b",
            "html",
            source / "docs",
            home / "site",
        ],
        capture_output=True,
        text=True,
        env={**os.environ, "JAXID_DOCS_NOTEBOOKS": "off"},
    )
    assert done.returncode == 0, done.stderr
    return home / "site"


def test_the_site_builds_without_warnings(site):
    for page in (
        "index",
        "getting_started",
        "generated/effects",
        "generated/benchmarks",
        "generated/leaderboard",
        "generated/gallery",
        "notebooks/00_tour",
        "contract",
        "faq",
    ):
        assert (site / f"{page}.html").is_file(), page
    assert "dead_zone" in (site / "generated" / "effects.html").read_text(encoding="utf-8")


@pytest.mark.skipif(BROWSER is None, reason="no Chromium here: the site was not looked at")
@pytest.mark.parametrize("size", [DESKTOP, PHONE], ids=["desktop", "phone"])
def test_the_site_is_accessible(site, size, tmp_path):
    """The front page, the gallery of recordings and an effect's own page."""
    pytest.importorskip("axe_core_python", reason="axe-core is not installed")
    found = {}
    with Chromium(tmp_path, size) as browser:
        for page in ("index", "generated/gallery", "generated/effects/dead_zone"):
            browser.shown((site / f"{page}.html").as_uri())
            found[page] = browser.violations()
    assert found == dict.fromkeys(found, [])


@pytest.mark.slow
def test_every_model_of_the_atlas_has_a_motion_that_can_be_recorded(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "docs"))
    import signatures  # pyright: ignore[reportMissingImports]

    from jaxid.diagnosis.equivalence import _rich_motion
    from jaxid.dynamics.chain import Chain
    from jaxid.problem.binding import bind

    for model in signatures.MODELS:
        owner = catalogue.model_class(model)()
        data, _ = _rich_motion(Chain(owner), model, owner)
        assert bind(model, data, splits=False).experiments("fit"), model


def test_every_stop_of_the_walk_exists_and_so_does_its_picture():
    from xml.dom import minidom

    page = (ROOT / "docs" / "walk.md").read_text(encoding="utf-8")
    stops = re.findall(r"`((?:jaxid|models|fitters)/[\w/]+\.py): ([\w.]+)`", page)
    assert len(stops) > 20
    for file, name in stops:
        owner, _, method = name.partition(".")
        tree = ast.parse((ROOT / file).read_text(encoding="utf-8"))
        found = [n for n in tree.body if getattr(n, "name", "") == owner]
        assert found, f"docs/walk.md: {file} has no {owner}"
        assert not method or any(getattr(n, "name", "") == method for n in ast.walk(found[0])), (
            f"docs/walk.md: no {name}"
        )
    assert minidom.parse(str(ROOT / "docs" / "_static" / "walk.svg")).documentElement
