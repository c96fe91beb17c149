"""What a study costs beside the same fits in one hand-written batched program, and what its
coordinator costs a task.

Both programs of the first comparison are started as commands and do everything: start Python, load
the data, take the compiled programs from the cache, fit 1,000 seeds. `python study_throughput.py
by_hand FOLDER COUNT [search]` is the hand-written one.
"""

from __future__ import annotations

import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path


HERE = Path(__file__).resolve().parent
COUNT = int(os.environ.get("JAXID_STUDY_FITS", "1000"))
#: Seeds of one batch of the hand-written program: more of them only fill the memory.
CHUNK = 100


def by_hand(folder: str, count: int, search_alone: bool) -> None:
    """The same fits by the library's own parts, in one process: all seeds of a chunk in the same
    batches of lanes.
    """
    from jaxid.runtime import prepare

    prepare()
    import jax

    import jaxid
    from jaxid.fitters import LevenbergMarquardt
    from jaxid.fitting.run import default_residual, fit_seeds, ProblemBuilders
    from jaxid.problem.binding import bind

    binding = bind("joint", jaxid.load_dataset(folder))
    benches, fitter = ProblemBuilders(binding), LevenbergMarquardt()
    for first in range(0, count, CHUNK):
        seeds = range(first, min(count, first + CHUNK))
        if not search_alone:
            fit_seeds(binding, fitter, None, "sum_of_squares", seeds, None, benches=benches)
            continue
        residual = default_residual(binding)
        bench = benches.of(2.5e-3)
        guesses = benches.starts(bench, residual, "sum_of_squares", 0)
        problem = bench.problem(residual, "fit", binding.free, guesses[0])
        fitter.minimise_each(
            [(problem, [problem.z(g) for g in guesses], jax.random.key(s)) for s in seeds], None
        )


def timed(command: list[str]) -> tuple[float, float]:
    """(wall, processor) seconds of a command with all its processes."""
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return (
        time.perf_counter() - began,
        after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime,
    )


def fits(home: Path) -> list[dict]:
    from tests.test_batch import write_dataset, write_study

    write_dataset(home / "small")

    def hand(count, *more):
        return [
            sys.executable,
            __file__,
            "by_hand",
            str(home / "small"),
            str(count),
            *more,
        ]

    def batch(count):
        return [
            sys.executable,
            "-m",
            "jaxid.cli",
            "batch",
            str(write_study(home, f"seeds = {count}")),
            "--quiet",
        ]

    programs = {
        "one hand-written program": hand,
        "its search alone": lambda count: hand(count, "search"),
        "jaxid batch": batch,
    }
    best: dict[str, tuple[float, float]] = {}
    for count in (8, COUNT):  # the first fills the cache of compiled programs
        for name, program in programs.items():
            shutil.rmtree(home / "out", ignore_errors=True)
            spent = timed(program(count))
            best[name] = spent
    reference = best["one hand-written program"][0]
    return [
        {
            "what": f"{COUNT} fits by lm of 2 s of one joint: {name}",
            "wall s": round(wall, 1),
            "processor s": round(processor, 1),
            "ms a task": round(1000 * wall / COUNT, 2),
            "times the hand-written program": round(wall / reference, 2),
        }
        for name, (wall, processor) in best.items()
    ]


#: How long a batch of the simulated fleet takes.
PAUSE_S = [0.0]
RESULT: dict = {}


def nothing(session: str, command: tuple[str, ...], batch: str) -> str:
    """Stands in for `supervisor.run_batch`: answers of the size of a fit, without a process."""
    from jaxid.base.serialise import finite
    from tests.report_sample import sample_fit
    from tests.study_fleet import answer

    if not RESULT:
        RESULT.update(finite(sample_fit().to_dict()))

    tasks = json.loads(batch)
    time.sleep(PAUSE_S[0])
    outcomes = [{"key": (a := answer(t)).pop("done"), **a, "result": RESULT} for t in tasks]
    return json.dumps({"host": "here", "seconds": max(PAUSE_S[0], 1e-4), "outcomes": outcomes})


def fleet(home: Path) -> list[dict]:
    """The coordinator with workers that do nothing: processor time of its process a task, and where
    it saturates.
    """
    from jaxid.study import read_study, supervisor
    from jaxid.study.cluster import local_cluster
    from jaxid.study.coordinator import Coordinator, StopSignal
    from jaxid.study.store import Store
    from tests.test_batch import write_dataset, write_study

    write_dataset(home / "small", samples=20)
    many = [
        f"[[runs]]\ncommand = 'fit'\ndatasets = ['small']\nbudget = {k + 1}" for k in range(1, 2000)
    ]
    cases = (
        ("tasks that share their programs, in batches", ("seeds = 5000",), 2, 1, 0.0),
        ("empty tasks that share nothing", ("budget = 1", *many), 2, 1, 0.0),
        ("64 workers, each task alone for 1 s", ("budget = 1", *many), 8, 8, 1.0),
        ("256 workers, each task alone for 1 s", ("budget = 1", *many), 16, 16, 1.0),
    )
    rows, real = [], supervisor.run_batch
    for k, (what, lines, workers, threads, seconds) in enumerate(cases):
        study = read_study(write_study(home, *lines, store=f"fleet{k}"))

        supervisor.run_batch, PAUSE_S[0] = nothing, seconds
        try:
            with (
                Store(study.store) as store,
                StopSignal() as stop,
                local_cluster(workers, threads) as cluster,
            ):
                store.acquire()
                coordinator = Coordinator(store, list(study.tasks.values()), cluster)
                began, spent = time.perf_counter(), time.process_time()
                coordinator.run(stop)
                wall, spent = time.perf_counter() - began, time.process_time() - spent
        finally:
            supervisor.run_batch = real
        count, slots = len(study.tasks), workers * threads
        rows.append(
            {
                "what": f"coordinator: {what}",
                "wall s": round(wall, 2),
                "processor s": round(spent, 2),
                "ms a task": round(1000 * spent / count, 2),
                "tasks a second": round(count / wall),
                "of the workers' time used": f"{100 * seconds * count / (wall * slots):.0f} %"
                if seconds
                else "",
            }
        )
    return rows


def evaluations(home: Path) -> list[dict]:
    """Seconds of one evaluation of the loss, one simulation of the record."""
    import jaxid
    from jaxid.fitting.problem_builder import default_residual, ProblemBuilder
    from jaxid.problem.binding import bind
    from tests.test_batch import write_dataset

    rows = []
    examples = HERE.parent / "examples" / "servo_pendulum"
    for what, folder in (
        ("2 s of one joint", write_dataset(home / "small")),
        ("the shipped servo recording", examples),
    ):
        data = jaxid.load_dataset(folder)
        binding = bind(None, data)
        problem = ProblemBuilder(binding).problem(
            default_residual(binding), "fit", binding.free, binding.theta
        )
        z = problem.z(binding.theta)[None].repeat(256, 0)
        problem.losses(z)
        began = min(_once(problem, z) for _ in range(5))
        rows.append(
            {
                "what": f"one evaluation of the loss: {what}",
                "ms a task": round(1000 * began / 256, 4),
            }
        )
    return rows


def _once(problem, z) -> float:
    began = time.process_time()
    problem.losses(z)
    return time.process_time() - began


def main() -> dict:
    rows = []
    for measure in (evaluations, fleet, fits):
        with tempfile.TemporaryDirectory() as folder:
            rows += measure(Path(folder))
        print(*rows, sep="\n", flush=True)
    return {
        "title": "What a study costs",
        "text": "Both commands start from nothing and have the compiled programs in the cache. The hand-written one makes the "
        "same fits (search, check of the step, uncertainty, scores) in one process, 100 seeds in one batch. The coordinator is "
        "measured with workers that do nothing, in its own process; evaluations in processor time on one core.",
        "rows": rows,
    }


if __name__ == "__main__":
    if sys.argv[1:2] == ["by_hand"]:
        sys.path.insert(0, str(HERE.parent))
        by_hand(sys.argv[2], int(sys.argv[3]), "search" in sys.argv[4:])
