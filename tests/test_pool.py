"""Threads compute on the device and in the precision of who hands the work in."""

from __future__ import annotations

import os
import subprocess
import sys


CODE = """
import jax, jax.numpy as jnp
from jaxid.numerics.pool import Pool
first, second = jax.devices()
pool = Pool("test")
where = lambda _: (next(iter(jnp.ones(3).devices())), jnp.ones(3).dtype.name)
for device in (first, second):
    with jax.default_device(device):
        assert pool.submit(where, 0).result() == (device, "float64"), device
        assert set(pool.map(where, range(8))) == {(device, "float64")}
assert pool.submit(where, 0).result()[0] == first
"""


def test_a_pool_computes_where_its_caller_would():
    environment = {**os.environ, "XLA_FLAGS": "--xla_force_host_platform_device_count=2"}
    subprocess.run([sys.executable, "-c", CODE], env=environment, check=True)
