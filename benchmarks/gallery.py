"""Public recordings of machines, each by its repository and commit, with what jaxid says of it.

`python benchmarks/gallery.py DIR [NAME …]` fetches the files as their authors published them (all,
or those named) with git. None of them is part of this repository. The figures of the page are read
from `benchmarks/results`, where the benchmark that measured them wrote them.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from jaxid.base.wording import percent, placed


RESULTS = Path(__file__).resolve().parent / "results"
#: Where a repository is fetched from; `{}` is its owner and name.
REMOTE = "https://github.com/{}.git"

Row = Mapping[str, Any]


class Recording(NamedTuple):
    """A public recording: what it is of, where it lies, what was found and which file says so.

    `answer` makes sentences of the rows of `result`, the name of a file in benchmarks/results.
    """

    name: str
    machine: str
    repository: str
    commit: str
    paths: tuple[str, ...]
    licence: str
    result: str
    answer: Callable[[list[Row]], list[str]]


def only(rows: list[Row], **wanted: str) -> Row:
    """The one row with these values."""
    (found,) = [row for row in rows if all(row.get(k) == v for k, v in wanted.items())]
    return found


def of_bench(name: str, unit: str) -> Callable[[list[Row]], list[str]]:
    """Two free runs, re-tuned and with what was named."""

    def answer(rows: list[Row]) -> list[str]:
        own = [row for row in rows if row["recording"] == name and row["verdict"]]
        before, after = own
        runs = ("first recording", "second recording")
        fell = [f"{before[run]:.3g} to {after[run]:.3g} {unit}" for run in runs]
        named = placed(after["model"].split(" + "))
        return [
            f"**{after['verdict']}**: {named}.",
            f"The error of free runs falls from {fell[0]}, and from {fell[1]} in the other run.",
        ]

    return answer


def of_stage(rows: list[Row]) -> list[str]:
    """A stage with a flexible beam: what is named, and the hub on report data."""
    verdict, _, named = only(rows, what="verdict")["measured"].partition(": ")
    same = only(rows, what="cannot be told apart from it")["measured"]
    hub = only(rows, what="free run, report, hub")["measured"].replace(", then ", " to ")
    return [
        f"**{verdict}**: {placed(named.split(', '))}.",
        f"These data cannot tell it from {placed(same.split(', '))}.",
        f"On report data the error of the hub falls from {hub}.",
    ]


def of_arm(name: str) -> Callable[[list[Row]], list[str]]:
    """An arm by torque."""

    def answer(rows: list[Row]) -> list[str]:
        verdict = only(rows, recording=name, what="verdict")["result"]
        named = only(rows, recording=name, what="named")["result"]
        gap = only(rows, recording=name, what="gap, re-tuned and after (multiples of the noise)")
        before, _, after = gap["result"].partition(", ")
        if named == "-":
            left = f"{before} times the noise are left, and no effect is claimed."
            return [f"**{verdict}**: {left}"]
        return [
            f"**{verdict}**: {placed(named.split(', '))}.",
            f"The gap of torque falls from {before} to {after} times the noise.",
        ]

    return answer


def of_robot(name: str) -> Callable[[list[Row]], list[str]]:
    """A robot under goals: all joints together."""

    def answer(rows: list[Row]) -> list[str]:
        row = only(rows, recording=name, joint="all")
        said, _, _ = row["answer"].partition(";")
        verdict, _, named = said.partition(": ")
        stands = f"{row['file as it stands']:.3g}"
        retuned = f"{row['re-tuned']:.3g}"
        told = [
            f"**{verdict}**: {placed(named.split(', '))}.",
            f"With its file as it stands the error is {stands} rad, re-tuned {retuned}.",
        ]
        if row["with effects"] != row["re-tuned"]:
            told.append(f"With the effects it is {row['with effects']:.3g} rad.")
        return told

    return answer


def of_kinova(rows: list[Row]) -> list[str]:
    """An arm whose file is identified by torque."""
    own = [row for row in rows if row["recording"] == "kinova_gen3 RunTrajectory1"]
    stands = sorted(row["file as it stands"] for row in own)
    retuned = sorted(row["re-tuned"] for row in own)
    other = [row for row in rows if row["recording"] == "kinova_gen3 joint_2_trapez"]
    worse = sum(row["re-tuned"] > row["file as it stands"] for row in other)
    return [
        f"Its file predicts torque with errors of {percent(stands[0])} to {percent(stands[-1])} by",
        f"joint. Identified, it does with {percent(retuned[0])} to {percent(retuned[-1])}.",
        f"In a run that moves joint 2 alone, {worse} of {len(other)} joints are predicted worse than",
        "by the file.",
    ]


def of_servo(rows: list[Row]) -> list[str]:
    """A servo on a pendulum bench."""
    (named,) = [row for row in rows if row.get("gap on the logs with gain 200")]
    verdict, _, effect = named["friction"].partition(": ")
    before, _, after = named["gap on the logs with gain 200"].partition(" -> ")
    return [
        f"**{verdict}**: {effect}.",
        f"On logs with another gain the gap falls from {before} to {after} mrad.",
    ]


def of_beam(rows: list[Row]) -> list[str]:
    """A flexible link by its frequency response."""
    plain, late = (only(rows, model=f"all modes{m}") for m in (", no delay", " and a delay"))
    errors = [percent(row["error 2025-04-16"]) for row in (plain, late)]
    return [
        "The beam's modes alone do not follow the phase; a delay does.",
        f"On another day's response the error falls from {errors[0]} to {errors[1]}.",
    ]


def of_daisy(rows: list[Row]) -> list[str]:
    """Two modes of a flexible arm."""
    free = only(rows, what="free run, linear hold of the input")["measured"]
    first, second = (only(rows, what=f"w_{k}")["measured"].replace("rad/s", "") for k in (1, 2))
    return [
        f"Two modes, at {first.strip()} and {second.strip()} rad a sample, fitted by a model of the",
        f"user's own: {free} in a free run.",
    ]


RECORDINGS = (
    Recording(
        "emps",
        "A positioning axis with a ball screw (EMPS), by the force of its drive",
        "forgi86/sysid-neural-continuous",
        "956aa7ecd73061b0321c6f6098d74c9e4a7ce67a",
        ("examples/EMPS/data",),
        "Apache-2.0 (the mirror)",
        "real_recordings",
        of_bench("emps", "mm"),
    ),
    Recording(
        "multiarm_single_pendulum",
        "A pendulum on ball bearings that swings freely",
        "dynamicslab/MultiArm-Pendulum",
        "e99a7e13fe2adc8fc647321a156b6cb59a48a698",
        ("ParameterEstimation/SinglePendulum",),
        "MIT",
        "real_recordings",
        of_bench("multiarm_single_pendulum", "mrad"),
    ),
    Recording(
        "quanser_2dsfl",
        "A stage with harmonic drive and flexible beam (Quanser)",
        "basta/quanser-2-dof-serial-flexible-link",
        "48ab0ce6a1b3038e971dec828005c72e90a12e5a",
        ("software/quanser_original/Results",),
        "MIT",
        "quanser_2dsfl",
        of_stage,
    ),
    Recording(
        "xl330_pendulum",
        "A hobby servo (Dynamixel XL330) that lifts a mass, driven by goals",
        "Rhoban/bam",
        "af2260462471ff45ac18af159b1327ea51d8db15",
        ("bam/data.bak/raw",),
        "Apache-2.0",
        "xl330",
        of_servo,
    ),
    Recording(
        "ur10e",
        "An arm of six joints (UR10e), torque from motor currents, without friction in its model",
        "shamilmamedov/dynamic_calibration",
        "11af40e7deb758ec080a175fed8fcdd6c99aca29",
        ("dataset_ur10e",),
        "none stated",
        "arm_diagnosis",
        of_arm("ur10e"),
    ),
    Recording(
        "panda_exciting",
        "An arm of seven joints (Franka Panda) with torque sensors, friction in its model",
        "marcocognetti/FrankaEmikaPandaDynModel",
        "24d85ce4e648e2e894c832bfeee9b16711eb1a1a",
        ("matlab/data/Exciting_Traj/Trajectory_1",),
        "GPL-3.0",
        "arm_diagnosis",
        of_arm("panda_exciting"),
    ),
    Recording(
        "kinova_gen3",
        "An arm of seven joints (Kinova Gen3) with its URDF, torque from currents",
        "wissem01chiha/dynamic-identification",
        "44f47d5640d89c7b97e584bb10163c4a2b3ced00",
        (
            "datasets/kinova/identification_data/RunTrajectory1.csv",
            "datasets/kinova/jointwise_motion/joint_2_trapez.csv",
        ),
        "CC0-1.0",
        "robot_recordings",
        of_kinova,
    ),
    Recording(
        "so101_chirps",
        "A hobby arm of six position servos (SO-101) with its MJCF",
        "isaac-sim2real/sage",
        "4ffd2627df9d23e279b35712a67e629ce0c0dfa7",
        (
            "output/real/so101/custom/chirp_sweep",
            "output/real/so101/custom/multisine",
            "output/real/so101/custom/friction_gravity",
        ),
        "Apache-2.0",
        "robot_recordings",
        of_robot("so101_chirps"),
    ),
    Recording(
        "go2_chirp",
        "A quadruped (Unitree Go2) hung by its trunk, twelve joints driven by goals",
        "iit-DLSLab/sim2real-robot-identification",
        "06739ea0424fa8b2e141df0942ecdaf27a5c8600",
        ("datasets/go2",),
        "BSD-3-Clause",
        "robot_recordings",
        of_robot("go2_chirp"),
    ),
    Recording(
        "quanser_flexlink_frf",
        "A flexible link (Quanser) as a measured frequency response",
        "AtsushiYanaigsawa768/gauss_process",
        "4add06401ae9a6a19274899d9cb8a6eea2489d5c",
        ("gp/data",),
        "none stated",
        "flexlink_frf",
        of_beam,
    ),
    Recording(
        "daisy_robot_arm",
        "A flexible robot arm (DaISy), torque to acceleration, without units",
        "Rafa7046/Non_Linear_Identification",
        "e5c9b006b0a2ec1650bc018a5fb38d2f4363d4c7",
        ("src/data/robot-arm.csv",),
        "none stated; DaISy asks to be cited",
        "daisy",
        of_daisy,
    ),
)


def fetch(recording: Recording, folder: Path, remote: str = REMOTE) -> Path:
    """The published files of a recording in `folder/NAME`; raises `CalledProcessError` where git
    does not get them.
    """
    place = folder / recording.name
    place.mkdir(parents=True)

    def git(*words: str) -> None:
        subprocess.run(["git", "-C", str(place), *words], check=True)

    git("init", "--quiet")
    git("remote", "add", "origin", remote.format(recording.repository))
    git("config", "remote.origin.promisor", "true")  # only the files that are asked for
    git("config", "remote.origin.partialclonefilter", "blob:none")
    git("fetch", "--quiet", "--depth", "1", "origin", recording.commit)
    git("checkout", "--quiet", recording.commit, "--", *recording.paths)
    shutil.rmtree(place / ".git")
    return place


def page(results: Path = RESULTS) -> str:
    """The gallery: each recording with its answer, as it was measured last."""
    out = [
        "# Recordings of machines",
        "",
        f"What jaxid says of {len(RECORDINGS)} public recordings: what it names, and where it does",
        "not know. The figures are those of [Benchmarks](benchmarks.md), measured on the day that is",
        "stated there for each. `python benchmarks/gallery.py DIR` fetches the files as their",
        "authors published them; none of them is part of jaxid.",
        "",
    ]
    for recording in RECORDINGS:
        kept = json.loads((results / f"{recording.result}.json").read_text(encoding="utf-8"))
        source = f"https://github.com/{recording.repository}/tree/{recording.commit}"
        out += [f"## {recording.machine}", ""]
        out += [" ".join(recording.answer(kept["rows"])), ""]
        out += [
            f"`{recording.name}`, from [{recording.repository}]({source}), commit",
            f"`{recording.commit[:7]}`; licence: {recording.licence}. Measured {kept['date']} by `benchmarks/{recording.result}.py`.",
            "",
        ]
    return "\n".join(out)


def command(words: list[str]) -> int:
    """Fetches all recordings, or those named; returns the exit code."""
    if not words:
        print(__doc__)
        return 2
    folder, names = Path(words[0]), set(words[1:])
    unknown = names - {recording.name for recording in RECORDINGS}
    if unknown:
        print(f"no such recording: {', '.join(sorted(unknown))}", file=sys.stderr)
        return 2
    wanted = [r for r in RECORDINGS if not names or r.name in names]
    failed = 0
    for recording in wanted:
        try:
            print(fetch(recording, folder))
        except (OSError, subprocess.CalledProcessError) as error:
            print(f"{recording.name} could not be fetched: {error}", file=sys.stderr)
            failed += 1
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(command(sys.argv[1:]))
