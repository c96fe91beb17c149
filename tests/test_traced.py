"""Traced programs on disk: the same bits when read back, and never another program's."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxid.dynamics.chain import Chain
from jaxid.dynamics.parameter_vector import ParameterVector
from jaxid.models import Pendulum
from jaxid.numerics import export_cache as traced
from jaxid.numerics.export_cache import ExportedFunction, key_of
from jaxid.numerics.precision import float64
from jaxid.simulation.rollout import inverse_dynamics_rollout, simulate_rollout


@pytest.fixture
def folder(tmp_path):
    before = jax.config.values["jax_compilation_cache_dir"]
    jax.config.update("jax_compilation_cache_dir", str(tmp_path))
    yield tmp_path / "traced"
    jax.config.update("jax_compilation_cache_dir", before)


def bent(x, y):
    return jnp.sin(x) * y["scale"], x.sum()


def test_what_is_read_back_gives_the_same_bits(folder, monkeypatch):
    x, y = np.linspace(0, 3, 7), {"scale": np.float64(1.7)}
    with float64():
        plain = jax.jit(bent)(x, y)
        first = ExportedFunction(bent, "key")(x, y)
        (file,) = folder.iterdir()
        content = file.read_bytes()
        monkeypatch.setattr(jax.export, "export", None)  # a second process does not trace
        second = ExportedFunction(lambda *_: pytest.fail("traced again"), "key")(x, y)
        assert all(
            np.array_equal(a, b) and np.array_equal(a, c)
            for a, b, c in zip(plain, first, second, strict=True)
        )
        assert file.read_bytes() == content


def test_other_shapes_and_keys_are_other_programs(folder):
    with float64():
        f = ExportedFunction(bent, "key")
        for n in (3, 4):
            assert f(np.ones(n), {"scale": np.float64(2.0)})[1] == n
        assert ExportedFunction(lambda x: x + 1, "another")(np.ones(3)).tolist() == [2, 2, 2]
    assert len(list(folder.iterdir())) == 3


def test_another_device_is_another_program(folder, monkeypatch):
    """A program is exported for one platform: one of a GPU refuses to run where
    `jax.default_device` names the CPU.
    """
    x, y = np.ones(3), {"scale": np.float64(2.0)}
    cpu = jax.devices("cpu")[0]
    with float64():
        ExportedFunction(bent, "key")(x, y)
        monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
        assert not ExportedFunction(bent, "key").kept(x, y)
        assert ExportedFunction(bent, "key").kept(*jax.device_put((x, y), cpu))
        with jax.default_device(cpu):
            assert ExportedFunction(bent, "key").kept(x, y)


@pytest.mark.parametrize("content", [b"", b"no program", b"\0" * 5000])
def test_a_broken_file_is_no_harm(folder, content):
    x, y = np.ones(3), {"scale": np.float64(2.0)}
    with float64():
        expected = ExportedFunction(bent, "key")(x, y)
        (file,) = folder.iterdir()
        file.write_bytes(content)
        assert np.array_equal(ExportedFunction(bent, "key")(x, y)[0], expected[0])


def test_no_folder_no_file(tmp_path, monkeypatch):
    blocked = tmp_path / "file"
    blocked.write_text("")
    before = jax.config.values["jax_compilation_cache_dir"]
    jax.config.update("jax_compilation_cache_dir", str(blocked))  # nothing can be made below a file
    try:
        with float64():
            assert ExportedFunction(bent, "key")(np.ones(3), {"scale": np.float64(2.0)})[1] == 3
    finally:
        jax.config.update("jax_compilation_cache_dir", before)


def test_the_key_holds_what_a_trace_depends_on(monkeypatch):
    chain = Chain(Pendulum())
    key = key_of(simulate_rollout, chain, 512)
    assert key is not None and key == key_of(simulate_rollout, Chain(Pendulum()), 512)
    assert key != key_of(simulate_rollout, chain, 1024)
    assert key != key_of(inverse_dynamics_rollout, chain, 512)
    assert key != key_of(simulate_rollout, chain.without("viscous_friction"), 512)
    assert key != key_of(simulate_rollout, Chain(Pendulum(), smoothing_velocity=0.01), 512)
    monkeypatch.setattr(traced, "_own_sources", lambda: "changed")
    assert key != key_of(simulate_rollout, chain, 512)


class Own(Pendulum):
    """A model from outside of the package."""


def test_the_programs_of_own_models_are_not_kept():
    layout = ParameterVector(Chain(Own()))
    assert key_of(simulate_rollout, layout.chain) is None
    assert key_of(lambda: None, Chain(Pendulum())) is None
    assert key_of(bent, Chain(Pendulum())) is None
