"""What of an MJCF file is compiled: bodies, joints and drives, and neither tendons nor what is
drawn, touched or sensed.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxid.base.errors import UsageError
from jaxid.base.wording import listed
from jaxid.dynamics.rigid_body import about_origin
from jaxid.robots.bodies import fault
from jaxid.robots.mjcf_ties import acting_tendons, Tendon, without_tendons


#: What is drawn, touched or sensed, and moves nothing.
DROPPED = (
    "geoms",
    "pairs",
    "excludes",
    "skins",
    "meshes",
    "hfields",
    "materials",
    "textures",
    "sensors",
    "cameras",
    "lights",
)
#: Characters of a file beside another one that are searched for includes.
FIRST = 100_000
#: What a body is called that the file gives no name.
UNNAMED = "a body without a name"


def library() -> Any:
    """MuJoCo, whose names are made when it loads."""
    import mujoco

    return mujoco


def compilable(path: Path, text: str, contacts: bool = False) -> tuple[Any, list[Tendon]]:
    """(spec without what is drawn and without tendons, those tendons that act). Refused where a
    body's inertia would come from what is drawn, or cannot be. `contacts`: planes and plain shapes
    still touch.
    """
    mujoco = library()
    spec = parsed(path, text)
    if len(spec.bodies) < 2:  # the world counts
        raise UsageError(f"{path}: it holds no <body>, so it is not a robot{as_a_part(path)}")
    if spec.compiler.inertiafromgeom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE:
        raise UsageError(
            f'{path}: <compiler inertiafromgeom="true"> takes every inertia from geometry, which is'
            f" not read; state <inertial> in each body and remove it. {written_by_mujoco(path)}"
        )
    lacking = from_meshes(spec)
    if lacking:
        raise UsageError(
            f"{path}: the inertia of {first_of(lacking)} comes from meshes, which are not at hand: "
            f"{to_state_inertias(path)}"
        )
    faults = [f for b in spec.bodies if b.explicitinertial and (f := _fault(b))]
    if faults:
        raise UsageError(
            f"{path}: {'; '.join(faults)}: no body has such an inertia; correct <inertial>"
        )
    tendons, lost = acting_tendons(mujoco, spec)
    if lost:
        raise UsageError(f"{path}: tendon {lost[0]!r} is used and stands nowhere")
    loose = [b for b in spec.bodies if _loose(b) and not b.explicitinertial]
    for body in loose:  # moves nothing of the robot: its inertia is of no matter
        body.mass, body.inertia, body.explicitinertial = 1.0, np.ones(3), True
    _without_what_is_drawn(spec, contacts)
    without_tendons(mujoco, spec)
    spec.compiler.balanceinertia = False
    spec.compiler.fusestatic = False
    spec.compiler.discardvisual = False
    return spec, tendons


def parsed(path: Path, text: str) -> Any:
    """The spec of an MJCF's text. Raises `UsageError`."""
    mujoco = library()
    try:
        return mujoco.MjSpec.from_string(text)
    except (ValueError, mujoco.FatalError) as error:
        raise not_taken(path, error) from None


def compiled(path: Path, spec: Any) -> Any:
    """The model of a file's spec. Raises `UsageError`."""
    try:
        return spec.compile()
    except (ValueError, library().FatalError) as error:
        raise not_taken(path, error) from None


def not_taken(path: Path, error: Exception) -> UsageError:
    """What MuJoCo has against a file."""
    said = " ".join(str(error).split())
    return UsageError(f"{path}: MuJoCo does not take it: {said}{as_a_part(path)}")


def as_a_part(path: Path) -> str:
    """What is to be said of a file that files beside it include, "" of another one."""
    wanted = re.compile(rf"<\s*include\s[^>]*[\"'/]{re.escape(path.name)}[\"']")
    beside = sorted(path.parent.glob("*.xml")) if path.is_file() else []
    whole = [other.name for other in beside if other != path and wanted.search(_start(other))]
    return f". {listed(whole)} includes it: if it is a part, give that file" if whole else ""


def _start(path: Path) -> str:
    """The first part of a file, where includes stand."""
    with path.open(encoding="utf-8", errors="replace") as file:
        return file.read(FIRST)


def from_meshes(spec: Any) -> list[str]:
    """Names of the moving bodies whose mass comes from meshes or from other shapes in files."""
    shapes = [(body.name or UNNAMED, list(heavy(body, spec))) for body in _silent(spec)]
    return [name for name, own in shapes if not all(map(plain, own))]


def first_of(names: Sequence[str], most: int = 8) -> str:
    """Names, of many the first ones."""
    return listed(names if len(names) <= most else [*names[:most], f"{len(names) - most} more"])


def to_state_inertias(path: Path) -> str:
    """What to do about bodies without `<inertial>`."""
    element = '<inertial pos="…" mass="…" diaginertia="…"/>'
    return f"add {element} to each. {written_by_mujoco(path)}"


def written_by_mujoco(path: Path) -> str:
    """A sentence with the command that states all inertias in a copy, where the meshes are."""
    copy = path.with_name(f"{path.stem}_inertial.xml").as_posix()
    return (
        'MuJoCo writes a copy with all of them: python -c "import mujoco; s ='
        f" mujoco.MjSpec.from_file({path.as_posix()!r}); "
        "s.compiler.saveinertial = True; s.compiler.inertiafromgeom = 2; s.compile();"
        f" open({copy!r}, 'w').write(s.to_xml())\""
    )


def _silent(spec: Any) -> list[Any]:
    """Bodies without a stated inertia that a joint of the robot carries, and that geometry gives
    mass.
    """
    never = library().mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE
    if spec.compiler.inertiafromgeom == never:
        return []
    return [
        b
        for b in spec.bodies
        if not b.explicitinertial and _moves(b) and not _loose(b) and any(heavy(b, spec))
    ]


def _up(body: Any) -> list[Any]:
    """A body and what carries it, up to the world's children."""
    out = []
    while body is not None and body.name != "world":
        out.append(body)
        body = body.parent
    return out


def _moves(body: Any) -> bool:
    """Whether a joint carries a body."""
    return any(len(b.joints) for b in _up(body))


def _without_what_is_drawn(spec: Any, contacts: bool) -> None:
    """Takes out all but what gives a body its mass, and what may touch where `contacts` count."""
    kept: list[Any] = []
    for body in _silent(spec):
        kept += heavy(body, spec)
    shapes = touchable(spec) if contacts else []
    for geom in kept:
        if geom not in shapes:
            geom.contype = geom.conaffinity = 0
    for geom in (*kept, *shapes):
        geom.material = ""
    names = {geom.name for geom in shapes}
    pairs = [pair for pair in spec.pairs if {pair.geomname1, pair.geomname2} <= names]
    excludes = list(spec.excludes) if contacts else []
    drop_all(spec, {"geoms": [*kept, *shapes], "pairs": pairs, "excludes": excludes})


def touchable(spec: Any) -> list[Any]:
    """Planes and plain shapes."""
    plane = library().mjtGeom.mjGEOM_PLANE
    return [geom for geom in spec.geoms if plain(geom) or geom.type == plane]


def drop_all(spec: Any, kept: Mapping[str, Sequence[Any]]) -> None:
    """Takes out what is drawn, touched or sensed, but those of a kind that are `kept`."""
    for kind in DROPPED:
        for one in list(getattr(spec, kind)):
            if one not in kept.get(kind, ()):
                spec.delete(one)


def _loose(body: Any) -> bool:
    """Whether a body moves as a whole with all that it is joined to, like a box on a table: no
    joint but a free one is there.
    """
    free = library().mjtJoint.mjJNT_FREE
    up = _up(body)
    if not up or not _moves(body):
        return False
    root = up[-1]
    joints: list[Any] = []
    for below in (root, *root.find_all("body")):
        joints += below.joints
    return all(joint.type == free for joint in joints)


def heavy(body: Any, spec: Any) -> Iterable[Any]:
    """The geometry that gives a body mass."""
    low, high = spec.compiler.inertiagrouprange
    for g in body.geoms:
        weighs = not (g.mass == 0 or (np.isnan(g.mass) and g.density == 0))
        if weighs and low <= g.group <= high:
            yield g


def plain(geom: Any) -> bool:
    """Whether a geom is a shape of its own, whose inertia needs no file."""
    kinds = library().mjtGeom
    shapes = (
        kinds.mjGEOM_SPHERE,
        kinds.mjGEOM_CAPSULE,
        kinds.mjGEOM_ELLIPSOID,
        kinds.mjGEOM_CYLINDER,
        kinds.mjGEOM_BOX,
    )
    return geom.type in shapes and not geom.meshname


def _fault(body: Any) -> str | None:
    full = np.asarray(body.fullinertia, np.float64)
    xx, yy, zz, xy, xz, yz = (
        full if np.isfinite(full).all() else (*np.asarray(body.inertia, np.float64), 0.0, 0.0, 0.0)
    )
    return fault(body.name, about_origin(body.mass, np.zeros(3), [xx, xy, xz, yy, yz, zz]))
