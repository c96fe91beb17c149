"""Results and settings in files: whole or not at all, whatever ends the process."""
