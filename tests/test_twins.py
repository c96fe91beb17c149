"""The plants of the notebooks against a separate library, so that a notebook's machine is none of
our own making.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from jaxid.models import UR10
from jaxid.numerics.precision import float64
from jaxid.study.papers.twins.serial_arm import torques


ROOT = Path(__file__).resolve().parents[1]


def test_the_arm_is_that_of_pinocchio():
    pin = pytest.importorskip("pinocchio")
    arm, model, parent = UR10(), pin.Model(), 0
    with float64():
        bodies, drives, (alpha, a, d) = (
            np.array(arm.inertia()),
            np.array(arm.Ia),
            [np.array(x) for x in (arm.alpha, arm.a, arm.d)],
        )
    for j, (xx, xy, xz, yy, yz, zz, hx, hy, hz, m) in enumerate(bodies):
        turn = pin.SE3(pin.utils.rotate("x", float(alpha[j])), np.zeros(3))
        along, up = np.array([float(a[j]), 0, 0]), np.array([0, 0, float(d[j])])
        place = turn * pin.SE3(np.eye(3), along) * pin.SE3(np.eye(3), up)
        parent = model.addJoint(parent, pin.JointModelRZ(), place, f"joint {j + 1}")
        body = pin.Inertia.FromDynamicParameters(np.array([m, hx, hy, hz, xx, xy, yy, xz, yz, zz]))
        model.appendBodyToJoint(parent, body, pin.SE3.Identity())
    model.armature = drives
    data, motion = model.createData(), np.random.default_rng(0).normal(size=(3, 20, 6))
    truth = np.array([pin.rnea(model, data, *state) for state in zip(*motion, strict=True)])
    np.testing.assert_allclose(
        torques(alpha, a, d, bodies, drives, tuple(motion)), truth, rtol=1e-9, atol=1e-9
    )


def test_twins_and_papers_need_no_more_than_the_library_installs():
    """What a notebook or a table of the papers imports is there after the README's command."""
    names = ("pytest", "pinocchio", "hypothesis", "simulated", "sympy")
    missing = f"import sys; sys.modules.update(dict.fromkeys({names}))"
    code = f"{missing}; import benchmarks.papers, jaxid.study.papers.twins.flexible_link, jaxid.study.papers.twins.serial_arm"
    ran = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=120
    )
    assert ran.returncode == 0, ran.stderr
    for path in (ROOT / "notebooks").glob("*.py"):
        for word in (
            "import pytest",
            "import pinocchio",
            "from tests",
            "import tests",
            "from simulated",
        ):
            assert word not in path.read_text(), f"{path.name}: {word}"


def test_the_runtime_can_be_prepared_as_the_readme_types_it():
    code = "import jaxid; jaxid.runtime.prepare(); print(jaxid.runtime.__name__)"
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert ran.returncode == 0 and ran.stdout.strip() == "jaxid.runtime", ran.stderr
