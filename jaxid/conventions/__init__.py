"""Before physics: what a recording says about itself, in its samples and through a model. Light to
import: `checking` does it.
"""
