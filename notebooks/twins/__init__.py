"""Plants of the notebooks, written apart from the library, so that they can be taken for a machine."""
