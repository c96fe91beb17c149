"""Many rollouts of a chain."""
