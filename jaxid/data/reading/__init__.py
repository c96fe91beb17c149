"""A recording read, checked, and held against the model that it states."""
