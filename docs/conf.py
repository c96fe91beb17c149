"""Sphinx: the pages here, those that docs/generate.py writes from the code, and the notebooks with
their outputs.
"""

import hashlib
import os
import shutil
import sys
from pathlib import Path


HERE = Path(__file__).resolve().parent
ROOT = HERE.parent
sys.path.insert(0, str(HERE))

import generate  # noqa: E402

from jaxid import __version__  # noqa: E402


project, author, release = "jaxid", "The jaxid developers", __version__
copyright = "the jaxid developers, Apache-2.0"  # noqa: A001

extensions = ["myst_nb", "sphinx.ext.mathjax"]
myst_enable_extensions = ["dollarmath", "deflist", "colon_fence"]
myst_heading_anchors = 3
html_theme, html_title, html_static_path = "furo", f"jaxid {release}", ["_static"]
html_show_sourcelink = False
exclude_patterns = ["*.py", "notebooks/budget.py", "**/__pycache__"]

# ---- notebooks: copied beside the pages, executed once, kept until their code or the budgets change (`make clean` forgets them)

BUDGET = hashlib.sha256((ROOT / "notebooks" / "budget.py").read_bytes()).hexdigest()[:16]

nb_custom_formats = {".py": "generate.notebook"}
nb_execution_mode = os.environ.get(
    "JAXID_DOCS_NOTEBOOKS", "cache"
)  # off: pages without outputs, in seconds
nb_execution_cache_path = str(ROOT / "out" / "docs_cache" / f"notebooks-{BUDGET}")
nb_execution_timeout = 3600
nb_execution_show_tb = (
    True  # a notebook that fails is a warning, which -W makes an error once all pages are built
)
nb_merge_streams = True

shutil.rmtree(HERE / "notebooks", ignore_errors=True)
shutil.copytree(
    ROOT / "notebooks",
    HERE / "notebooks",
    ignore=shutil.ignore_patterns("__pycache__", ".ipynb_checkpoints"),
)
generate.write(HERE / "generated", ROOT)


#: What Sphinx and the theme write, and what a screen reader and a keyboard need in its place.
ACCESSIBLE = {
    '<p class="caption" role="heading">': '<p class="caption" role="heading" aria-level="2">',
    '<aside class="sidebar-drawer">': '<aside class="sidebar-drawer" aria-label="All pages">',
    '<aside class="toc-drawer': '<aside aria-label="On this page" class="toc-drawer',
    "<pre>": '<pre tabindex="0">',
    '<div class="table-wrapper ': '<div tabindex="0" role="group" aria-label="table" class="table-wrapper ',
}


def setup(app):
    """Links to files of the repository that are pages here under another name; pages that all can
    read.
    """

    def rename(app, page, source):
        source[0] = source[0].replace("](../benchmarks/RESULTS.md)", "](/generated/benchmarks.md)")

    def mend(app, error):
        for page in Path(app.outdir).rglob("*.html") if error is None else ():
            text = page.read_text(encoding="utf-8")
            for written, wanted in ACCESSIBLE.items():
                text = text.replace(written, wanted)
            page.write_text(text, encoding="utf-8")

    app.connect("source-read", rename)
    app.connect("build-finished", mend)
