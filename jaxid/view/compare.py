"""The page of `jaxid view`: what it asks, and what it is answered."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from jaxid.base.errors import UsageError
from jaxid.view.plots import channels_over_time, color
from jaxid.view.results import Viewer
from jaxid.view.server import bokeh_files, FILES, page, Site


def results_site(viewer: Viewer) -> Site:
    """The site on which results stand side by side. Raises `UsageError` without Bokeh."""
    names = [r.name for r in viewer.results]

    def about(_: Mapping[str, str]) -> Any:
        results = [
            {"name": r.name, "effects": list(r.effects), "color": color(k)}
            for k, r in enumerate(viewer.results)
        ]
        notes = [f"{name} is of another recording." for name in viewer.other_data()]
        return {
            "runs": viewer.runs,
            "results": results,
            "units": viewer.outputs,
            "notes": notes,
        }

    def asked(given: Mapping[str, str]) -> dict[str, Any]:
        try:
            run = int(given.get("run", "0"))
            off = [frozenset(map(str, labels)) for labels in json.loads(given.get("off", "[]"))]
        except (ValueError, TypeError) as error:
            raise UsageError(f"a question that cannot be read: {error}") from error
        if not 0 <= run < len(viewer.runs) or len(off) != len(names):
            raise UsageError("there is no such run or result")
        return viewer.series(run, off)

    def plots(given: Mapping[str, str]) -> Any:
        found = asked(given)
        item = channels_over_time(found, viewer.outputs, names)
        return {"item": item, "rms": _errors(found)}

    def series(given: Mapping[str, str]) -> Any:
        found = asked(given)
        simulated = {}
        for name, channel in found["channels"].items():
            measured = channel["measured"]
            simulated[name] = [{"y": y, "left": measured - y} for y in channel["simulated"]]
        return {"simulated": simulated, "rms": _errors(found)}

    files = {**bokeh_files(), "view.js": FILES / "view.js", "view.css": FILES / "view.css"}
    answers = {"about": about, "plots": plots, "series": series}
    return Site(page("Results side by side", "view.js"), files, answers)


def _errors(found: Mapping[str, Any]) -> dict[str, list[float]]:
    return {name: channel["rms"] for name, channel in found["channels"].items()}
