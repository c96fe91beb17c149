"""The four papers this library began with, done again: one module each, on twins written apart from the library."""
