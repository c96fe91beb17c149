"""Pages written from the code: effect atlas, models, fitters, benchmarks, and the list of
notebooks.
"""

from __future__ import annotations

import importlib.util
import json
import os
import re
import shutil
from pathlib import Path
from types import ModuleType

import effect_pages


#: Models whose equivalences the atlas quotes.
QUOTED = ("joint", "pendulum", "planar_arm")

FAMILIES = {
    "actuator": "Actuator",
    "friction and forces at the joint": "Friction and forces at the joint",
    "mechanism": "Mechanism and transmission",
    "sensor": "Sensor and clock",
    "change in time": "Change in time",
}
NOTEBOOKS = (
    "00_tour", "diagnose_your_robot", "robot", "extend", "gradient_against_population", "recording", "flexible_link", "tracker",
    "ur10", "space_manipulator",
)  # fmt: skip


def notebook(text: str):
    """A text notebook as nbformat's, with its language for the pages that show it without running
    it.
    """
    import jupytext

    book = jupytext.reads(text, fmt="py:percent")
    book.metadata["language_info"] = {"name": "python", "pygments_lexer": "ipython3"}
    return book


def write(folder: Path, root: Path) -> None:
    """Writes all pages into the folder; pictures and equivalences are kept in out/ until the code
    that they show changes.
    """
    from jaxid.runtime import prepare

    prepare()
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    kept = root / "out" / "docs_cache" / _key(root)
    if os.environ.get("JAXID_DOCS_NOTEBOOKS") != "off":
        _compute(kept)
    pictures = folder / "signatures"
    if (kept / "signatures").is_dir():
        shutil.copytree(kept / "signatures", pictures)
    file = kept / "equivalences.json"
    alike = json.loads(file.read_text()) if file.is_file() else {}
    (folder / "effects.md").write_text(effects(pictures, alike), encoding="utf-8")
    asked = _asked() if alike else set()
    effect_pages.write(
        folder / "effects",
        pictures,
        lambda name: _mates(name, alike) if name in asked else None,
    )
    (folder / "models.md").write_text(models(), encoding="utf-8")
    (folder / "fitters.md").write_text(fitters(), encoding="utf-8")
    (folder / "thresholds.md").write_text(thresholds(), encoding="utf-8")
    results = (root / "benchmarks" / "RESULTS.md").read_text(encoding="utf-8")
    (folder / "benchmarks.md").write_text(
        results.replace("# Measured results", "# Benchmarks", 1), encoding="utf-8"
    )
    (folder / "results").mkdir(exist_ok=True)
    for picture in (root / "benchmarks" / "results").glob("*.png"):
        shutil.copy(picture, folder / "results")
    benchmarks = root / "benchmarks"
    public, gallery = _module(benchmarks / "public.py"), _module(benchmarks / "gallery.py")
    board = public.page(benchmarks / "leaderboard")
    (folder / "leaderboard.md").write_text(board, encoding="utf-8")
    (folder / "gallery.md").write_text(gallery.page(benchmarks / "results"), encoding="utf-8")
    present = [n for n in NOTEBOOKS if (root / "notebooks" / f"{n}.py").is_file()]
    (folder / "notebooks.md").write_text(notebooks(present), encoding="utf-8")


def _module(file: Path) -> ModuleType:
    """A file of the benchmarks, which are no package of the site's."""
    spec = importlib.util.spec_from_file_location(file.stem, file)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _key(root: Path) -> str:
    import signatures

    return signatures.key(root)


def _compute(kept: Path) -> None:
    import signatures

    from jaxid.diagnosis.equivalence import equivalences
    from jaxid.dynamics import catalogue

    if not (kept / "signatures").is_dir():
        signatures.draw(kept / "partial", list(catalogue.effect_names()))
        (kept / "partial").rename(kept / "signatures")
    if not (kept / "equivalences.json").is_file():
        found = {m: equivalences(m).to_dict() for m in QUOTED}
        (kept / "equivalences.json").write_text(json.dumps(found, indent=1))


def plain(text: str) -> str:
    """Text of the code as text of a page: nothing in it is markup."""
    return re.sub(r"([\\`*_{}\[\]<>#|$])", r"\\\1", text)


def table(header: list[str], rows: list[list[str]]) -> str:
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in lines)


def effects(pictures: Path, alike: dict) -> str:
    """The atlas."""
    from jaxid.dynamics import catalogue

    infos = [catalogue.describe_effect(n) for n in catalogue.effect_names()]
    out = [
        "# Effect atlas",
        "",
        "What a model can lack. An effect acts at one place between command and sensor; at its neutral value it changes nothing.",
        "Bounds are multiples of what the data show (`torque`, `speed`, `angle`, `duration`, `step`) or of the number that an",
        "effect changes (`number`), so that one library serves a drive of 60 N and one of 0.1 N m.",
        "",
        "The pictures are computed: the force that the model without the effect lacks, along a rich motion of the model with it",
        "(less what the filters alone leave), against velocity, position and time; blue forwards, orange backwards.",
        "*Cannot be told from* quotes",
        "`jaxid effects --model M`, an open loop with rich excitation; poorer recordings confuse more, and each diagnosis says",
        "what in `confusable_with`.",
        "",
    ]
    for family, title in FAMILIES.items():
        out += [f"## {title}", ""]
        for info in (i for i in infos if i.family == family):
            out += [
                f"### {info.name}",
                "",
                plain(info.text),
                "",
                "```text",
                info.equation,
                "```",
                "",
            ]
            if (pictures / f"{info.name}.svg").is_file():
                out += [
                    f"```{{image}} signatures/{info.name}.svg",
                    f":alt: missing force left by {info.name}",
                    "```",
                    "",
                ]
            out += [
                "Signature",
                f": {plain(info.signature)}",
                "",
                "What to record",
                f": {plain(info.what_to_record)}",
                "",
            ]
            if mates := _mates(info.name, alike):
                out += ["Cannot be told from", f": {mates}", ""]
            out += ["Where", f": {info.locations}", "", "Source", f": {plain(info.source)}", ""]
            out += [
                f"More, and what to write in simulators: [{info.name}](effects/{info.name})",
                "",
            ]
            if info.parameters:
                rows = [
                    [
                        f"`{p.name}`",
                        plain(p.unit),
                        f"{p.neutral:g}",
                        plain(f"{p.lower} … {p.upper}"),
                        plain(p.meaning),
                    ]
                    for p in info.parameters
                ]
                out += [table(["parameter", "unit", "neutral", "bounds", "meaning"], rows), ""]
    return "\n".join([*out, "```{toctree}", ":hidden:", ":glob:", "", "effects/*", "```", ""])


def _asked() -> set[str]:
    """The effects that a quoted model can have: of no other one it was computed what is alike."""
    from jaxid.dynamics import catalogue
    from jaxid.dynamics.chain import Chain

    asked: set[str] = set()
    for model in QUOTED:
        chain = Chain(catalogue.model_class(model)())
        for name in catalogue.effect_names():
            if name in chain.contents or chain.offers(catalogue.effect_class(name)):
                asked.add(name)
    return asked


def _mates(effect: str, alike: dict) -> str:
    said = []
    for model, found in alike.items():
        mates = {
            p["effect"]
            for group in found["equivalent"]
            if effect in {p["effect"] for p in group}
            for p in group
        } - {effect}
        if mates:
            said.append(f"{', '.join(f'`{m}`' for m in sorted(mates))} on `{model}`")
        if effect in {p["effect"] for p in found["absorbed"]}:
            said.append(f"the parameters of `{model}` itself, which absorb it")
    return "; ".join(said)


def models() -> str:
    from jaxid.cli import listing
    from jaxid.dynamics import catalogue

    out = [
        "# Models",
        "",
        "`jaxid models NAME` prints the same. Every model also runs from Python: `jaxid.models`.",
        "",
    ]
    for name in catalogue.model_names():
        info = catalogue.describe(name)
        out += [f"## {name}", "", plain(info.text), "", "```text", info.equations, "```", ""]
        out += [
            "Inputs → outputs",
            ": " + "; ".join(plain(listing.signature(s)) for s in info.signatures),
            "",
        ]
        out += [
            "Friction and offsets it contains",
            ": " + (", ".join(f"`{e}`" for e in info.builtin_effects) or "none"),
            "",
        ]
        out += ["Source", f": {plain(info.source)}", ""]
        rows = [
            [
                f"`{p.name}`",
                plain(p.unit),
                f"{p.neutral:g}",
                plain(f"{p.lower} … {p.upper}"),
                plain(p.meaning),
            ]
            for p in info.parameter_info[:40]
        ]
        if rows:
            out += [table(["fitted parameter", "unit", "start", "bounds", "meaning"], rows), ""]
        if len(info.parameter_info) > 40:
            out += [f"and {len(info.parameter_info) - 40} more of the other joints.", ""]
        rows = [
            [f"`{p.name}`", plain(p.unit), f"{p.neutral:g}", plain(p.meaning)]
            for p in info.constant_info[:30]
        ]
        out += [table(["constant", "unit", "default", "meaning"], rows), ""]
    return "\n".join(out)


def fitters() -> str:
    from jaxid.fitters.by_name import describe_fitter, fitter_names

    out = [
        "# Fitters",
        "",
        "`jaxid fitters NAME` prints the same; which to take says [Choosing](../choosing.md).",
        "",
    ]
    for name in fitter_names():
        info = describe_fitter(name)
        out += [f"## {name}", "", plain(info.text), "", "Source", f": {plain(info.source)}", ""]
        if info.settings:
            rows = [[f"`{s.name}`", plain(str(s.default)), plain(s.meaning)] for s in info.settings]
            out += [table(["setting", "default", "meaning"], rows), ""]
    return "\n".join(out)


def thresholds() -> str:
    from jaxid.diagnosis.thresholds import LIMITS

    out = [
        "# Thresholds of the diagnosis",
        "",
        "What a diagnosis decides by (`jaxid.diagnosis.thresholds`), and why.",
        "",
    ]
    rows = [
        [f"`{name}`", f"{value:g}", unit, plain(reason), plain(case)]
        for name, value, unit, reason, case in LIMITS.table()
    ]
    return "\n".join(
        [*out, table(["name", "value", "unit", "reason", "the case it came from"], rows), ""]
    )


def notebooks(names: list[str]) -> str:
    lines = [
        "# Notebooks",
        "",
        "Kept as text (`notebooks/*.py`): after `pip install jupyterlab jupytext`, `jupytext --to ipynb notebooks/00_tour.py`",
        "makes a Jupyter file, and `jupyter lab notebooks` opens it.",
        "",
    ]
    return "\n".join(
        [
            *lines,
            "```{toctree}",
            ":maxdepth: 1",
            "",
            *(f"../notebooks/{n}" for n in names),
            "```",
            "",
        ]
    )
