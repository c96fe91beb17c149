"""`python -m jaxid.cli`."""

from jaxid.cli.app import run


run()
