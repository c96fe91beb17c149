"""A model of the user's own by its file: `duffing.py`, or `duffing.py:Duffing` where the file holds
several.

The file runs as Python code. It is one file: what it imports is installed, and its sha256 stands in
every result.
"""

from __future__ import annotations

import hashlib
import inspect
import sys
import traceback
from pathlib import Path
from types import ModuleType
from typing import Any

from jaxid.base.errors import nearest, UsageError
from jaxid.base.wording import names_of
from jaxid.data.model_names import parts_of


#: Class attributes that every model has.
NEEDED = ("name", "signatures", "builtin", "equations", "source")
DERIVE = (
    "derive it from jaxid.dynamics.mechanism.Rigid (README, 'A model of your own, in one file')"
)
#: What a file that was run keeps of itself, as an attribute of its module.
DIGEST = "__jaxid_sha256__"

_RUN: dict[
    tuple[str, str], ModuleType
] = {}  # (path, sha256) -> the module, so that a file is one class in a process


def own_model(text: str) -> type:
    """The class that `FILE.py` or `FILE.py:CLASS` names; a relative path counts from the working
    folder.

    The file is run once a process for each content. Raises `UsageError` where it cannot be read or
    run, for none and for several classes, and for one that is no model.
    """
    parts = parts_of(text)
    if parts is None:
        raise UsageError(
            f"{text!r} is not a file of a model: name it as in duffing.py or duffing.py:Duffing"
        )
    path, wanted = Path(parts[0]), parts[1]
    module = _module(path)
    kind = _only(module, path.name) if wanted is None else _named(module, path.name, wanted)
    _refuse_unusable(kind, path.name)
    return kind


def sha256_of(model: Any) -> str:
    """The sha256 of the file that a mechanism was defined in, where a command or a dataset named
    it; else an empty text.
    """
    module = sys.modules.get(type(model).__module__)
    return getattr(module, DIGEST, "")


def _module(path: Path) -> ModuleType:
    try:
        content = path.read_bytes()
    except OSError as error:
        place = "" if path.is_absolute() else f" in {Path.cwd()}"
        raise UsageError(
            f"model {path}{place} cannot be read ({error.strerror}): correct the path"
        ) from None
    except ValueError as error:
        raise UsageError(
            f"model {str(path)!r} cannot be read ({error}): correct the path"
        ) from None
    digest = hashlib.sha256(content).hexdigest()
    key = str(path.resolve()), digest
    if key not in _RUN:
        _RUN[key] = _run(path, content, digest)
    return _RUN[key]


def _run(path: Path, content: bytes, digest: str) -> ModuleType:
    """Runs the bytes that were hashed, under a name of their own: dataclasses look their module up
    by it.
    """
    place = hashlib.sha256(str(path.resolve()).encode()).hexdigest()[:8]
    module = ModuleType(f"jaxid_model_{path.stem}_{digest[:16]}_{place}")
    module.__file__ = str(path.resolve())
    setattr(module, DIGEST, digest)
    sys.modules[module.__name__] = module
    try:
        exec(compile(content, module.__file__, "exec"), module.__dict__)
    except (Exception, SystemExit) as error:
        del sys.modules[module.__name__]
        raise UsageError(_fault(path.name, module.__file__, error)) from error
    return module


def _fault(name: str, file: str, error: BaseException) -> str:
    """What went wrong when a file was run, with its line."""
    if isinstance(error, SyntaxError):
        line = f", line {error.lineno}" if error.filename == file and error.lineno else ""
        return f"{name}{line}: {error.msg}. Correct the file"
    if isinstance(error, ValueError) and "null bytes" in str(error):
        return f"{name} is not a Python text: {error}"
    rows = [f.lineno for f in traceback.extract_tb(error.__traceback__) if f.filename == file]
    line = f", line {rows[-1]}" if rows else ""
    if isinstance(error, ModuleNotFoundError):
        return (
            f"{name}{line}: there is no module {error.name!r}. A model is one file: what it imports"
            " has to be installed"
        )
    if isinstance(error, SystemExit):
        return (
            f"{name}{line}: the file ends Python (SystemExit). Remove that, or put it under `if"
            " __name__ == '__main__':`"
        )
    return f"{name}{line}: {type(error).__name__}: {error}. Correct the file"


def _classes(module: ModuleType) -> dict[str, type]:
    """The classes that the file itself defines."""
    return {
        k: v
        for k, v in vars(module).items()
        if inspect.isclass(v) and v.__module__ == module.__name__
    }


def _models(module: ModuleType) -> dict[str, type]:
    """Those of models; a class that others in the file are derived from and that lacks something is
    none.
    """
    from jaxid.dynamics.mechanism import Mechanism

    models = {
        k: v
        for k, v in _classes(module).items()
        if issubclass(v, Mechanism) and not k.startswith("_")
    }
    whole = {k: v for k, v in models.items() if not inspect.isabstract(v)}
    return whole or models


def _only(module: ModuleType, file: str) -> type:
    found = _models(module)
    if not found:
        classes = _classes(module)
        there = f"; {', '.join(classes)} is none" if classes else ""
        raise UsageError(f"{file} holds no model{there}. Write a class and {DERIVE}")
    if len(set(found.values())) > 1:
        first = next(iter(found))
        raise UsageError(
            f"{file} holds several models, {', '.join(found)}: name one of them, as in"
            f" {file}:{first}"
        )
    return next(iter(found.values()))


def _named(module: ModuleType, file: str, wanted: str) -> type:
    """By the name of the class, or by the model's own `name`."""
    from jaxid.dynamics.mechanism import Mechanism

    models = _models(module)
    by_id = [v for v in models.values() if getattr(v, "name", None) == wanted]
    found = getattr(module, wanted, by_id[0] if len(by_id) == 1 else None)
    if found is None:
        raise UsageError(f"{file} has no class {wanted!r}{nearest(wanted, models)}")
    if not inspect.isclass(found) or not issubclass(found, Mechanism):
        raise UsageError(f"{wanted} in {file} is not a model: {DERIVE}")
    return found


def _refuse_unusable(kind: type, file: str) -> None:
    """Raises `UsageError` for a class that no command can make a model of."""
    from jaxid.models import MODELS

    lacking = [name for name in NEEDED if not hasattr(kind, name)] + sorted(
        getattr(kind, "__abstractmethods__", ())
    )
    if lacking:
        raise UsageError(
            f"{kind.__name__} in {file} lacks {', '.join(f'`{n}`' for n in lacking)}: write it as"
            " README shows"
        )
    name = getattr(kind, "name", None)
    if name in set(names_of(MODELS)):
        raise UsageError(
            f"{kind.__name__} in {file} has the name {name!r} of a model of jaxid: give it another"
            " `name`"
        )
    try:
        kind()
    except Exception as error:
        why = f"{type(error).__name__}: {error}"
        raise UsageError(
            f"{kind.__name__}() of {file} cannot be made ({why}): give every field a start value"
        ) from error
