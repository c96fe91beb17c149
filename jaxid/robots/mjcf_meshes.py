"""Inertias that an MJCF file leaves to its meshes, stated in its text as MuJoCo's compiler works
them out.

Mesh files are a stranger's input too. Only those that give an inertia are read: from the folder of
the file, of a known kind and up to a size. MuJoCo gets their content and opens no file itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, tostring

import numpy as np

from jaxid.base.errors import UsageError
from jaxid.robots.mjcf_spec import (
    compiled,
    drop_all,
    first_of,
    from_meshes,
    heavy,
    library,
    parsed,
    to_state_inertias,
    UNNAMED,
    without_tendons,
)


#: Endings of mesh files, and bytes of all that one robot's inertias need.
KINDS, LARGEST = (".stl", ".obj", ".msh"), 500_000_000


def with_inertias(path: Path, root: Element) -> None:
    """States `<inertial>` in each moving body of a file, `root` in place, whose mass comes from
    meshes.

    Raises `UsageError` where a mesh file is missing, lies outside the folder of the file, is of an
    unknown kind or too large, and where MuJoCo makes no inertia of it.
    """
    if next(root.iter("mesh"), None) is None:
        return
    unnamed = [body for body in root.iter("body") if not body.get("name")]
    for number, body in enumerate(unnamed):
        body.set("name", f"{UNNAMED} {number}")
    _state(path, root)
    for body in unnamed:
        del body.attrib["name"]


def _state(path: Path, root: Element) -> None:
    """The same where every body has a name."""
    elements = {body.get("name", ""): body for body in root.iter("body")}
    spec = parsed(path, tostring(root, encoding="unicode"))
    lacking = [name for name in from_meshes(spec) if name in elements]
    if not lacking:
        return
    _keep_only(spec, lacking)
    _load(path, spec, lacking)
    model = compiled(path, spec)
    for name in lacking:
        elements[name].append(_inertial(model, name))


def _keep_only(spec: Any, names: Sequence[str]) -> None:
    """Leaves of a spec its bodies, its joints, and the geometry of the bodies named."""
    kept: list[Any] = []
    for name in names:
        kept += heavy(spec.body(name), spec)
    for geom in kept:
        geom.material = ""
    used = {geom.meshname for geom in kept}
    kept += [mesh for mesh in spec.meshes if mesh.name in used]
    silent = [body for body in spec.bodies[1:] if not body.explicitinertial]
    for body in silent:
        if body.name not in names:  # its inertia is of no matter here
            body.mass, body.inertia, body.explicitinertial = 1.0, np.ones(3), True
    without_tendons(library(), spec)
    for one in [*spec.actuators, *spec.equalities, *spec.keys]:
        spec.delete(one)
    drop_all(spec, {"geoms": kept, "meshes": kept})
    compiler = spec.compiler
    compiler.settotalmass = -1.0
    compiler.balanceinertia = compiler.fusestatic = compiler.discardvisual = False


def _load(path: Path, spec: Any, names: Sequence[str]) -> None:
    """Puts the content of the mesh files into a spec."""
    folder, left, contents = path.parent.resolve(), LARGEST, {}
    for number, mesh in enumerate(spec.meshes):
        if not mesh.file:
            continue  # its vertices stand in the file
        written = Path(mesh.file).name if spec.strippath else mesh.file
        file = path.parent / spec.meshdir / written
        if reason := _unreadable(file, folder, left):
            where = f"the inertia of {first_of(names)} comes from meshes, and {written}"
            raise UsageError(f"{path}: {where} {reason}; or {to_state_inertias(path)}")
        content = file.read_bytes()
        left -= len(content)
        mesh.file = f"{number}{file.suffix.lower()}"
        contents[mesh.file] = content
    spec.meshdir = ""
    spec.assets = contents


def _unreadable(file: Path, folder: Path, left: int) -> str | None:
    """Why a mesh file is not read, and what to do; None where it is."""
    if not file.resolve().is_relative_to(folder):
        return "lies outside the folder of the file: put it beside the file"
    if file.suffix.lower() not in KINDS:
        return f"is not of the kinds {', '.join(KINDS)}: convert it"
    if not file.is_file():
        return f"is not there: put it into {file.parent.as_posix()}"
    if file.stat().st_size > left:
        return f"is too large (all of them together: {LARGEST / 1e6:.0f} MB): reduce it"
    return None


def _inertial(model: Any, name: str) -> Element:
    """What MuJoCo made of one body's geometry."""
    body = model.body(name)
    numbers = {"pos": body.ipos, "quat": body.iquat, "mass": body.mass, "diaginertia": body.inertia}
    attributes = {}
    for key, values in numbers.items():
        attributes[key] = " ".join(map(repr, np.ravel(values).tolist()))
    return Element("inertial", attributes)
