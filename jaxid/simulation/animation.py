"""Pictures of a mechanism in motion: a strip of poses, an animation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxid.data.dataset import Dataset, Experiment
from jaxid.dynamics.chain import Chain
from jaxid.numerics.precision import float64
from jaxid.simulation import sample_buffers as recorded
from jaxid.simulation.rollout import command_at
from jaxid.simulation.sample_buffers import Samples


#: Frames of a run that are kept: enough for an animation, few enough for a notebook.
FRAMES = 240


@dataclass(frozen=True)
class OutlineMotion:
    """Outline of a mechanism over time: `t [frames]` s, `outline [frames points 2 or 3]` m."""

    name: str
    t: np.ndarray
    outline: np.ndarray

    def strip(self, count: int = 8, ax: Any = None) -> Any:
        """Poses at equal times side by side; returns the Axes."""
        from matplotlib import colormaps
        from matplotlib.figure import Figure

        ax = (
            Figure(figsize=(1.5 * count, 2.2), layout="constrained").add_subplot()
            if ax is None
            else ax
        )
        flat = plane(self.outline)
        low, high = flat.min((0, 1)), flat.max((0, 1))
        width, height = np.maximum(high - low, 0.3 * max(*(high - low), 1e-9))
        pitch = 1.25 * width
        picks = np.linspace(0, len(self.t) - 1, count).round().astype(int)
        for k, i in enumerate(picks):
            shift = np.array([k * pitch, 0.0])
            ax.plot(
                *(flat[picks[max(k - 1, 0)]] + shift).T, color="0.85", lw=3, solid_capstyle="round"
            )
            ax.plot(
                *(flat[i] + shift).T,
                "-",
                color=colormaps["viridis"](0.85 * k / max(count - 1, 1)),
                lw=3,
                solid_capstyle="round",
            )
            ax.plot(*(flat[i, :1] + shift).T, "s", color="0.2", ms=5)
            ax.text(
                *(np.array([low[0] + width / 2, low[1] - 0.18 * height]) + shift),
                f"{self.t[i]:.2f} s",
                ha="center",
                va="top",
                fontsize=9,
            )
        ax.set_aspect("equal")
        ax.set_axis_off()
        ax.set_title(
            f"{self.name}: poses over time (grey: the one before)", fontsize=10, loc="left"
        )
        return ax

    def animate(self, seconds: float | None = None, frames: int = 80) -> Any:
        """An animation in real time (or over `seconds`), as matplotlib's FuncAnimation:
        `.to_jshtml()` shows it in a notebook, with a picture for each of the `frames`.
        """
        from matplotlib import pyplot
        from matplotlib.animation import FuncAnimation

        picks = (
            np.linspace(0, len(self.t) - 1, max(2, min(frames, len(self.t)))).round().astype(int)
        )
        flat, t = plane(self.outline), self.t - self.t[0]
        low, high = flat.min((0, 1)), flat.max((0, 1))
        margin = 0.1 * max(*(high - low), 1e-9)
        figure, ax = pyplot.subplots(figsize=(4, 4))
        pyplot.close(figure)
        ax.set(
            xlim=(low[0] - margin, high[0] + margin),
            ylim=(low[1] - margin, high[1] + margin),
            aspect="equal",
        )
        ax.set_axis_off()
        (line,) = ax.plot([], [], "-o", color="#0072b2", lw=3, ms=4)
        label = ax.text(0.02, 0.97, "", transform=ax.transAxes, va="top")

        def frame(i: int):
            line.set_data(*flat[picks[i]].T)
            label.set_text(f"{t[picks[i]]:.2f} s")
            return line, label

        span = float(t[-1]) if seconds is None else seconds
        return FuncAnimation(
            figure, frame, frames=len(picks), interval=1e3 * span / len(picks), blit=True
        )


def plane(outline: Float[np.ndarray, "frames points d"]) -> Float[np.ndarray, "frames points 2"]:
    """Points in space seen from the front, slightly from above and from the side; points in a plane
    as they are.
    """
    if outline.shape[-1] == 2:
        return outline
    turn, tilt = np.deg2rad(35.0), np.deg2rad(20.0)
    x, y, z = np.moveaxis(outline, -1, 0)
    across, away = np.cos(turn) * y - np.sin(turn) * x, np.sin(turn) * y + np.cos(turn) * x
    return np.stack([across, np.cos(tilt) * z + np.sin(tilt) * away], -1)


def motion(
    model: Chain, dataset: Dataset, experiment: Experiment, start: np.ndarray, noise: np.ndarray
) -> OutlineMotion | None:
    """How a model with its numbers in place moves on an experiment's inputs from `start` (q, qd);
    None without an outline.
    """
    if (
        model.mechanism.outline(
            model.mechanism.start(jnp.zeros(model.nq), jnp.zeros(model.nq)), model.signature
        )
        is None
    ):
        return None
    buffers, (positions,) = recorded.build(dataset, [experiment], model, noise)
    with float64():
        arrays = Samples(*(jnp.asarray(a) for a in buffers))
        shapes = np.asarray(_outlines(model, arrays, jnp.asarray(start), int(positions[-1])))
    picks = positions[np.unique(np.linspace(0, positions.size - 1, FRAMES).round().astype(int))]
    return OutlineMotion(model.mechanism.name, np.asarray(buffers.t)[picks], shapes[picks])


@eqx.filter_jit
def _outlines(model: Chain, samples: Samples, start: Array, last: int) -> Any:
    nq = model.nq
    body = model.body().prepare(None)

    def step(carry, k):
        x = carry.x if body is model.mechanism or type(body) is type(model.mechanism) else None
        if x is None:  # an effect wraps the mechanism: its rigid pose
            x = model.mechanism.start(*body.port(carry.x))
        shape = model.mechanism.outline(x, model.signature)
        return (
            model.step(body, carry, command_at(samples, k, jnp.asarray(0), jnp.asarray(last), 0))[
                0
            ],
            shape,
        )

    carry = model.start(start[:nq], start[nq:], samples.u[0])
    return jax.lax.scan(step, carry, jnp.arange(last + 1))[1]
