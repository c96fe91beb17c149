"""One recording, read and checked."""
