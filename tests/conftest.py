"""Settings that every test shares."""

from __future__ import annotations

import os

import pytest


@pytest.fixture(autouse=True, scope="session")
def _compilation_cache(tmp_path_factory):
    """Commands under test keep their compiled programs out of the user's cache folder."""
    os.environ.setdefault("JAXID_CACHE_DIR", str(tmp_path_factory.mktemp("cache")))
