"""Robots as their owners have them: trees of joints from MJCF and URDF, their dynamics, drives, and
what their files state.
"""
