"""Registers of servos that were read without their sign: a size with a sign bit, or two's
complement.
"""

from __future__ import annotations

from jaxid.conventions.finding import DataFinding
from jaxid.conventions.mending import lines, Mending, raw_of
from jaxid.conventions.samples import series, Shown
from jaxid.data.dataset import Channel, Dataset
from jaxid.data.registers import found_sign


#: Positions that a counter brings round to 0 are read as wrapped.
POSITIONS = "rad", "m"


def register(dataset: Dataset, channel: Channel) -> Shown | None:
    """A channel that jumps by the place of a sign bit where it goes through zero."""
    found = found_sign([raw_of(channel, y) for _, y in series(dataset, channel)])
    if found is None or (
        found[0] == "signed_bits" and channel.role == "output" and channel.unit in POSITIONS
    ):
        return None
    key, bits = found
    forms = {key: bits}
    name = channel.name
    place = 2**bits if key == "sign_bit" else 2 ** (bits - 1)
    what = (
        f"the size stands below bit {bits} and the bit itself ({place}) says minus"
        if key == "sign_bit"
        else f"a negative number of {bits} bits (two's complement) was read as 2^{bits} more"
    )
    text = (
        f"{name} jumps by {place if key == 'sign_bit' else 2 * place} in the numbers recorded where"
        " it goes through 0, and nowhere else: it is a register that was read without its sign,"
        f" {what}."
    )
    finding = DataFinding(
        "unsigned",
        name,
        float(bits),
        text,
        lines(dataset, name, forms),
        decisive=True,
        headline=(
            f"{name} is a register whose sign was not read; everything below takes it with its sign"
        ),
    )
    return Shown(finding, Mending({name: forms}))


def told_once(by_itself: list[DataFinding], by_model: list[DataFinding]) -> list[DataFinding]:
    """All findings, less what a model says of the sign of a register that its own numbers have told
    of.
    """
    registers = {f.channel for f in by_itself if f.kind == "unsigned"}
    return by_itself + [
        f for f in by_model if f.channel not in registers or f.kind not in ("sign", "unsigned")
    ]
