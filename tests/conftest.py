"""Settings that every test shares: the flags of the command line, and a cache of compiled programs
of their own.
"""

import os
from pathlib import Path

from jaxid.runtime import prepare


os.environ.setdefault(
    "JAXID_CACHE_DIR", str(Path(__file__).resolve().parents[1] / ".pytest_cache" / "programs")
)
prepare()  # before anything imports JAX
