"""How much the notebooks compute, in one place: all of it, or with JAXID_NOTEBOOKS=small (the tests) the least that shows the same.

Also finds the repository from here, so that the notebooks run from any folder.
"""

import os
import sys
from pathlib import Path


SMALL = os.environ.get("JAXID_NOTEBOOKS") == "small"
ROOT = next(
    p for p in Path(__file__).resolve().parents if (p / "examples" / "servo_pendulum").is_dir()
)
EXAMPLE = ROOT / "examples" / "servo_pendulum"
sys.path.insert(
    0, str(ROOT)
)  # the twins in notebooks/ and benchmarks/ are separately written equations

#: Candidates of a diagnosis: None is the whole library.
CANDIDATES = ("dead_zone", "input_delay", "stribeck_friction", "quadratic_drag") if SMALL else None

#: Comparison of fitters: which, how many seeds, how many evaluations each.
COMPARED = (
    ("lm", "de", "rde") if SMALL else ("lm", "hybrid", "de", "rde", "pso", "ga", "cmaes", "shade")
)
SEEDS = 2 if SMALL else 5
EVALUATIONS = 600 if SMALL else 3_000

#: Paper 002: population and generations (the paper: 100 and 100).
LINK_POPULATION, LINK_GENERATIONS, LINK_SEEDS = (10, 4, 2) if SMALL else (100, 100, 5)

#: Paper 003: population and generations (the paper: 20, not stated).
TRACKER_POPULATION, TRACKER_GENERATIONS, TRACKER_SEEDS = (10, 5, 1) if SMALL else (20, 60, 5)

#: Paper 001: repetitions of the payload experiment.
PAYLOADS = 2 if SMALL else 12

#: Paper 000: runs of each algorithm, and evaluations each.
ARM_SEEDS, ARM_EVALUATIONS = (2, 800) if SMALL else (5, 10_000)
#: While following a change: blocks of data (half before the change), generations of the search on the first three.
ARM_BLOCKS, ARM_GENERATIONS = (8, 30) if SMALL else (12, 200)

#: Frames of an animation.
FRAMES = 6 if SMALL else 60

#: Candidates of a robot's diagnosis: None is the whole library.
ROBOT_CANDIDATES = (
    ("input_delay", "torque_scale", "stribeck_friction", "constant_torque") if SMALL else None
)
