"""A servo's millisecond counter as a clock: unwrapped, and the proof that an answer is fresh.

Answers of the Dynamixel protocol carry no number, so a late one is taken for the answer to the next
question. Its counter tells: a fresh answer was made between question and receipt.
"""

from __future__ import annotations

from jaxid.hardware.dynamixel.registers import TICK_S, TICK_WRAP


DRIFT = 2e-4  # largest rate difference of the two clocks that is believed
TOLERANCE_S = 5e-4


class TickClock:
    """`fresh(tick, sent, received)` (counts, host s, host s) is the servo's time (s, unwrapped), or
    None for an answer that repeats the last one, or was not made between question and receipt.
    Counts of both: `repeated`, `stale`.
    """

    def __init__(self):
        self.repeated = self.stale = 0
        self._last: float | None = None
        self._seen = 0.0
        self._low = self._high = 0.0  # where host time minus servo time lies

    def fresh(self, tick: int, sent: float, received: float) -> float | None:
        if not 0 <= tick < TICK_WRAP:
            self.stale += 1
            return None
        counter = tick * TICK_S
        if self._last is None:
            return self._take(counter, sent, received, -float("inf"), float("inf"))
        spread = DRIFT * (received - self._seen)
        low, high = self._low - spread, self._high + spread
        earliest, latest = sent - high - TOLERANCE_S - TICK_S, received - low + TOLERANCE_S
        turn = TICK_WRAP * TICK_S
        device = counter + turn * round(((earliest + latest) / 2 - counter) / turn)
        if not earliest <= device <= latest:
            self.stale += 1
            return None
        if device <= self._last:
            self.repeated += 1
            return None
        return self._take(device, sent, received, low, high)

    def _take(self, device: float, sent: float, received: float, low: float, high: float) -> float:
        self._last, self._seen = device, received
        self._low, self._high = max(low, sent - device - TICK_S), min(high, received - device)
        if self._low > self._high:  # within the tolerance
            self._low = self._high = (self._low + self._high) / 2
        return device
