"""Registers that hold a signed number without a sign: as a size with a sign bit, or as two's
complement read as if unsigned.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


#: A number of a register is whole to so much: what a file writes with a few digits of a decimal
#: fraction is none.
WHOLE = 1e-6


def by_sign_bit(raw: np.ndarray, bit: int) -> np.ndarray:
    """Numbers of a register [time] whose size stands below a bit (counted from 0) that says
    minus.
    """
    place = 2.0**bit
    return np.where(raw >= place, place - raw, raw)


def by_twos_complement(raw: np.ndarray, bits: int) -> np.ndarray:
    """Numbers of a register [time] of this many bits in two's complement."""
    return np.where(raw >= 2.0 ** (bits - 1), raw - 2.0**bits, raw)


def signed(raw: np.ndarray, sign_bit: int | None, signed_bits: int | None) -> np.ndarray:
    """Numbers of a register [time] with their sign, as `sign_bit` or `signed_bits` of a channel
    say; as they are without both.

    Raises `ValueError` where they are no numbers of such a register.
    """
    if sign_bit is None and signed_bits is None:
        return raw
    key, most = (
        ("sign_bit", sign_bit + 1) if sign_bit is not None else ("signed_bits", signed_bits or 0)
    )
    known = raw[np.isfinite(raw)]
    if len(known) and not register_numbers([known]):
        raise ValueError(
            f"{key} is of registers, and its samples are not all whole numbers from 0 on"
        )
    if len(known) and known.max() >= 2.0**most:
        raise ValueError(f"{key} leaves {most} bits, and its samples reach {known.max():.0f}")
    return by_twos_complement(raw, most) if sign_bit is None else by_sign_bit(raw, sign_bit)


def register_numbers(parts: Sequence[np.ndarray]) -> bool:
    """Whether all samples of some runs are whole numbers from 0 on."""
    return all(bool(np.all((y > -WHOLE) & (np.abs(y - np.round(y)) <= WHOLE))) for y in parts)


# ---- found from the numbers alone

#: Bits that say minus, and widths in two's complement, that are looked for.
SIGN_BITS, WIDTHS = range(7, 32), (8, 16, 32)
#: Steps at which a register that is read without its sign jumps, at least, and different numbers on
#: each side of it.
CROSSINGS, DIFFERENT = 2, 5
#: With its sign a number goes through zero as it goes elsewhere: by this many times what most steps
#: are, which are that share of the jump at most.
AS_USUAL, SMALL = 2.0, 1 / 8
#: Share of the crossings at which it has to: gaps in a log may fall on some.
MOST = 0.8


def found_sign(parts: Sequence[np.ndarray]) -> tuple[str, int] | None:
    """`("sign_bit", bit)` or `("signed_bits", width)` of a register in runs [time] that was read
    without its sign; None where they are numbers as they are.

    A signed number that goes through zero changes there as it does elsewhere, and jumps by the
    place of its sign bit where it is read without sign; any other number runs through that place.
    """
    parts = [known for y in parts if len(known := y[np.isfinite(y)])]
    if not parts or not register_numbers(parts):
        return None
    parts = [np.round(y) for y in parts]
    top = max(float(y.max()) for y in parts)
    bit = int(np.log2(max(top, 1.0)))
    if bit in SIGN_BITS and _crosses(parts, 2.0**bit, [by_sign_bit(y, bit) for y in parts]):
        return "sign_bit", bit
    for width in WIDTHS:
        place = 2.0 ** (width - 1)
        if place <= top < 2 * place and _crosses(
            parts, place, [by_twos_complement(y, width) for y in parts]
        ):
            return "signed_bits", width
    return None


def register_words(form: str, bits: int) -> str:
    """What such a register is, after the name of its channel."""
    if form == "sign_bit":
        return f"is a register whose sign stands in bit {bits} ({2**bits} says minus)"
    return f"is a register of {bits} bits whose sign was not read (two's complement)"


def _crosses(parts: Sequence[np.ndarray], place: float, with_sign: Sequence[np.ndarray]) -> bool:
    """Whether numbers change smoothly with their sign where they jump over a place without."""
    negative = [y >= place for y in parts]
    crossing = np.concatenate([np.diff(n.astype(int)) != 0 for n in negative])
    steps = np.abs(np.concatenate([np.diff(y) for y in with_sign]))
    beside = steps[~crossing & (steps > 0)]
    if crossing.sum() < CROSSINGS or not len(beside):
        return False
    both = np.concatenate(with_sign)
    if min(len(np.unique(both[both > 0])), len(np.unique(both[both < 0]))) < DIFFERENT:
        return False
    usual = float(np.percentile(beside, 95))
    small = steps[crossing] <= AS_USUAL * usual
    return usual <= SMALL * place and bool(small.mean() >= MOST)
