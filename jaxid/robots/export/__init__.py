"""A result carried back into the terms of a simulator: the user's own file patched, or code."""
