"""What work will need, said before it begins: memory and time, against what this machine can give.

One principle: work that is large goes by windows and blocks; what would still take more than SHARE
of the memory that is free is done on less where the answer does not need all of it (a diagnosis),
and is otherwise refused with what to do.
"""

from __future__ import annotations

import contextlib
import math
import os
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path

from jaxid.base.errors import UsageError
from jaxid.data.dataset import Dataset, Experiment


#: Share of the free memory that work may take: the rest is for what others start meanwhile, and for
#: what is not foreseen.
SHARE = 0.8
#: Seconds of a diagnosis above which it looks at less.
LONGEST_S = 3600.0
#: Bytes that programs and libraries take, whatever the data.
BASE = 0.7e9
#: Below these no word is said.
SMALL_BYTES, SMALL_S = 1.5e9, 120.0
#: Numbers a row in memory for each channel, joint and parameter of a fit, by benchmarks/memory.py.
FIT_CHANNEL, FIT_JOINT, FIT_NUMBER = 12, 8, 8
#: Seconds of any work: libraries, programs that are compiled or read, the judgement and its page.
START_S = 12.0
#: Along the measured motion, seconds for each row and joint (benchmarks/memory.py, identify).
FORCE_S = 2.3e-5
#: Of free runs, seconds for each row, joint and parameter of one refit (benchmarks/memory.py,
#: diagnosis_speed.py). The nominal model takes FIRST_REFITS, a candidate has more than one start.
REFIT_S, FIRST_REFITS, PER_CANDIDATE = 3e-6, 3.0, 1.5
#: Under goals, seconds for each step, run beside it and joint (benchmarks/robot_speed.py): effects
#: are compared along the measured motion, and few are simulated.
GOALS_S = 1e-5
#: Step of simulations, s.
STEP_S = 2.5e-3


@dataclass(frozen=True)
class Need:
    """What some work on this many rows of this many runs needs: bytes at its peak and seconds, both
    within a factor of about two. The seconds of a fit depend on its fitter and on how far it has to
    go: they are 0, and nobody is told them.
    """

    work: str
    rows: int
    runs: int
    bytes: float
    seconds: float

    def __str__(self) -> str:
        runs = "1 run" if self.runs == 1 else f"{self.runs:,} runs"
        said = f"{self.work} of {self.rows:,} rows in {runs}: about {self.bytes / 1e9:.1f} GB"
        if not self.seconds:
            return said
        minutes = f"{self.seconds / 60:.0f} minutes" if self.seconds > 90 else "a minute or two"
        return f"{said} and {minutes}"

    @property
    def large(self) -> bool:
        """Whether it is worth a word before it begins."""
        return self.bytes > SMALL_BYTES or self.seconds > SMALL_S


def need(
    work: str, dataset: Dataset, joints: int, candidates: int = 0, way: str = "free runs"
) -> Need:
    """Of `fit`, `diagnose` (among this many candidates, by "free runs", along the measured "motion"
    or under "goals") or `identify`, of a model with this many joints.
    """
    rows, runs = sum(len(e.whole) for e in dataset.experiments), len(dataset.experiments)
    channels, numbers = 1 + len(dataset.channels), 6 * joints
    if work == "identify":
        size = BASE + 8 * rows * (4 * channels + 14 * joints)
        return Need(work, rows, runs, size, START_S + FORCE_S * rows * joints)
    outputs = len(dataset.outputs)
    each = FIT_CHANNEL * channels + FIT_JOINT * joints + FIT_NUMBER * numbers * outputs
    if work == "fit":
        return Need(work, rows, runs, BASE + 8 * rows * each, 0.0)
    size = BASE + 8 * rows * (each + 16 * outputs)
    refits = FIRST_REFITS + PER_CANDIDATE * candidates
    seconds = {
        "motion": FORCE_S * rows * joints,
        "goals": GOALS_S * _runs_beside(dataset, joints) * joints,
        "free runs": REFIT_S * rows * joints * (1 + numbers) * refits,
    }
    return Need(work, rows, runs, size, START_S + seconds[way])


def _runs_beside(dataset: Dataset, joints: int) -> float:
    """Steps of the fit runs, once for each number of a robot and of where its runs begin."""
    fit = dataset.with_splits().split("fit")
    steps = sum(max(len(e.t), e.duration / STEP_S) for e in fit)
    return steps * (1 + 5 * joints + 2 * joints * len(fit))


def refuse_too_large(wanted: Need) -> None:
    """Raises `UsageError` where there is not so much memory."""
    room, limit = available()
    if wanted.bytes > SHARE * room:
        part = max(0.0, (SHARE * room - BASE) / max(wanted.bytes - BASE, 1.0))
        remedy = (
            f"Take fewer rows: about {wanted.rows * part:,.0f} fit (`rows` or `window_s` of"
            " [[experiments]], or a lower sampling rate), or give it more memory"
            if wanted.rows * part >= 1000
            else "Give it more memory"
        )
        raise UsageError(
            f"{wanted}, but only {room / 1e9:.1f} GB are free here ({limit}). {remedy}"
        )


def shortened(dataset: Dataset, wanted: Need) -> Dataset:
    """The dataset, or the first part of each of its runs with a note, where `wanted` of the whole
    is more than there is memory for, or takes longer than LONGEST_S. Each split keeps its share.
    """
    from jaxid.data.records import MINIMUM_SAMPLES

    room, _ = available()
    part = min(1.0, (SHARE * room - BASE) / (wanted.bytes - BASE), LONGEST_S / wanted.seconds)
    if part >= 1:
        return dataset
    refuse_too_large(replace(wanted, bytes=BASE))

    def first(e: Experiment) -> Experiment:
        stop = max(min(len(e), 50 * MINIMUM_SAMPLES), round(part * len(e)))
        return e if stop >= len(e) else e.piece(0, stop, name=e.name, split=e.split)

    dataset = dataset.with_splits()
    experiments = tuple(map(first, dataset.experiments))
    left = sum(map(len, experiments))
    note = (
        f"{wanted}: more than there is room or an hour for. The first part of each run is looked"
        f" at, {left:,} rows in all ({100 * part:.2g} %); choose others with `rows` or `window_s`"
        " of [[experiments]]"
    )
    return replace(dataset, experiments=experiments, notes=(*dataset.notes, note))


def available() -> tuple[float, str]:
    """Bytes that this process may still take, and what limits them: the machine, its control group,
    or a limit of its own.
    """
    found = [(_free_memory(), "free memory of this machine")]
    found += [(room, "limit of its container or job") for room in _control_groups()]
    try:
        import resource

        limit = resource.getrlimit(resource.RLIMIT_AS)[0]
        if limit != resource.RLIM_INFINITY:
            pages = int(Path("/proc/self/statm").read_text().split()[0])
            taken = pages * resource.getpagesize()
            found.append((float(limit - taken), "limit of its address space, ulimit -v"))
    except (ImportError, OSError):  # Windows has no such limits, macOS does not say what is taken
        pass
    return max(0.0, min(found)[0]), min(found)[1]


def _free_memory() -> float:
    """Bytes that this machine has left for programs; where only psutil could tell and it is not
    there, no limit.
    """
    try:
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return 1024.0 * int(line.split()[1])
    except OSError:
        pass
    try:
        return float(import_module("psutil").virtual_memory().available)
    except ImportError:
        return math.inf


def _control_groups() -> list[float]:
    """Bytes left in each control group above this process that states a limit (Linux, both
    versions).
    """
    rooms = []
    try:
        own = [line.split(":", 2) for line in Path("/proc/self/cgroup").read_text().splitlines()]
    except OSError:
        return []
    for _, controllers, name in own:
        if controllers in ("", "memory"):
            root = Path("/sys/fs/cgroup") / controllers
            names = (
                ("memory.max", "memory.current")
                if not controllers
                else ("memory.limit_in_bytes", "memory.usage_in_bytes")
            )
            inside = root / name.lstrip("/")
            for folder in dict.fromkeys([inside, *inside.parents, root]):
                if folder.is_relative_to(root) and (room := _room(folder, *names)) is not None:
                    rooms.append(room)
    return rooms


def _room(folder: Path, limit: str, usage: str) -> float | None:
    try:
        most = (folder / limit).read_text().strip()
        if most == "max" or int(most) > 1 << 60:
            return None
        statistics = dict(
            line.split() for line in (folder / "memory.stat").read_text().splitlines()
        )
        cached = int(
            statistics.get("inactive_file", statistics.get("total_inactive_file", 0))
        )  # given back when it is needed
        return float(int(most) - int((folder / usage).read_text()) + cached)
    except (OSError, ValueError):
        return None


def give_back() -> None:
    """Has the C library give memory that was freed back to the system, where it would keep it
    (glibc): compiling a program takes a few hundred megabytes in many small pieces.
    """
    import ctypes

    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL("libc.so.6").malloc_trim(0)


# ---- files, before they are read

#: Bytes in memory for each byte of CSV text, and for each number of a Parquet file, while it is
#: read.
CSV_FACTOR, PARQUET_NUMBER = 16, 8 * 5


def too_large_to_read(path: Path) -> tuple[str, str] | None:
    """(what is wrong, what to do) with a data file for which there is too little memory; its size
    is read, not its content.
    """
    size = os.stat(path).st_size
    if path.suffix.lower() == ".csv":
        needed, what = float(size * CSV_FACTOR), f"{size / 1e6:,.0f} MB of text"
    else:
        import pyarrow as pa
        import pyarrow.parquet as pq

        try:
            about = pq.read_metadata(path)
        except (pa.ArrowException, OSError, ValueError):
            return None  # said where it is read
        needed = float(size + about.num_rows * about.num_columns * PARQUET_NUMBER)
        what = f"{about.num_rows:,} rows of {about.num_columns} columns"
    room, limit = available()
    if needed <= SHARE * room:
        return None
    message = (
        f"{what} take about {needed / 1e9:.1f} GB to read, and {room / 1e9:.1f} GB are free here"
        f" ({limit})"
    )
    return message, "Write a file with fewer rows or columns, or split it into several datasets"
