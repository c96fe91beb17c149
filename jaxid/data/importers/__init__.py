"""Recordings of others, as datasets: one kind of file a module."""
