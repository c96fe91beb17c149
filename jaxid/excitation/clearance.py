"""How near the links of an arm come to each other and to the plane that it stands on: links as
capsules.

A link is the straight line from one joint's frame to the next, with a radius. Links that the chain
joins closely (less than a fifth of its reach between them) cannot be told from neighbours by lines
and are not compared. This is geometry of the table, not of the housings: look at the plotted path,
and at the machine.
"""

from __future__ import annotations

from itertools import combinations
from typing import Any, NamedTuple

import numpy as np

from jaxid.dynamics.kinematics import frames
from jaxid.numerics.linalg import array_module


#: Points of one line that are compared with all of another.
POINTS = 7
NEAR = 0.2


class Links(NamedTuple):
    """Which lines there are (from node i to node i + 1, node 0 the base) and which pairs of them
    are compared.
    """

    lines: tuple[int, ...]
    pairs: tuple[tuple[int, int], ...]


def links_of(arm: Any) -> Links:
    """The lines and pairs of a serial chain."""
    n = len(arm.prismatic)
    node = nodes(arm, np.zeros((1, n)))[0]
    length = np.linalg.norm(np.diff(node, axis=0), axis=1)
    lines = [i for i in range(n) if length[i] > 1e-6]

    def between(i, j):
        return float(length[i + 1 : j].sum())

    reach = float(length.sum())
    pairs = [(i, j) for i, j in combinations(lines, 2) if between(i, j) > NEAR * reach]
    return Links(tuple(lines), tuple(pairs))


def nodes(arm: Any, q: Any) -> Any:
    """Base and joint frames in the base frame, [time n + 1, 3], of motion [time n]; NumPy's or JAX
    arrays, as q is.
    """
    p = frames(arm, arm.prismatic, q.T).p
    xp = array_module(q)
    points = xp.stack([xp.asarray(c) for c in p], -1).swapaxes(0, 1)
    return xp.concatenate([xp.zeros_like(points[:, :1]), points], 1)


def gaps(links: Links, node: Any) -> Any:
    """Distance [time pairs] m of the two lines of each pair, radii not taken off, for nodes [time
    nodes 3].
    """
    xp = array_module(node)
    share = np.linspace(0.0, 1.0, POINTS)[:, None]
    out = []
    for i, j in links.pairs:
        a, b = node[:, i, None], node[:, i + 1, None]
        c, d = node[:, j, None], node[:, j + 1, None]
        some = a + share * (b - a)  # points of one line against the whole of the other
        along = d - c
        place = xp.clip(
            ((some - c) * along).sum(-1) / xp.maximum((along * along).sum(-1), 1e-12), 0.0, 1.0
        )
        out.append(xp.sqrt(((some - c - place[..., None] * along) ** 2).sum(-1) + 1e-12).min(-1))
    return xp.stack(out, -1) if out else xp.full((len(node), 0), xp.inf)


def heights(links: Links, node: Any) -> Any:
    """Height of each node beyond the first line over the plane of the base, [time ...] m."""
    first = links.lines[0] + 2 if links.lines else 1
    return node[:, first:, 2]
