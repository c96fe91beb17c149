"""An MJCF and what it includes, as texts that are edited: joints, bodies, actuators and the option
by name.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from jaxid.base.errors import UsageError
from jaxid.robots import mjcf_spec
from jaxid.robots.export.xml_text import Element, XmlText
from jaxid.robots.mjcf_spec import compilable, library
from jaxid.robots.mjcf_text import expanded, LARGEST


#: Sections in which a <joint> or <body> is something else than a part of the tree.
ELSEWHERE = ("default", "equality", "tendon", "actuator", "sensor", "contact", "keyframe")
ACTUATORS = (
    "general",
    "motor",
    "position",
    "velocity",
    "intvelocity",
    "damper",
    "cylinder",
    "muscle",
    "adhesion",
    "dcmotor",
    "pid",
)


class MjcfFile:
    """`texts` by path relative to the file's folder, the file itself first; `model` as MuJoCo
    compiles it without what is drawn.

    Raises `UsageError` for what jaxid's reader refuses, includes outside the folder among it.
    """

    def __init__(self, path: Path):
        self.path = path
        expanded(path)  # refuses what is to be refused, for every file that is read below
        self.texts: dict[str, XmlText] = {}
        self._read(path.name)
        self.model: Any = compiled(path)

    def _read(self, name: str) -> None:
        if name in self.texts:
            return
        raw = (self.path.parent / name).read_bytes()
        if len(raw) > LARGEST:
            raise UsageError(f"{name}: a robot's file has at most {LARGEST / 1e6:.0f} MB")
        self.texts[name] = text = XmlText(raw.decode("utf-8-sig"))
        for one in text.elements:
            if one.name == "include" and (inner := one.attributes.get("file")):
                self._read((Path(name).parent / inner).as_posix())

    def _find(self, tag: str, name: str) -> tuple[XmlText, Element] | None:
        for text in self.texts.values():
            for one in text.elements:
                if (
                    one.name == tag
                    and one.attributes.get("name") == name
                    and not set(one.above()) & {*ELSEWHERE}
                ):
                    return text, one
        return None

    def joint(self, name: str) -> tuple[XmlText, Element] | None:
        return self._find("joint", name)

    def geom(self, name: str) -> tuple[XmlText, Element] | None:
        return self._find("geom", name)

    def body(self, name: str) -> tuple[XmlText, Element] | None:
        return self._find("body", name)

    def actuator(self, joint: str) -> tuple[XmlText, Element] | None:
        """The one actuator that acts on a joint; None where there is none, or several."""
        found = []
        for text in self.texts.values():
            for one in text.elements:
                if one.name not in ACTUATORS or "default" in one.above():
                    continue
                if joint in (one.attributes.get("joint"), one.attributes.get("jointinparent")):
                    found.append((text, one))
        return found[0] if len(found) == 1 else None

    def option(self) -> tuple[XmlText, Element | None]:
        for text in self.texts.values():
            for one in text.elements:
                if (
                    one.name == "option"
                    and one.parent is not None
                    and one.parent.name.startswith("mujoco")
                ):
                    return text, one
        return next(iter(self.texts.values())), None

    def actuator_id(self, joint: str) -> int:
        """Number of a joint's one actuator in the compiled model, -1 where there is none."""
        m, mj = self.model, library()
        j = mj.mj_name2id(m, mj.mjtObj.mjOBJ_JOINT, joint)
        on = (int(mj.mjtTrn.mjTRN_JOINT), int(mj.mjtTrn.mjTRN_JOINTINPARENT))
        found = [
            a
            for a in range(m.nu)
            if int(m.actuator_trntype[a]) in on and int(m.actuator_trnid[a, 0]) == j
        ]
        return found[0] if len(found) == 1 else -1

    def lifted(self, link: str) -> str:
        """What is to be said of a body whose weight the file cancels, "" of another one."""
        if not self.model.body_gravcomp[self.model.body(link).id]:
            return ""
        return (
            "gravcomp cancels the weight as patched in MuJoCo; in the result it cancels that of "
            "the file before"
        )

    @property
    def degrees(self) -> float:
        """Number of the file's angles per radian."""
        angle = "degree"
        for text in self.texts.values():
            for one in text.elements:
                if one.name == "compiler" and "angle" in one.attributes:
                    angle = one.attributes["angle"]
        return 1.0 if angle == "radian" else 57.29577951308232


def compiled(path: Path, text: str | None = None) -> Any:
    """The model of a file without what is drawn. Raises `UsageError`."""
    spec, _ = compilable(path, expanded(path, text))
    return mjcf_spec.compiled(path, spec)
