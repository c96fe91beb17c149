"""What a controller adds so that an arm feels weightless: gravity and joint torque from an
identification (with its payload).

    forward = FeedForward.of(identification)        # or of its JSON file
    tau = forward.gravity(q)                        # manual guidance: hold the arm and its load
    tau = forward(q, qd, qdd)                       # the whole torque of a motion, friction included
    forward.save("feed_forward.json")

The base parameters are written as one set of standard parameters that makes the same torque (the
smallest); these numbers alone mean nothing. Paper 001 guides a UR10 by hand with such a term.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from jaxid.base.errors import UsageError
from jaxid.base.small_files import read_small
from jaxid.dynamics.base_parameters import standard_torque
from jaxid.identification.regression import friction_columns, LAWS


GEOMETRY = ("a", "alpha", "d", "theta", "b", "gamma")
PLACE = ("gravity", "base_roll", "base_pitch")


class _Geometry:
    """The numbers that `standard_torque` reads."""

    def __init__(self, content: Mapping[str, Any]):
        for name in GEOMETRY:
            setattr(self, name, np.asarray(content[name], float))
        for name in PLACE:
            setattr(self, name, float(content[name]))
        self.prismatic = tuple(map(bool, content["prismatic"]))


@dataclass(frozen=True)
class FeedForward:
    """Torque of an identified arm. `phi` [11 n] standard parameters, `levels` [k n] of the friction
    `law`, `exponent` [n]; `geometry` as in an `ArmTable`, with gravity. Joint positions are
    [samples n] or [n], in rad (m).
    """

    geometry: dict[str, Any]
    phi: np.ndarray
    law: str
    levels: np.ndarray
    exponent: np.ndarray

    @classmethod
    def of(cls, identification: Any, arm: Any = None) -> FeedForward:
        """From an `Identification`, its dictionary or its JSON file; `arm` where the model is not
        one of the library by that name (a `serial_arm`). Raises `UsageError` for anything else, and
        for an arm of another size.
        """
        from jaxid.dynamics import catalogue
        from jaxid.identification.payload import read_reference

        content = read_reference(identification)
        model = catalogue.model_class(content["model"])() if arm is None else arm
        base, n = model.base(), len(model.prismatic)
        values = np.array([e["value"] for e in content["base_parameters"]], float)
        if [e["name"] for e in content["base_parameters"]] != list(base.names):
            raise UsageError(
                f"the identification's base parameters are not those of {model.name}: give the arm"
                " it was made with"
            )
        law = LAWS[content["friction_law"]]
        levels = np.zeros((len(law.parameters), len(content["friction"])))
        exponent = np.ones(len(content["friction"]))
        for j, joint in enumerate(content["friction"]):
            levels[:, j] = [joint[name]["value"] for name, _ in law.parameters]
            if "exponent" in joint:
                exponent[j] = joint["exponent"]["value"]
        geometry = {k: np.asarray(getattr(model, k), float).tolist() for k in (*GEOMETRY, *PLACE)}
        geometry["prismatic"] = [bool(p) for p in model.prismatic]
        assert levels.shape[1] == n
        return cls(geometry, np.linalg.pinv(base.K) @ values, law.name, levels, exponent)

    def __call__(self, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
        """Drive torque of a motion, friction included, N m (N)."""
        return self.rigid(q, qd, qdd) + self.friction(qd)

    def rigid(self, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
        """Torque of inertia, Coriolis forces and gravity."""
        rows = [np.atleast_2d(np.asarray(x, float)) for x in (q, qd, qdd)]
        tau = standard_torque(_Geometry(self.geometry), self.phi, *rows)
        return tau.reshape(np.shape(q))

    def gravity(self, q: np.ndarray) -> np.ndarray:
        """Torque that holds the arm and what it carries at rest."""
        still = np.zeros_like(np.asarray(q, float))
        return self.rigid(q, still, still)

    def friction(self, qd: np.ndarray) -> np.ndarray:
        """Friction and offset at joint speeds qd; dry friction as tanh(qd / 0.01)."""
        rows = np.atleast_2d(np.asarray(qd, float))
        columns = friction_columns(LAWS[self.law], rows, self.exponent)
        return (columns * self.levels).sum(1).reshape(np.shape(qd))

    def save(self, path: str | Path) -> Path:
        """Writes everything as JSON; `load` reads it."""
        content = {
            "schema": 1,
            "kind": "feed_forward",
            "geometry": self.geometry,
            "phi": self.phi.tolist(),
            "law": self.law,
        }
        content |= {"levels": self.levels.tolist(), "exponent": self.exponent.tolist()}
        path = Path(path)
        path.write_text(json.dumps(content, indent=1), encoding="utf-8")
        return path

    @classmethod
    def load(cls, path: str | Path) -> FeedForward:
        """From a file that `save` wrote; raises `UsageError` for another one."""
        try:
            c = json.loads(read_small(path).decode())
            if c.get("kind") != "feed_forward" or c["law"] not in LAWS:
                raise UsageError(
                    f"{path} holds no feed-forward torque; FeedForward.save writes one"
                )
            arrays = (np.asarray(c[k], float) for k in ("phi", "levels", "exponent"))
            phi, levels, exponent = arrays
            return cls(c["geometry"], phi, c["law"], levels, exponent)
        except OSError as error:
            raise UsageError(f"{path}: cannot be read ({error.strerror})") from error
        except (ValueError, KeyError, AttributeError) as error:
            raise UsageError(
                f"{path} holds no feed-forward torque; FeedForward.save writes one ({error})"
            ) from error
