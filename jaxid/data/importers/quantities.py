"""What the name of a recorded column says: the quantity, whether it is a goal, its unit. English,
German, and ROS's words; of other languages what a goal and a quantity are called.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass

from jaxid.data.units import conversion, UnitError


_QUANTITY = {
    "position": "pos position positions angle angles q theta encoder enc lage winkel weg stellung",
    "velocity": "vel velocity velocities speed qd dq omega qvel geschwindigkeit drehzahl",
    "acceleration": "acc accel acceleration accelerations qdd ddq beschleunigung",
    "torque": "torque torques tau moment drehmoment couple effort efforts trq",
    "force": "force forces kraft",
    "current": "current currents strom iq amps",
    "voltage": "voltage volt spannung pwm duty",
    "temperature": "temp temperature temperatur",
}
_WORDS: dict[str, str] = {}
for _quantity, _said in _QUANTITY.items():
    _WORDS |= dict.fromkeys(_said.split(), _quantity)
_GOAL = set(
    "cmd command commands commanded des desired ref reference target targets goal goals setpoint"
    " set sp soll sollwert ziel action vorgabe demand demanded leader".split()
)
#: How words begin, without accents, that say goal or quantity in French, Spanish, Italian,
#: Portuguese, Dutch, Russian, Chinese, Japanese and Korean. The last three have no spaces: there
#: the sign stands anywhere in a word.
_GOAL_STEMS = (
    "consign commande desead desejad desiderat comandad comandat objetiv obiettiv riferiment"
    " gewenst задан уставк 目标 目標 指令 期望 给定 设定 목표 지령"
).split()
_STEMS = {
    "position": "posic posiz posit hoek угол положен 位置 角度 위치 각도",
    "velocity": "vitess velocid velocit snelheid скорост 速度 转速 속도",
    "torque": "coppi koppel крутящ момент 力矩 扭矩 转矩 トルク 토크",
    "force": "fuerz forza forca kracht сил",
    "current": "couran corrient corrente stroom ток 电流 電流 전류",
    "voltage": "voltag spanning напряжен 电压 電圧 전압",
}
_BEGINNINGS = {quantity: stems.split() for quantity, stems in _STEMS.items()}
_ACTUAL = set("act actual meas measured ist istwert state feedback fb present obs".split())
_ERROR = set(
    "err error errors deviation following fehler schleppfehler abweichung regelabweichung".split()
)
_SI = {
    "rad": "position",
    "m": "position",
    "rad/s": "velocity",
    "m/s": "velocity",
    "rad/s^2": "acceleration",
    "m/s^2": "acceleration",
    "N m": "torque",
    "N": "force",
    "A": "current",
    "V": "voltage",
    "K": "temperature",
}
_SUFFIXES = {
    "rad": "rad",
    "mrad": "mrad",
    "deg": "deg",
    "mm": "mm",
    "cm": "cm",
    "um": "um",
    "Nm": "N m",
    "mNm": "mN m",
    "A": "A",
    "mA": "mA",
    "V": "V",
    "mV": "mV",
    "rpm": "rpm",
    "N": "N",
    "rad_s": "rad/s",
    "radps": "rad/s",
    "rad_per_s": "rad/s",
    "deg_s": "deg/s",
    "degps": "deg/s",
    "dps": "deg/s",
    "mm_s": "mm/s",
    "m_s": "m/s",
    "m": "m",
}


@dataclass(frozen=True)
class Meaning:
    """Of one column; `quantity` is empty where its name and unit do not say it, `unit` where
    nothing states it.
    """

    quantity: str
    goal: bool
    unit: str


def meaning_of(name: str, unit: str) -> Meaning:
    """What a column is by its `name` and the `unit` that the file states (empty where it does
    not).
    """
    unit = unit or _unit_behind(name)
    words: list[str] = []
    for word in words_of(name):
        words += _parts(word)
    if _ERROR & set(words):
        return Meaning("", False, unit)
    goal = bool(_GOAL & set(words))
    told = [_WORDS[w] for w in words if w in _WORDS]
    others = [q for q in told if q != "current"]
    quantity = (others or told or [""])[-1]  # `current_position` is the position now
    return Meaning(_by_unit(unit) or quantity, goal, unit)


def words_of(name: str) -> list[str]:
    """`lrActPos1` as lr, act, pos."""
    split = re.sub(r"(?<=[a-zäöü])(?=[A-ZÄÖÜ])", " ", name)
    return [w.lower() for w in re.findall(r"[^\W\d_]+", split)]


def _parts(word: str) -> list[str]:
    """A German compound as the words in it that are known: `sollposition`, `motorstrom`."""
    if word in _WORDS or word in _GOAL | _ACTUAL | _ERROR:
        return [word]
    foreign = _foreign(word)
    if foreign:
        return foreign
    found = [start for start in ("soll", "ziel", "ist") if word.startswith(start)][:1]
    ends = [known for known in _WORDS if len(known) >= 3 and word.endswith(known)]
    if not ends and found != ["soll"]:
        return []
    return [*found, *sorted(ends, key=len)[-1:]]


def _foreign(word: str) -> list[str]:
    """What a word of another language says, in words that are known here."""
    plain = _without_accents(word)
    found = ["goal"] if _begins(plain, _GOAL_STEMS) else []
    found += [quantity for quantity, stems in _BEGINNINGS.items() if _begins(plain, stems)]
    return found


def _without_accents(word: str) -> str:
    letters = unicodedata.normalize("NFKD", word)
    return unicodedata.normalize("NFC", "".join(c for c in letters if not _accent(c)))


def _accent(letter: str) -> bool:
    """Whether it is an accent that stands over a Latin letter."""
    return "\u0300" <= letter <= "\u036f"


def _begins(word: str, stems: Sequence[str]) -> bool:
    """Whether a word begins with a stem; a sign of several meanings stands anywhere in it."""
    return any(stem in word if stem > "\u2e80" else word.startswith(stem) for stem in stems)


def _unit_behind(name: str) -> str:
    """The unit at the end of a name: `knee_rad`, `motor_Nm`, `speed_rad_s`."""
    parts = name.split("_")
    for count in (3, 2, 1):
        end = "_".join(parts[-count:])
        if len(parts) > count and end in _SUFFIXES:
            return _SUFFIXES[end]
    return ""


def _by_unit(unit: str) -> str:
    try:
        return _SI.get(conversion(unit).si, "") if unit else ""
    except UnitError:
        return ""
