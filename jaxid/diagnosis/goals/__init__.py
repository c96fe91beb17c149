"""Diagnosis of robots that goals drive through a law: proposed along the measured motion, decided
by simulation.
"""
