"""The driver process of a UR arm: motion through the real ur_rtde, and nothing else. Run by
`jaxid.hardware.ur.robot.UR`.
"""

from __future__ import annotations

import time
from typing import Any

from jaxid.hardware.limits import Clamp, Refused
from jaxid.hardware.link import busy, farewell, in_driver, Leash, Link, StopRequest
from jaxid.hardware.transfer import PathTable


DECELERATION = 5.0  # rad/s^2, of servoStop
_PROGRESS_S = 0.05


def main(fd: int) -> None:
    """Serves orders `path` and `rows`, `arm`, `play` and `quit` on this end of the line until it
    closes.
    """
    link = in_driver(fd)
    leash = Leash(link)
    control: Any = None
    table = PathTable()
    try:
        while True:
            order = leash.next_order() if control is None else _idle(leash, control)
            if order["kind"] in ("path", "rows"):
                kind, content = table.take(order)
                link.send(kind, **content)
            elif order["kind"] == "arm":
                control = _take(order)
                leash.longest_s = order["data_age"]
                leash.tighten(True)
                link.send("armed")
            elif order["kind"] == "play":
                link.send("done", **_play(link, leash, control, order, table))
            elif order["kind"] == "quit":
                raise StopRequest("finished")
    except BaseException as error:  # whatever the library raises is a reason to stop, and is told
        farewell(link, error, "the motion driver failed: ")
    finally:
        if control is not None:
            _halt(control)
        farewell(link)


def _take(order: dict[str, Any]) -> Any:
    try:
        import rtde_control
    except ImportError as error:
        raise RuntimeError(
            f'ur_rtde cannot be imported ({error}); type: pip install "jaxid[hardware]". '
            "Its wheels end at Python 3.12: recording works without it, motion does not"
        ) from None
    control = rtde_control.RTDEControlInterface(order["host"], order["frequency"])
    if not control.setWatchdog(1 / order["data_age"]):
        raise RuntimeError("the controller did not accept the watchdog")
    return control


def _idle(leash: Leash, control: Any) -> dict[str, Any]:
    """Waits for an order while the controller's watchdog is kept quiet."""
    while not leash.inbox:
        leash.wait(time.monotonic() + 0.02)
        if not leash.inbox and not control.kickWatchdog():
            raise RuntimeError("the robot does not answer any more")
    return leash.inbox.pop(0)


def _play(
    link: Link, leash: Leash, control: Any, order: dict[str, Any], table: PathTable
) -> dict[str, Any]:
    """Plays `table`, a row every `step` s; a late row delays the rest, so that no catching up can
    ever make a jump.
    """
    step = order["step"]
    clamp = Clamp(order["lower"], order["upper"], order["largest_step"], order["start"])
    marks = {int(row): name for row, name in order.get("marks", [])}
    deadline = told = time.monotonic()
    late = longest = overrun = 0.0
    for k, row in enumerate(table):
        leash.wait(deadline)
        asked = time.monotonic()
        pause = asked - deadline
        try:
            sent = clamp(row)
        except Refused as error:
            raise RuntimeError(f"row {k + 1} of the path was refused: {error}") from None
        if not control.servoJ(list(sent), 0.0, 0.0, step, order["lookahead"], order["gain"]):
            taken = (
                f"the robot did not take command {k + 1} of {table.rows} within"
                f" {time.monotonic() - asked:.2f} s"
            )
            if max(pause, overrun) > 0.5 * leash.longest_s:
                raise StopRequest(
                    f"{busy(max(pause, overrun))}, and the controller's watchdog stops the arm"
                    f" meanwhile: {taken}"
                )
            raise RuntimeError(
                f"{taken}; is a program or a stop in the way, or was it silent for longer than its"
                f" watchdog allows (data_age, {leash.longest_s:g} s)?"
            )
        now = time.monotonic()
        if k in marks:
            link.send("mark", name=marks[k], at=now)
        if now - told > _PROGRESS_S:
            told = now
            link.send("progress", row=k)
        overrun = now - deadline - step
        if overrun > 0:
            late, longest = late + overrun, max(longest, overrun)
        deadline = max(deadline + step, now)
    if not control.servoStop(DECELERATION):
        raise RuntimeError("the robot did not take the stop at the end of the path")
    return {"clamped": clamp.count, "late_s": late, "longest_s": longest}


def _halt(control: Any) -> None:
    for action in (lambda: control.servoStop(DECELERATION), control.stopScript, control.disconnect):
        try:
            action()
        except Exception:  # noqa: S110 - the next one is tried whatever the library made of this one
            pass
