"""`python -m jaxid.cli`."""

import sys

from jaxid.cli.app import main


sys.exit(main())
