"""The text of an MJCF file with its includes, which lie beside it: a stranger's input, read without
entities and up to a size.
"""

from __future__ import annotations

from pathlib import Path
from xml.etree.ElementTree import Element, tostring

from jaxid.base.errors import UsageError
from jaxid.base.xml_tree import Declares, xml_root
from jaxid.robots.mjcf_meshes import with_inertias


#: Bytes of a file, of all that it includes, and how deep includes may nest.
LARGEST, DEEPEST = 4_000_000, 8


def expanded(path: Path, text: str | None = None) -> str:
    """The MJCF with its includes in place, and with the inertias that come from meshes stated.

    Raises `UsageError` for what is no MJCF, lies outside its folder, or is too large.
    """
    root = _parsed(path, text)
    if root.tag not in ("mujoco", "mujocoinclude"):
        raise UsageError(
            f"{path}: the outermost tag is <{root.tag}>, not <mujoco>; give an MJCF (or name a"
            " .urdf)"
        )
    budget = [LARGEST]
    _include(root, path, path.parent.resolve(), 0, budget)
    for tag, what in (
        ("flexcomp", "a flexible body"),
        ("composite", "a composite body"),
        ("attach", "another model"),
    ):
        found = next(root.iter(tag), None)
        if found is not None:
            raise UsageError(
                f"{path}: <{tag}> {found.get('name') or found.get('prefix') or ''} is {what}, which"
                " is not read"
            )
    for parent in list(root.iter()):
        for child in [
            c for c in parent if c.tag in ("extension", "plugin", "visual", "statistic", "size")
        ]:
            parent.remove(child)
    with_inertias(path, root)
    for parent in list(root.iter()):
        for child in [c for c in parent if parent.tag == "asset"]:
            if (
                child.tag != "material"
            ):  # geoms name them in defaults; they read no file once their texture is gone
                parent.remove(child)
            child.attrib.pop("texture", None)
            for layer in list(child):
                child.remove(layer)
    return tostring(root, encoding="unicode")


def _parsed(path: Path, text: str | None) -> Element:
    from xml.etree.ElementTree import ParseError

    try:
        if text is None:
            size = path.stat().st_size
            if not path.is_file():
                raise UsageError(f"{path}: not a file")
            if size > LARGEST:
                raise UsageError(
                    f"{path}: {size / 1e6:.0f} MB; a robot's file has at most"
                    f" {LARGEST / 1e6:.0f} MB"
                )
            text = path.read_text(encoding="utf-8-sig")
        root = xml_root(text)
    except UnicodeDecodeError as error:
        raise UsageError(
            f"{path}: a character that is not UTF-8; save the file as UTF-8"
        ) from error
    except OSError as error:
        raise UsageError(f"{path}: cannot be read ({error.strerror})") from error
    except (ParseError, ValueError, RecursionError) as error:
        if isinstance(error, UsageError):
            raise
        if isinstance(error, Declares):
            raise UsageError(f"{path}: {error}, which is refused; write it without them") from error
        raise UsageError(f"{path}: not XML ({error})") from error
    return root


def _include(element: Element, path: Path, folder: Path, depth: int, budget: list[int]) -> None:
    for position, child in reversed(list(enumerate(list(element)))):
        if child.tag != "include":
            _include(child, path, folder, depth, budget)
            continue
        name = child.get("file") or ""
        target = folder / name
        parts = name.replace("\\", "/").split("/")
        if (
            not name
            or ".." in parts
            or Path(name).is_absolute()
            or not target.resolve().is_relative_to(folder)
        ):
            raise UsageError(
                f"{path}: includes {name!r}, which lies outside its folder; put it beside the file"
            )
        if depth >= DEEPEST:
            raise UsageError(
                f"{path}: includes {name!r} more than {DEEPEST} files deep; does a file include"
                " itself?"
            )
        root = _parsed(target, None)
        budget[0] -= target.stat().st_size
        if budget[0] < 0:
            raise UsageError(f"{path}: its includes have more than {LARGEST / 1e6:.0f} MB")
        _include(root, target, folder, depth + 1, budget)
        element.remove(child)
        for offset, inner in enumerate(list(root)):
            element.insert(position + offset, inner)
