"""Which of a result's numbers stay as the file has them: those that the data do not tell from the file's."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from jaxid.robots.export.outcome import AS_STATED, Number, number, Outcome
from jaxid.wording import value_with_std


def kept(found: Outcome) -> Outcome:
    """The result with those of the file's numbers that its data do not refute as the file has them, and the others with the
    digits that they bear. Together the former are within what the data leave open (95 %, all others as fitted): one that is
    near the file's beside one that it goes with is not left behind."""
    stated = _stated(found)
    known = [k for k in stated if _std(found.parameters[k]) is not None]
    left = set(_indistinct(found, known, np.array([found.parameters[k].value - stated[k] for k in known])))
    if _unexplained(found):
        left |= {k for k in stated if k not in known}
    left |= {k for k, value in stated.items() if found.parameters[k].value == value}
    numbers = {k: _as_stated(n, stated[k]) if k in left else _rounded(n) for k, n in found.parameters.items()}
    effects = tuple(replace(e, numbers={k: _rounded(n) for k, n in e.numbers.items()}) for e in found.effects)
    return replace(found, parameters=numbers, effects=effects)


def _stated(found: Outcome) -> dict[str, float]:
    """What the file, or the dataset, states of the numbers that were fitted, by their names."""
    rows, out = found.content.get("stated"), {}
    for row in rows if isinstance(rows, list) else []:
        if not isinstance(row, Mapping):
            continue
        kind = row.get("parameter")
        for name in (f"{kind}@{row.get('link')}", f"{kind}@{row.get('joint')}", str(kind)):
            if name in found.parameters and name not in out:
                out[name] = number(f"stated {name}", row.get("stated"))
    return out


def _std(n: Number) -> float | None:
    return n.std if n.std is not None and n.std > 0 and not n.at_bound else None


def _unexplained(found: Outcome) -> bool:
    which = found.content.get("which")
    return isinstance(which, Mapping) and which.get("verdict") == "unknown"


def _indistinct(found: Outcome, names: list[str], off: np.ndarray) -> list[str]:
    """Those of the names whose stated values the data allow, all together. One after the other is taken out, by how much it is
    refuted beside the rest."""
    from scipy.stats import chi2

    information = _information(found, names)
    left = list(range(len(names)))
    while left:
        d, I = off[left], information[np.ix_(left, left)]
        if d @ I @ d <= chi2.ppf(0.95, len(left)):
            break
        without = [
            d @ I @ d - (np.delete(d, k) @ np.delete(np.delete(I, k, 0), k, 1) @ np.delete(d, k)) for k in range(len(left))
        ]
        left.pop(int(np.argmax(without)))
    return [names[k] for k in left]


def _information(found: Outcome, names: list[str]) -> np.ndarray:
    """Of these numbers with all others as fitted, [n n]; by the standard deviations alone where the result has no covariance."""
    std = np.array([found.parameters[k].std for k in names], float)
    at = [found.names.index(k) if k in found.names else -1 for k in names]
    if any(k < 0 for k in at):
        return np.diag(1 / std**2)
    C = found.covariance
    size = np.sqrt(np.diag(C))
    usable = np.flatnonzero(np.isfinite(C).any(1) & (size > 0))
    if not set(at) <= set(usable.tolist()) or not np.isfinite(C[np.ix_(usable, usable)]).all():
        return np.diag(1 / std**2)
    R = C[np.ix_(usable, usable)] / np.outer(size[usable], size[usable])
    own = [int(np.flatnonzero(usable == k)[0]) for k in at]
    return np.linalg.pinv(R, hermitian=True)[np.ix_(own, own)] / np.outer(std, std)


def _as_stated(n: Number, stated: float) -> Number:
    told = value_with_std(n) if n.std is not None else "nothing"
    return replace(n, value=stated, kept=f"{AS_STATED}: the data say {told}")


def _rounded(n: Number) -> Number:
    """With two digits more than its standard deviation has."""
    if n.std is None or not n.std > 0:
        return n
    return replace(n, value=float(round(n.value, int(2 - np.floor(np.log10(n.std))))))
