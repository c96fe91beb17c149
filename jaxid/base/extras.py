"""Packages that only some commands need: each belongs to an extra of `pyproject.toml`."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from typing import Any

from jaxid.base.errors import UsageError


#: Package on disk -> (the extra that brings it, what needs it).
EXTRAS = {
    "arviz": ("posterior", "`--posterior`"),
    "blackjax": ("posterior", "`--posterior`"),
    "cryptography": ("batch", "`--cluster slurm`"),
    "dask": ("batch", "`jaxid batch`"),
    "distributed": ("batch", "`jaxid batch`"),
    "psutil": ("batch", "`jaxid batch`"),
    "dynamixel_sdk": ("hardware", "recording from Dynamixel servos"),
    "rtde_control": ("hardware", "motion of a UR arm"),
    "serial": ("hardware", "a serial port"),
    "h5py": ("mat", "a MAT file of version 7.3"),
    "nptdms": ("tdms", "a TDMS file"),
    "mcap": ("ros", "an MCAP file"),
    "rosbags": ("ros", "a ROS recording"),
    "bokeh": ("view", "`jaxid view` or `jaxid watch`"),
    "tornado": ("view", "`jaxid view` or `jaxid watch`"),
}


def required(package: str) -> None:
    """Raises `UsageError` that names the extra to install where a package is missing; imports
    nothing.
    """
    if find_spec(package) is None:
        raise missing(package)


def needed(module: str) -> Any:
    """The optional module. Raises `UsageError` that names the extra to install where it is
    missing.
    """
    try:
        return import_module(module)
    except ImportError:
        raise missing(module.partition(".")[0]) from None


def missing(package: str) -> UsageError:
    """What to say of a package that is not installed."""
    extra, user = EXTRAS[package]
    reason = f"{user} needs the package {package}, which is not installed"
    return UsageError(f'{reason}; type: pip install "jaxid[{extra}]"')
