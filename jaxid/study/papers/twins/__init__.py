"""Plants of the papers, written apart from the library, so that they can be taken for a machine."""
