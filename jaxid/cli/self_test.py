"""Whether jaxid works on this computer: versions, cores, the cache of programs, extras, and a self
test against a motion that is known in closed form.
"""

from __future__ import annotations

import os
import platform
import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxid.base.computer import own_cores
from jaxid.base.extras import EXTRAS
from jaxid.base.serialise import SCHEMA
from jaxid.base.versions import versions
from jaxid.robots.mjcf_spec import library


#: What a computation rests on, as it is called where it is installed from.
PACKAGES = (
    "jaxid",
    "jax",
    "jaxlib",
    "equinox",
    "diffrax",
    "optimistix",
    "numpy",
    "scipy",
    "mujoco",
)

#: The joint of the self test: inertia (kg m^2), viscous friction (N m s/rad), noise of the encoder
#: (rad), sampling period (s) and the delay (samples) that the second test withholds.
INERTIA, VISCOUS, NOISE, PERIOD, DELAY = 0.08, 0.4, 1e-4, 0.004, 5
SAMPLES = 1500
#: A number has come back where it is this near to the true one, in its standard deviations.
NEAR = 4.0


@dataclass(frozen=True, kw_only=True)
class Test:
    """One thing that was tried: whether it went well, and what was seen."""

    name: str
    passed: bool
    seen: str


@dataclass(frozen=True, kw_only=True)
class Health:
    """What `jaxid doctor` found. `cache_bytes` is None where no folder can be written; `extras`
    says of each whether its packages are installed.
    """

    python: str
    system: str
    packages: dict[str, str]
    cores: int
    memory_bytes: int | None
    devices: tuple[str, ...]
    cache: str | None
    cache_bytes: int | None
    extras: dict[str, bool]
    tests: tuple[Test, ...]

    @property
    def well(self) -> bool:
        """Whether all that was tried went well."""
        return all(test.passed for test in self.tests)

    def to_dict(self) -> dict[str, Any]:
        return {"schema": SCHEMA, "kind": "doctor", "well": self.well, **asdict(self)}


def examine(tell: Callable[[str], None] | None = None) -> Health:
    """Looks at this computer and runs the self test, which compiles for about a minute the first
    time. `tell` hears what is being tried.
    """
    import jax

    from jaxid.runtime import cache_folder

    folder = cache_folder()
    tests = []
    for name, attempt in SELF_TESTS.items():
        if tell is not None:
            tell(name)
        tests.append(_tried(name, attempt))
    return Health(
        python=f"{platform.python_version()} ({sys.executable})",
        system=platform.platform(),
        packages=versions(PACKAGES),
        cores=own_cores(),
        memory_bytes=_memory(),
        devices=tuple(str(device) for device in jax.devices()),
        cache=None if folder is None else str(folder),
        cache_bytes=None if folder is None else _size(folder),
        extras=_extras(),
        tests=tuple(tests),
    )


def _memory() -> int | None:
    """Bytes of the computer, where the system tells."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, OSError, ValueError):
        return None


def _size(folder: Path) -> int:
    """Bytes of the files in a folder; those that vanish meanwhile count as none."""
    total = 0
    for file in folder.rglob("*"):
        try:
            if file.is_file():
                total += file.stat().st_size
        except OSError:
            continue
    return total


def _extras() -> dict[str, bool]:
    """Extra -> whether all of its packages can be found."""
    found: dict[str, bool] = {}
    for package, (extra, _) in EXTRAS.items():
        found[extra] = found.get(extra, True) and find_spec(package) is not None
    return found


def _tried(name: str, attempt: Callable[[], Test]) -> Test:
    """The test; whatever it raises is what was seen."""
    try:
        return attempt()
    except Exception as error:
        return Test(name=name, passed=False, seen=f"{type(error).__name__}: {error}")


# ---- self test


def motion(tau: Float[np.ndarray, " time"], delay: int) -> Float[np.ndarray, " time"]:
    """Position (rad) of the joint under a torque (N m) that is held from sample to sample, from
    rest at zero: the closed form of inertia qdd + viscous qd = tau, step by step. The torque acts
    `delay` samples late.
    """
    late = np.concatenate([np.zeros(delay), tau])[: len(tau)]
    decay = np.exp(-VISCOUS / INERTIA * PERIOD)
    reach = INERTIA / VISCOUS * (1 - decay)
    q = np.zeros(len(tau))
    speed = 0.0
    for k in range(1, len(tau)):
        final = late[k - 1] / VISCOUS
        q[k] = q[k - 1] + final * PERIOD + (speed - final) * reach
        speed = final + (speed - final) * decay
    return q


def twin(delay: int) -> Any:
    """Three recordings of the joint under steps of torque, with the noise of an encoder: one to
    fit, one to validate, one to report.
    """
    from jaxid.data.dataset import Dataset

    random = np.random.default_rng(5)
    t = PERIOD * np.arange(SAMPLES)
    levels = random.uniform(-1, 1, (3, SAMPLES // 50))
    levels[:, 0] = 0  # what came before a recording is not known
    torques = list(np.repeat(levels, 50, axis=1))
    positions = [motion(tau, delay) + NOISE * random.standard_normal(SAMPLES) for tau in torques]
    return Dataset.from_arrays(
        [t, t, t],
        {"tau": torques},
        {"q": positions},
        split=["fit", "validation", "report"],
        at_rest=True,
        noise_std={"q": NOISE},
        name="self test",
        model="joint",
    )


def numbers_come_back() -> Test:
    """A fit of the joint against the numbers that made its motion."""
    import jaxid

    fit = jaxid.fit(model="joint", dataset=twin(delay=0))
    seen = []
    passed = not fit.failed
    for name, true in (("inertia", INERTIA), ("viscous", VISCOUS)):
        found = fit.parameters[name]
        std = found.std
        passed = passed and std is not None and abs(found.value - true) < NEAR * std
        seen.append(f"{name} {found.value:.5g} for {true:g}")
    return Test(name=FIT, passed=passed, seen=", ".join(seen))


def the_delay_is_named() -> Test:
    """A diagnosis of the joint whose torque acts late, among all effects of timing."""
    import jaxid
    from jaxid.dynamics.catalogue import effect_class, effect_names

    joint = jaxid.Chain(jaxid.models.Joint())
    kinds = [effect_class(name) for name in effect_names()]
    asked = [k.name for k in kinds if k.acts_on == "timing" and joint.offers(k)]
    found = jaxid.diagnose("joint", twin(delay=DELAY), effects=asked, max_effects=1)
    delays = []
    for effect in found.which.effects:
        delays += [n.value for key, n in effect.parameters.items() if key.startswith("delay")]
    right = [delay for delay in delays if abs(delay / (DELAY * PERIOD) - 1) < 0.05]
    named = ", ".join(effect.effect for effect in found.which.effects)
    told = ", ".join(f"{delay:.3g} s" for delay in delays)
    return Test(
        name=DIAGNOSIS,
        passed=found.which.verdict == "named" and len(right) == 1,
        seen=f"{found.which.verdict}: {named or 'nothing'}, {told} for {DELAY * PERIOD:g} s",
    )


def mujoco_steps() -> Test:
    """MuJoCo's run of the joint against the closed form."""
    mujoco = library()
    model = mujoco.MjModel.from_xml_string(f"""
        <mujoco><option timestep="{PERIOD / 20}" integrator="RK4" gravity="0 0 0"/><worldbody><body>
        <joint name="q" type="hinge" axis="0 1 0" damping="{VISCOUS}"/>
        <inertial pos="0 0 0" mass="1" diaginertia="{INERTIA} {INERTIA} {INERTIA}"/>
        </body></worldbody><actuator><motor joint="q"/></actuator></mujoco>""")
    data = mujoco.MjData(model)
    tau = np.repeat([0.5, -0.3], 25)
    wrong = 0.0
    for torque, expected in zip(tau[:-1], motion(tau, 0)[1:], strict=True):
        data.ctrl[0] = torque
        for _ in range(20):
            mujoco.mj_step(model, data)
        wrong = max(wrong, abs(float(data.qpos[0]) - float(expected)))
    return Test(name=SIMULATOR, passed=wrong < 1e-6, seen=f"within {wrong:.1g} rad")


SIMULATOR = "MuJoCo moves a joint as its equation says"
FIT = "a fit finds the numbers that made a recording"
DIAGNOSIS = "a diagnosis names the effect that was withheld"
#: Name -> what is tried.
SELF_TESTS: dict[str, Callable[[], Test]] = {
    SIMULATOR: mujoco_steps,
    FIT: numbers_come_back,
    DIAGNOSIS: the_delay_is_named,
}
