"""The loss of a population on the processor and on an accelerator that JAX sees: the same numbers,
and in what time.

Without an accelerator it raises `FileNotFoundError`, and the last figures stand.
"""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path


os.environ.setdefault(
    "JAX_PLATFORMS", ""
)  # every device that there is: `prepare` would take the processor alone
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from jaxid.runtime import prepare  # noqa: E402


prepare()

import jax  # noqa: E402
import numpy as np  # noqa: E402

import jaxid  # noqa: E402
from jaxid.numerics.precision import float64  # noqa: E402
from tests import reference as ref  # noqa: E402


EXAMPLE = Path(__file__).resolve().parents[1] / "examples" / "servo_pendulum"
SIZES = (64, 1024, 16384)


def flexible_link() -> tuple[jaxid.models.FlexibleLink, jaxid.Dataset]:
    """Four seconds of the finite-element link under a multisine."""
    t = np.arange(2001) * 0.002
    tau = 0.3 * ref.multisine(t, [1.0], 0, periods=2)[:, 0]
    noise = dict(
        zip(
            ("phi", "tip_acceleration"),
            np.random.default_rng(1).normal(0, 1e-4, (2, t.size)),
            strict=True,
        )
    )

    def recorded(outputs):
        settings = {
            "model": "flexible_link",
            "split": ["fit"],
            "at_rest": True,
            "noise_std": dict.fromkeys(outputs, 1e-4),
        }
        return jaxid.Dataset.from_arrays(
            [t], {"tau": [tau]}, {name: [x] for name, x in outputs.items()}, **settings
        )

    model = jaxid.models.FlexibleLink()
    run = jaxid.simulate(model, recorded(noise)).runs[0]
    return model, recorded({name: run[name] + x for name, x in noise.items()})


def seconds(run) -> tuple[float, np.ndarray]:
    """Of the second call, with its result."""
    run()
    began = time.perf_counter()
    answer = run()
    return time.perf_counter() - began, answer


def losses(problem, size: int, device) -> tuple[float, np.ndarray]:
    z0 = np.asarray(problem.z0)
    members = z0 + 0.01 * np.random.default_rng(0).standard_normal((size, z0.size))
    with float64(), jax.default_device(device):
        population = jax.jit(jax.vmap(problem.loss))
        at = jax.device_put(members, device)
        return seconds(lambda: np.asarray(population(at)))


def compared(name: str, problem, here, there) -> list[dict]:
    rows = []
    for size in SIZES:
        slow, on_cpu = losses(problem, size, here)
        fast, on_gpu = losses(problem, size, there)
        apart = float(np.nanmax(np.abs(on_gpu - on_cpu) / np.abs(on_cpu)))
        told = {
            "loss of": name,
            "members": size,
            "processor, s": round(slow, 4),
            "accelerator, s": round(fast, 4),
        }
        rows.append(
            told | {"ratio": round(slow / fast, 2), "largest relative difference": f"{apart:.0e}"}
        )
        print(rows[-1], flush=True)
    return rows


def main() -> dict:
    accelerators = [d for d in jax.devices() if d.platform != "cpu"]
    if not accelerators:
        raise FileNotFoundError("no accelerator that JAX sees")
    there, here = accelerators[0], jax.devices("cpu")[0]
    pendulum = jaxid.make_problem(jaxid.models.Pendulum(), jaxid.load_dataset(EXAMPLE))
    rows = compared("pendulum with dry friction, two runs of 10 s at 250 Hz", pendulum, here, there)
    rows += compared(
        "flexible link, 4 s at 500 Hz", jaxid.make_problem(*flexible_link()), here, there
    )
    return {
        "title": "A population on an accelerator",
        "text": f"`jit(vmap(problem.loss))` in double precision, the second call, on one core and on one {there.device_kind} "
        f"(JAX {jax.__version__}). jaxid's own fitters share a population out over the cores in blocks of 64.",
        "rows": rows,
    }
