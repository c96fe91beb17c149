"""Registers of servos that were read without their sign: which they are, what mends them, and
silence on sound numbers.
"""

import numpy as np
import pytest

import jaxid
from jaxid.base.errors import DatasetError, DatasetWarning
from jaxid.conventions import checking
from jaxid.data.importers.map import import_table
from jaxid.data.registers import found_sign


def without_sign(numbers: np.ndarray, key: str, bits: int) -> np.ndarray:
    """A register as it is read where its sign is not looked at."""
    whole = np.round(numbers)
    return np.where(whole < 0, (2**bits - whole) if key == "sign_bit" else (2**bits + whole), whole)


def wave(rng: np.random.Generator, count: int, clock: str) -> np.ndarray:
    """A smooth series between -1 and 1 at even, uneven, coarse or repeated times."""
    t = np.linspace(0, 8, count)
    if clock == "uneven":
        t = np.cumsum(np.where(np.arange(count) % 2, 1.2, 0.8)) * 8 / count
    if clock == "repeats":
        t = np.repeat(t[::2], 2)[:count]
    f, phase = rng.uniform(0.2, 1.2, 4), rng.uniform(0, 6, 4)
    x = np.sin(2 * np.pi * f * t[:, None] + phase).sum(1)
    return x / np.abs(x).max()


CLOCKS = "even", "uneven", "repeats"


@pytest.mark.parametrize("clock", CLOCKS)
@pytest.mark.parametrize(
    ("key", "bits"),
    [
        ("sign_bit", 10),
        ("sign_bit", 11),
        ("sign_bit", 15),
        ("signed_bits", 16),
        ("signed_bits", 32),
    ],
)
def test_the_sign_of_a_register_is_found(key, bits, clock):
    rng = np.random.default_rng(bits)
    size = 0.7 * 2 ** min(bits - 1, 12)
    runs = [size * wave(rng, 900, clock) + 3 * rng.standard_normal(900) for _ in range(2)]
    assert found_sign([without_sign(x, key, bits) for x in runs]) == (key, bits)


@pytest.mark.parametrize("clock", CLOCKS)
def test_numbers_that_hold_their_sign_are_left(clock):
    for seed in range(100):
        rng = np.random.default_rng(seed)
        x, size = wave(rng, 900, clock), rng.uniform(50, 40000)
        counts = np.round(size * (1 + x))  # an encoder, a pressure, a goal that is never negative
        steps = np.round(size * (x > 0) + 2 * rng.random(900))
        turns = 2 ** int(rng.integers(8, 17))
        sound = [
            counts,
            counts % turns,
            counts % 36000,
            np.round(size * x),
            np.abs(np.round(size * x)),
            steps,
            size * (1 + x),
        ]
        assert [found_sign([y]) for y in sound] == [None] * len(sound), seed


def registers(**settings) -> jaxid.Dataset:
    """A joint driven by a register of load, with its speed as an auxiliary channel."""
    rng, t = np.random.default_rng(1), np.arange(0, 8, 0.01)
    drive = wave(rng, len(t), "even")
    # A drive that holds from its row on acts on the rows behind it.
    rate = drive / 0.03
    speed = np.concatenate([[0.0], np.cumsum(rate[:-1]) * 0.01])
    speed = speed - speed.mean()
    position = np.concatenate([[0.0], np.cumsum(speed[:-1] + 0.005 * rate[:-1]) * 0.01])
    load = without_sign(500 * drive, "sign_bit", 10)
    register = without_sign(650 * speed, "sign_bit", 15)
    return jaxid.Dataset.from_arrays(
        t,
        inputs={"tau": load},
        outputs={"q": position},
        auxiliary={"qd": register},
        units={"tau": "N m", "q": "rad", "qd": "rad/s"},
        scale={"tau": 0.002, "qd": 1 / 650},
        **settings,
    )


def test_check_takes_registers_with_their_sign_and_says_the_line():
    checked = checking.run_check("joint", registers())
    found = {f.channel: f for f in checked.findings if f.kind == "unsigned"}
    assert {c: (f.line, f.applied) for c, f in found.items()} == {
        "tau": ("sign_bit = 10", True),
        "qd": ("sign_bit = 15", True),
    }
    assert not [f for f in checked.findings if f.kind == "sign"]
    assert checked.mended is not None
    stated = registers(sign_bit={"tau": 10, "qd": 15})
    assert np.allclose(checked.mended.experiments[0].u, stated.experiments[0].u)
    assert np.allclose(
        checked.mended.experiments[0].auxiliary["qd"], stated.experiments[0].auxiliary["qd"]
    )
    assert stated.experiments[0].u.min() < -0.5
    assert [f.kind for f in checking.run_check("joint", stated).findings] == []


def test_as_recorded_claims_no_sign_of_a_register():
    checked = checking.run_check("joint", registers(), as_recorded=True)
    assert [(f.kind, f.applied) for f in checked.findings if f.channel == "tau"] == [
        ("unsigned", False)
    ]


def test_bits_that_a_channel_cannot_have_are_refused():
    with pytest.raises(DatasetError, match="sign_bit leaves 11 bits"):
        registers(sign_bit={"qd": 10})
    with pytest.raises(DatasetError, match="keep one"):
        registers(sign_bit={"tau": 10}, signed_bits={"tau": 16})


@pytest.mark.filterwarnings("ignore::jaxid.base.errors.DatasetWarning")
def test_import_takes_registers_with_their_sign(tmp_path):
    data = registers()
    e = data.experiments[0]
    load = np.round(e.u[:, 0] / 0.002).astype(int)
    rows = [f"{t:.2f},{a},{q:.6f}" for t, a, q in zip(e.t, load, e.y[:, 0], strict=True)]
    (tmp_path / "log.csv").write_text("\n".join(["t,load,q", *rows]))
    with pytest.raises(jaxid.UsageError, match="load is a register whose sign stands in bit 10"):
        import_table(tmp_path / "log.csv", tmp_path / "out")
    with pytest.warns(DatasetWarning, match="tau is a register whose sign stands in bit 10"):
        made = import_table(
            tmp_path / "log.csv", tmp_path / "out", channels=["t=t:s", "tau=load:N m", "q=q:rad"]
        )
    taken = jaxid.load_dataset(made.folder).experiments[0].u
    assert taken.min() < -300
    assert np.abs(np.diff(taken[:, 0])).max() < 100
