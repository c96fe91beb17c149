"""Searches that hand out candidates and take their losses, alone or side by side: what they ask for
together fills the cores.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Sequence
from typing import TypeVar

import numpy as np

from jaxid.problem.objective import AbstractProblem, CANDIDATES


Result = TypeVar("Result")
#: A search that hands out candidates [n size], takes their losses [n], and ends with a result.
Searching = Generator[np.ndarray, np.ndarray, Result]


def answered(searching: Searching[Result], problem: AbstractProblem) -> Result:
    """A search taken to its end, its candidates evaluated on all cores."""
    return answered_together([searching], [problem])[0]


def answered_together(
    searches: Sequence[Searching[Result]], problems: Sequence[AbstractProblem]
) -> list[Result]:
    """Several searches taken to their ends side by side; what those on one problem hand out is
    evaluated together.
    """
    results: dict[int, Result] = {}
    asked: dict[int, np.ndarray] = {}

    def go_on(number: int, losses: np.ndarray | None) -> None:
        asked.pop(number, None)
        try:
            asked[number] = searches[number].send(losses)  # pyright: ignore[reportArgumentType] # None begins a generator
        except StopIteration as end:
            results[number] = end.value

    def ask(group: list[int]) -> tuple[list[int], Callable[[], np.ndarray]]:
        return group, problems[group[0]].begun(np.concatenate([asked[number] for number in group]))

    for number in range(len(searches)):
        go_on(number, None)
    groups: dict[int, list[int]] = {}
    for number in asked:
        groups.setdefault(id(problems[number]), []).append(number)
    waiting: deque[tuple[list[int], Callable[[], np.ndarray]]] = deque()
    for group in groups.values():
        members = sum(len(asked[number]) for number in group)
        waiting.extend(map(ask, _shifts(group, members)))
    while waiting:
        group, answer = waiting.popleft()
        losses = answer()
        ends = np.cumsum([len(asked[number]) for number in group])[:-1]
        for number, own in zip(group, np.split(losses, ends), strict=True):
            go_on(number, own)
        if going := [number for number in group if number in asked]:
            waiting.append(ask(going))
    return [results[number] for number in range(len(searches))]


def _shifts(group: list[int], candidates: int) -> list[list[int]]:
    """Searches on one problem, in two halves where each fills the cores: one is evaluated while the
    other thinks.
    """
    half = len(group) // 2
    return [group[:half], group[half:]] if half and candidates >= 8 * CANDIDATES else [group]
