"""Protocol emulators with a simulated plant, on loopback or a pty only."""
