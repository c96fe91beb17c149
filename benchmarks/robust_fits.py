"""Random fits: how many are right, say that they failed, or are wrong and say that they converged;
beside SciPy on the same residuals from the same starts.

Models of the library and ones with a drive of their own, speeds as outputs, no offset (a joint
stands still without any force), start values off by up to a factor of ten, and every tenth with
data that cannot determine a number. A fit is right where every number that it calls determined lies
within four of its standard deviations, or two percent, of the truth.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

from jaxid.runtime import prepare


prepare()

import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
from jaxtyping import Array  # noqa: E402
from scipy.optimize import least_squares  # noqa: E402

import jaxid  # noqa: E402
from jaxid.data.dataset import ModelSpec, ParameterPrior  # noqa: E402
from jaxid.dynamics.chain import Chain  # noqa: E402
from jaxid.dynamics.joint_readings import with_speeds  # noqa: E402
from jaxid.dynamics.mechanism import Rigid, Signature  # noqa: E402
from jaxid.dynamics.parameter import constant, param  # noqa: E402
from jaxid.fitting.problem_builder import ProblemBuilder  # noqa: E402
from jaxid.models import Joint, Pendulum, Servo  # noqa: E402
from jaxid.models.effects import CoulombFriction, ViscousFriction  # noqa: E402
from jaxid.problem.binding import bind  # noqa: E402
from jaxid.problem.objective import rows  # noqa: E402
from jaxid.problem.residual import OutputError  # noqa: E402


sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from tests.simulated import Simulator  # noqa: E402


class VoltAxis(Rigid):
    """mass qdd = gain u - back_emf qd - friction."""

    name: ClassVar[str] = "volt_axis"
    signatures: ClassVar[tuple[Signature, ...]] = (
        Signature((("u", "V"),), (("position", "m"),), ("position",)),
    )
    builtin: ClassVar[tuple[tuple[type, dict[str, str]], ...]] = (
        (ViscousFriction, {"coefficient": "viscous"}),
        (CoulombFriction, {"level": "coulomb"}),
    )
    equations: ClassVar[str] = "mass qdd = gain u - friction"
    source: ClassVar[str] = "textbook"
    mass: Array = param(2.0, 1e-3, 1e4, unit="{I}", log=True)
    gain: Array = constant(8.0, unit="N/V")

    def drive(self, signature, u, q, qd):
        return self.gain * u

    def matrices(self, q, qd):
        return self.mass[None, None], jnp.zeros_like(q)


#: Mechanism, the speeds that are read in place of positions, true numbers, size of the input.
KINDS = (
    (Joint, {}, {"inertia": 0.02, "viscous": 0.03, "coulomb": 0.05}, 0.5),
    (Joint, {"qd": "rad/s"}, {"inertia": 0.02, "viscous": 0.03, "coulomb": 0.05}, 0.5),
    (Pendulum, {}, {"inertia": 0.08, "gravity_torque": 1.5, "viscous": 0.05, "coulomb": 0.08}, 1.2),
    (
        Pendulum,
        {"qd": "rad/s"},
        {"inertia": 0.08, "gravity_torque": 1.5, "viscous": 0.05, "coulomb": 0.08},
        1.2,
    ),
    (VoltAxis, {}, {"mass": 2.0, "viscous": 4.0, "coulomb": 3.0}, 2.0),
    (VoltAxis, {"velocity": "m/s"}, {"mass": 2.0, "viscous": 4.0, "coulomb": 3.0}, 2.0),
    (Servo, {}, {"viscous": 0.02, "coulomb": 0.03, "armature": 0.004}, 0.8),
)
NOISE = {"rad": 1e-3, "m": 1e-4, "rad/s": 1e-2, "m/s": 2e-3}
#: What a model that lacks it is not asked for.
LEFT_OUT = ("constant_torque",)


def one_case(number: int, rng: np.random.Generator):
    """(chain, dataset, truth, whether the data determine all)."""
    kind, speeds, centre, size = KINDS[number % len(KINDS)]
    own = kind()
    signature = own.signatures[-1] if kind is Servo else own.signatures[0]
    signature = with_speeds(signature, speeds) if speeds else signature
    chain = Chain(own, signature=signature).without(*LEFT_OUT)
    truth = {k: v * np.exp(rng.uniform(-0.7, 0.7)) for k, v in centre.items()}
    blind = number % 10 == 9
    t = np.arange(0, 8, 0.01)
    u = size * np.sin(2 * np.pi * np.cumsum(np.interp(t, [0, 8], rng.uniform(0.1, 1.5, 2))) * 0.01)
    u = (
        size * np.tanh(t) if blind else np.where((t > 3) & (t < 4.5), 0.0, u)
    )  # one way only; or no force for a while
    sim = Simulator(chain, t, u[:, None], size=2048)
    clean = sim.outputs([truth])[0]
    channels = {
        name: clean[:, k] + NOISE[unit] * rng.standard_normal(len(t))
        for k, (name, unit) in enumerate(signature.outputs)
    }
    parameters = {
        k: ParameterPrior(v * 10 ** rng.uniform(-1, 1), v / 1e3, v * 1e3) for k, v in truth.items()
    }
    free = [e.name for e in sim.layout.entries if not e.spec.fixed and e.name not in truth]
    constants = {name: float(sim.layout.values[sim.layout.index(name)]) for name in free}
    data = jaxid.Dataset.from_arrays(
        t,
        {signature.inputs[0][0]: u},
        channels,
        units=dict((*signature.inputs, *signature.outputs)),
        noise_std={n: NOISE[unit] for n, unit in signature.outputs},
        at_rest=True,
    )
    data = replace(data, model=ModelSpec(constants=constants, parameters=parameters))
    return chain, data, truth, blind


def right(found: dict[str, tuple[float, float | None]], truth: dict[str, float]) -> bool:
    return all(
        std is None or abs(value - truth[k]) <= max(4 * std, 0.02 * truth[k])
        for k, (value, std) in found.items()
        if k in truth
    )


def by_scipy(
    chain: Chain, data: jaxid.Dataset
) -> tuple[bool, dict[str, tuple[float, float | None]]]:
    """Whether SciPy says success, and its numbers, on the residuals of the fit from its start."""
    b = bind(chain, data)
    problem = ProblemBuilder(b).problem(OutputError(), "fit", b.free, b.theta)

    def both(z):
        parts = list(rows([(problem, z)]))
        r, J = np.concatenate([p.r.ravel() for p in parts]), np.zeros((0, problem.size))
        for p in parts:
            own = np.zeros((p.r.size, problem.size))
            own[:, p.z_columns] = p.J.reshape(p.r.size, -1)
            J = np.concatenate([J, own])
        return np.nan_to_num(r, nan=1e6, posinf=1e6), np.nan_to_num(J)

    z = problem.z(b.theta)
    box, slope_of = (problem.lower, problem.upper), lambda z: both(z)[1]
    end = least_squares(lambda z: both(z)[0], z, slope_of, box, x_scale="jac", max_nfev=100)  # pyright: ignore[reportArgumentType]
    r, J = both(end.x)
    variance = np.diag(np.linalg.pinv(J.T @ J)) * max(1.0, float(np.mean(r**2)))
    theta, slope = problem.theta(end.x), problem.dtheta(end.x)
    numbers: dict[str, tuple[float, float | None]] = {
        b.layout.names[i]: (float(theta[i]), float(np.sqrt(variance[k]) * slope[k]))
        for k, i in enumerate(problem.free)
    }
    return bool(end.success), numbers


def counted(numbers: Iterable[int], seed: int = 0) -> tuple[Counter[str], Counter[str]]:
    """Outcomes of these cases, ours and SciPy's; who is not right is printed."""
    ours: Counter[str] = Counter()
    theirs: Counter[str] = Counter()
    for number in numbers:
        rng = np.random.default_rng([seed, number])
        chain, data, truth, blind = one_case(number, rng)
        fit = jaxid.fit(chain, data, seed=number)
        found = {k: (p.value, p.std if p.identifiable else None) for k, p in fit.parameters.items()}
        said = outcome(right(found, truth) and fit.state != "failed", fit.state)
        ours[said] += 1
        success, scipys = by_scipy(chain, data)
        theirs[outcome(right(scipys, truth), "converged" if success else "failed")] += 1
        if said != "right":
            name = f"{number} {chain.mechanism.name}{', blind' if blind else ''}"
            print(f"{name}: {said}, loss {fit.loss:.3g}, {fit.stopped_because}", file=sys.stderr)
    return ours, theirs


def result(ours: Counter[str], theirs: Counter[str]) -> dict[str, Any]:
    """The table of both."""
    count = ours.total()
    rows = [
        {"fitter": name, **{k: f"{100 * table[k] / count:.1f} %" for k in OUTCOMES}}
        for name, table in (("jaxid", ours), ("SciPy least_squares", theirs))
    ]
    return {
        "title": "Random fits: right, failed, wrong",
        "text": f"{count} fits. {' '.join((__doc__ or '').split())}",
        "rows": rows,
    }


def main(count: int = 500, seed: int = 0) -> dict[str, Any]:
    return result(*counted(range(count), seed))


OUTCOMES = (
    "right",
    "right, says it did not converge",
    "wrong, says it did not converge",
    "wrong, says converged",
)


def outcome(good: bool, state: str) -> str:
    if state == "converged":
        return "right" if good else "wrong, says converged"
    return OUTCOMES[1] if good else OUTCOMES[2]


if __name__ == "__main__":
    import json

    print(json.dumps(main(*map(int, sys.argv[1:])), indent=1))
