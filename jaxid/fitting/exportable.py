"""Results that can be carried back: `result.export("mjcf", out="patched")`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, TYPE_CHECKING


if TYPE_CHECKING:
    from jaxid.robots.export.run import Exported


class Exportable:
    """Abstract: what `jaxid export` takes."""

    def to_dict(self) -> dict[str, Any]:
        """The content of the result's JSON."""
        raise NotImplementedError

    def export(
        self,
        to: str,
        *,
        robot: str | Path | None = None,
        ranges: bool = False,
        out: str | Path | None = None,
    ) -> Exported:
        """What was found, in the terms of mjcf, mjlab, isaaclab, urdf, sdf, drake, ros2_control or
        genesis: `.rows` say for each effect and number which field carries it, `.files` are the
        texts, written into the folder `out` where one is given.

        `robot` is the file to patch (default: the result's own), `ranges` adds those for domain
        randomisation. Raises `UsageError` as `jaxid export` does.
        """
        from jaxid.base.serialise import finite
        from jaxid.fitting.tried import recording_of
        from jaxid.robots.export.run import export
        from jaxid.robots.export.save import save

        content = json.loads(json.dumps(finite(self.to_dict())))
        trial = recording_of(content, None) if to == "mjcf" else None
        found = export(content, to, robot, ranges, trial=trial)
        if out is not None:
            save(found, out)
        return found
