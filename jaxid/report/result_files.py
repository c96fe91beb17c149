"""The files of a result, its JSON, page and tables, which go into a folder together; and those of a
run that was stopped.
"""

from __future__ import annotations

import io
import json
import re
from contextlib import suppress
from hashlib import sha256
from pathlib import Path
from typing import Any

from jaxid.base.atomic_files import replace_files, settle
from jaxid.base.display import displays
from jaxid.base.serialise import json_bytes


#: Folder inside that of a result for what was known when a run was stopped, and the page's name.
PARTIAL, PAGE = "partial", "report.html"
#: Kinds of results that have a page.
DRAWN = ("fit", "diagnosis", "comparison", "identification", "check", "reproduction")
#: The draws of a posterior, and their picture.
DRAWS = ("posterior.nc", "posterior.png")
#: Names of JSON files that are not those of their kind.
FILES = {"reproduction": "result"}


def save(result: Any, folder: Path) -> Path:
    """Puts all files of a result into a folder at once, in the place of an older one of its kind;
    returns the path of the JSON. What a stopped run had left there goes. A page that belongs to a
    result of another kind is kept under the name of that one.

    Raises `NotSaved`; the older result is then as it was.
    """
    settle(folder)
    name = json_name(kind_of(result))
    files = {name: json_bytes(result), **_tables(result)}
    if page := page_of(result):
        files |= {PAGE: page.encode(), **_kept_page(folder, name)}
    replace_files(folder, files, _obsolete(folder, name, files))
    drop_partial(folder)
    return folder / name


def save_partial(result: Any, folder: Path, page: bool) -> Path:
    """Puts what is known before the end into `partial/` inside the folder of the result, with its
    `page` or, as drawing takes seconds, without; returns the path of the JSON. Raises `NotSaved`.
    """
    name, place = json_name(kind_of(result)), folder / PARTIAL
    files = {name: json_bytes(result), **_tables(result)}
    if page and (text := page_of(result)):
        files[PAGE] = text.encode()
    replace_files(place, files, {*_written(place), PAGE})
    return place / name


def drop_partial(folder: Path) -> None:
    """Removes what stopped runs left in `partial/`, and that folder where nothing else lies in
    it.
    """
    place = folder / PARTIAL
    with suppress(OSError):
        settle(place)
        for name in _written(place):
            (place / name).unlink(missing_ok=True)
        place.rmdir()


def kind_of(result: Any) -> str:
    """`fit`, `diagnosis`, `comparison`, `identification`, `check`, `reproduction` or
    `simulation`.
    """
    return result.to_dict()["kind"]


def json_name(kind: str) -> str:
    """The JSON file of a kind."""
    return f"{FILES.get(kind, kind)}.json"


def page_of(result: Any) -> str | None:
    """The report page; None for a kind without one."""
    if kind_of(result) not in DRAWN:
        return None
    return displays().page(result)


def _tables(result: Any) -> dict[str, bytes]:
    kind = kind_of(result)
    if kind == "comparison":
        return {"runs.parquet": result.parquet()}
    if kind == "replay":
        return result.tables()
    if kind == "fit":
        return _draws(result)
    if kind != "simulation":
        return {}
    import pyarrow
    import pyarrow.parquet

    files = {}
    for i, run in enumerate(result.runs):
        buffer = io.BytesIO()
        pyarrow.parquet.write_table(pyarrow.table(dict(run)), buffer)
        files[f"run_{i + 1}.parquet"] = buffer.getvalue()
        if (moving := result.motion(i)) is not None:
            buffer = io.BytesIO()
            moving.strip().figure.savefig(buffer, dpi=120)
            files[f"run_{i + 1}.png"] = buffer.getvalue()
    return files


def _draws(fit: Any) -> dict[str, bytes]:
    """The draws of a fit's posterior and their picture, where there are any."""
    if fit.posterior is None:
        return {}
    return dict(zip(DRAWS, (fit.posterior.netcdf(), displays().image(fit.posterior)), strict=True))


def _written(place: Path) -> list[str]:
    """Names of the files that stopped runs may have left."""
    names = [json_name(kind) for kind in DRAWN] + ["runs.parquet", PAGE, *DRAWS]
    return [name for name in names if (place / name).is_file()]


def _kept_page(folder: Path, name: str) -> dict[str, bytes]:
    """The page there is, where it belongs to another JSON than `name` that still lies beside it:
    under the name of that one.
    """
    with suppress(OSError):
        page = (folder / PAGE).read_bytes()
        about = result_of(page)
        if (
            about is None
            or about[0] == name
            or sha256((folder / about[0]).read_bytes()).hexdigest() != about[1]
        ):
            return {}
        other = Path(about[0]).with_suffix(".html").name
        if not (folder / other).exists() or result_of((folder / other).read_bytes()) is not None:
            return {other: page}
    return {}


def _obsolete(folder: Path, name: str, files: dict[str, bytes]) -> list[str]:
    """Files of the older result of this kind that the new one does not have."""
    out = []
    with suppress(OSError):
        page = Path(name).with_suffix(".html").name
        if (about := result_of((folder / page).read_bytes())) and about[0] == name:
            out.append(page)
    if name == "fit.json" and (folder / name).is_file():
        out += [draws for draws in DRAWS if draws not in files and (folder / draws).is_file()]
    if name == "simulation.json":
        with suppress(OSError, ValueError, KeyError, TypeError):
            older = len(json.loads((folder / name).read_bytes())["rmse"])
            for i in range(older):
                runs = (f"run_{i + 1}.parquet", f"run_{i + 1}.png")
                out += [run for run in runs if run not in files]
    return out


def result_of(page: bytes) -> tuple[str, str] | None:
    """Name and SHA-256 of the file that belongs to a page; None for one that is not ours."""
    found = re.search(
        rb'<meta name="jaxid-result" content="([^"/]+) sha256:([0-9a-f]{64})">', page[:4096]
    )
    return None if found is None else (found[1].decode(), found[2].decode())
