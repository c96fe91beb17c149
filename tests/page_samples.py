"""A result of every kind that has a page, made without a search."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from jaxid.conventions.finding import Checked, DataFinding
from jaxid.diagnosis.breakdown import Share
from jaxid.diagnosis.result import ChannelGap, Diagnosis, Finding, HowFar, Which
from jaxid.fitting.comparison import BestKnown, Comparison, FitterRun
from jaxid.fitting.posterior import Marginal, Posterior
from jaxid.fitting.result import EffectEstimate, Estimate, Fit
from jaxid.fitting.stated import StatedNumber
from jaxid.identification.result import Identification, LawTrial, RunScore
from jaxid.report.display import write
from jaxid.study.outcome import Outcome
from jaxid.study.page import write_study
from jaxid.study.papers.result import PaperClaim, PaperPart, Reproduction
from jaxid.study.plan import read_study
from jaxid.study.run import StudyResult
from report_sample import sample_diagnosis, sample_fit


LEGS = ("FL", "FR", "RL", "RR")
JOINTS = tuple(f"{leg}_{part}_joint" for leg in LEGS for part in ("hip", "thigh", "calf"))
FRICTION = {"level": Estimate(0.2113, 0.0016, "N m", 0.0, 3.0)}


def robot_under_goals() -> Diagnosis:
    """Twelve joints by their file, driven by goals: friction at half of them."""
    plain = sample_diagnosis(800)
    effects = tuple(EffectEstimate("coulomb_friction", j, FRICTION) for j in JOINTS[::2])
    final = replace(
        plain.final,
        model="robot",
        effects=effects,
        simulation="windows",
        robot={"file": "go2.urdf"},
        stated=tuple(_stated(j, k) for k, j in enumerate(JOINTS)),
        parameters={f"armature of {j}": Estimate(0.0123, 4e-4, "kg m^2", 0, 1) for j in JOINTS},
    )
    rows = [_per_joint(j, k) for k, j in enumerate(JOINTS)]
    gaps = {
        j: ChannelGap("rad", 2e-2, 4e-3 + 1e-3 * k, 2e-3, 4e-4, "sensor")
        for k, j in enumerate(JOINTS)
    }
    how_far = HowFar(
        gap_before=94.7,
        gap_retuned=16.94,
        gap_after=9.85,
        noise_floor=1.0,
        shrinkage=0.9892,
        shrinkage_interval_95=(0.982, 0.994),
        interval_reason="",
        per_channel=gaps,
        interval_from="blocks",
        per_run=(
            Share("chirp_1", "", 2300, 94.1, 16.2, 9.7),
            Share("chirp_2", "", 2300, 95.2, 17.5, 9.9),
        ),
        per_regime=tuple(
            Share(r, j, 400, 90.0, 15.0, 8.0)
            for j in JOINTS
            for r in ("low_speed", "velocity_reversal")
        ),
        per_joint=tuple(rows),
    )
    where = tuple(
        Finding(j, j, "velocity_reversal", (3.1, 3.6), 0.31, 14.0, "") for j in JOINTS[:2]
    )
    which = replace(plain.which, verdict="partly", effects=effects)
    forces = tuple(replace(plain.missing_force[0], joint=j) for j in JOINTS)
    regimes = tuple(replace(r, joint=j) for j in JOINTS for r in plain.regimes)
    traces = tuple(replace(t, channel=j) for j in JOINTS for t in plain.traces)
    return replace(
        plain,
        model="robot",
        dataset="go2_chirp",
        final=final,
        nominal=replace(final, effects=()),
        how_far=how_far,
        where=where,
        which=which,
        missing_force=forces,
        regimes=regimes,
        traces=traces,
    )


def _stated(joint: str, number: int) -> StatedNumber:
    return StatedNumber(
        joint=joint,
        link="",
        parameter="armature",
        stated=0.01,
        fitted=0.0123,
        std=0.0004,
        deviation=5.75 + number,
        text=f"armature of {joint}: 0.01 kg m^2 is stated, the data say 0.0123",
        unit="kg m^2",
    )


def _per_joint(joint: str, number: int) -> dict[str, Any]:
    return {
        "joint": joint,
        "split": "report",
        "text": "with the file as it stands",
        "unit": "rad",
        "as_it_stands": 0.02 + 0.001 * number,
        "retuned": 0.004,
        "with_effects": 0.002,
    }


def arm_by_torque() -> Diagnosis:
    """Seven joints by torque, where nothing that is known explains the gap."""
    plain = sample_diagnosis(800)
    names = [f"tau{j}" for j in range(1, 8)]
    gaps = {n: ChannelGap("N m", 5.1, 2.2, 2.2, 0.11, "repeats") for n in names}
    final = replace(
        plain.nominal, model="serial_arm", effects=(), simulation="inverse_dynamics", stated=()
    )
    how_far = replace(
        plain.how_far,
        gap_before=46.2,
        gap_retuned=13.8,
        gap_after=13.8,
        shrinkage=None,
        shrinkage_interval_95=None,
        interval_reason="the verdict is unknown",
        per_channel=gaps,
        per_joint=(),
    )
    which = Which("unknown", (), (), plain.which.ranking, "There is a gap (13.8 times the noise).")
    forces = tuple(replace(plain.missing_force[0], joint=f"q{j}") for j in range(1, 8))
    return replace(
        plain,
        model="serial_arm",
        dataset="panda_exciting",
        final=final,
        nominal=final,
        how_far=how_far,
        which=which,
        missing_force=forces,
    )


def fit_with_posterior() -> Fit:
    """A fit with the draws of two numbers."""
    fit = sample_fit(samples=800)
    rng = np.random.default_rng(0)
    draws = {
        name: value + spread * rng.standard_normal((4, 200))
        for name, value, spread in (("inertia", 0.0812, 4e-4), ("gravity_torque", 1.2347, 3e-3))
    }
    told = {
        name: Marginal(
            fit.parameters[name].unit,
            x.mean(),
            x.std(),
            (x.min(), x.max()),
            1.0,
            700,
            650,
            (None, x.max()),
        )
        for name, x in draws.items()
    }
    posterior = Posterior(
        parameters=told,
        draws=draws,
        log_density=np.zeros((4, 200)),
        diverging=np.zeros((4, 200), bool),
        acceptance=np.full((4, 200), 0.9),
        steps=np.full((4, 200), 7),
        warmup=300,
        noise_factor=1.1,
        unsettled=(),
        origin={},
    )
    return replace(fit, posterior=posterior)


def comparison() -> Comparison:
    """Two fitters, four runs each."""
    runs = []
    for fitter, ends in {"lm": [1.0, 1.0, 1.002, 1.0], "cma_es": [1.0, 1.3, 1.01, 2.0]}.items():
        for seed, end in enumerate(ends):
            n = 10 * np.arange(1, 11)
            history = np.stack([n, n / 100, end + 64 * 0.5 ** (n / 10) - 64 * 0.5**10], 1)
            numbers = {"inertia": end, "viscous": 2 * end}
            runs.append(
                FitterRun(
                    fitter, seed, "stopped", "budget", end, 100, 1.0, 2.0, 1.0, numbers, history
                )
            )
    known = {
        "inertia": BestKnown(1.0, 0.1, "kg m^2", 0.0, 5.0),
        "viscous": BestKnown(2.0, None, "N m s/rad", 0.0, 5.0),
    }
    return Comparison(
        "joint", "bench", "0" * 64, (), "output_error", "sum_of_squares", 100, None, "random",
        0.01, 1.0, known, tuple(runs), 3.0,
    )  # fmt: skip


def identification() -> Identification:
    """Base parameters and friction of an arm of six joints."""
    joints = tuple(f"q{j}" for j in range(1, 7))
    base = tuple(f"Izz{j} + Iyy{j + 1}" for j in range(1, 9))
    friction = tuple(f"{kind}{j}" for kind in ("F_c", "F_v", "F_o") for j in range(1, 7))
    names = (*base, *friction)
    units = (*["kg m^2"] * 8, *["N m"] * 6, *["N m s/rad"] * 6, *["N m"] * 6)
    t = np.linspace(0, 30, 900)
    tau = np.stack([np.sin(t + j) for j in range(6)], 1)
    each, rms = (0.0645, 0.0386, 0.0423, 0.046, 0.0854, 0.0544), (0.2,) * 6
    experiments = tuple(
        RunScore(file, split, 0.0433, each, rms, 0.0588, rms)
        for file, split in (("ident_30s_12harm", "fit"), ("ident_50s_12harm", "validation"))
    )
    return Identification(
        model="ur10e",
        method="weighted least squares",
        law="linear",
        names=names,
        expressions=tuple(f"{name} + 0.0064 m{k} + 0.17 mx{k}" for k, name in enumerate(names)),
        units=units,
        theta=np.linspace(0.1, 21.3, len(names)),
        covariance=np.diag(np.full(len(names), 0.01)),
        identifiable=np.arange(len(names)) != 3,
        base_count=len(base),
        exponents=None,
        condition_number=84.2,
        condition_number_scaled=12.1,
        filter="torque and motion filtered at 5 Hz without phase",
        weights=np.ones(6),
        experiments=experiments,
        laws=(LawTrial("linear", 0.0323, (0.0433,), True), LawTrial("power", 0.03, (0.05,), False)),
        standard=None,
        dataset="ur10e",
        dataset_sha256="0" * 64,
        notes=("drive gains count as exact",),
        wall_time_s=3.0,
        traces=(("ident_50s_12harm", "validation", t, tau, 0.95 * tau),),
        labels=joints,
    )


def checked() -> Checked:
    """What a check found: a sign that was mended, a unit that is asked about."""
    sign = DataFinding(
        kind="sign",
        channel="tau",
        value=-1.0,
        text="tau has the opposite sign.",
        line="scale = -1",
        gap_before=145.3,
        gap_if_mended=1.04,
        decisive=True,
        applied=True,
        headline="tau has the opposite sign; everything below takes it negated",
    )
    unit = DataFinding(
        "unit", "q", 57.3, "Is q in degrees?", 'unit = "deg"', same_as=(("gear", "q"),)
    )
    return Checked("bench", "0" * 64, (sign, unit), None, "pendulum")


def reproduction() -> Reproduction:
    """A paper with one part."""
    claims = (
        PaperClaim("the mass is found", "2.1 kg", "2.08 kg", "holds"),
        PaperClaim("in one second", "", "", "cannot be checked", "the log is lost"),
    )
    part = PaperPart("Payload", ("One sentence.",), (), (), claims)
    return Reproduction("002", "A title", "10.1/x", "About.", "small", (part,), 1.5)


RESULTS: dict[str, Callable[[], Any]] = {
    "joint": lambda: sample_diagnosis(800),
    "robot under goals": robot_under_goals,
    "arm by torque": arm_by_torque,
    "fit": lambda: sample_fit(samples=800),
    "fit with posterior": fit_with_posterior,
    "comparison": comparison,
    "identification": identification,
    "check": checked,
    "reproduction": reproduction,
}


def study(folder: Path) -> StudyResult:
    """Fits of eight machines with two fitters, one of which fails, and their diagnoses."""
    for k in range(8):
        place = folder / f"machine_{k}"
        place.mkdir(parents=True)
        (place / "run.csv").write_text(
            "t,tau,q\n" + "".join(f"0.0{i},1,0.0{i}\n" for i in range(9))
        )
        (place / "dataset.toml").write_text(
            f"name = 'machine_{k}'\n[model]\nname = 'joint'\n"
            "[channels.tau]\nrole = 'input'\nunit = 'N m'\n"
            "[channels.q]\nrole = 'output'\nunit = 'rad'\n[[experiments]]\nfile = 'run.csv'\n"
        )
    names = ", ".join(f"'machine_{k}'" for k in range(8))
    (folder / "study.toml").write_text(
        f"name = 'fleet'\nstore = 'out'\n[[runs]]\ncommand = 'fit'\ndatasets = [{names}]\n"
        "fitters = ['lm', 'cma_es']\nseeds = 2\n"
        f"[[runs]]\ncommand = 'diagnose'\ndatasets = [{names}]\n"
    )
    plan = read_study(folder / "study.toml")
    return StudyResult(
        plan, {t.key: _outcome(t, k) for k, t in enumerate(plan.tasks.values())}, True
    )


def _outcome(task: Any, number: int) -> Outcome:
    if number == 5:
        return Outcome(task.key, "failed", "it diverges", log="Traceback\nValueError: it diverges")
    if task.command == "diagnose":
        named = ("coulomb_friction at q",)
        return Outcome(task.key, "converged", verdict="named", named=named, wall_time_s=9.0)
    parameters = {"inertia": 0.08 + 0.002 * (number % 7), "viscous": 0.4}
    fit = replace(
        sample_fit(samples=20),
        parameters={
            "inertia": Estimate(parameters["inertia"], 4e-4, "kg m^2", 1e-3, 1.0),
            "viscous": Estimate(0.4, 0.01, "N m s/rad", 0.0, 3.0),
        },
    )
    return Outcome(
        task.key,
        "converged",
        "tolerance",
        loss=1.0 + 0.3 * (number % 3),
        evaluations=100 + 50 * number,
        wall_time_s=1.0 + 0.1 * number,
        parameters=parameters,
        result=fit.to_dict(),
    )


def pages(folder: Path) -> dict[str, Path]:
    """Writes a page of every kind; kind -> file."""
    written = {}
    for kind, made in RESULTS.items():
        written[kind] = write(made(), folder / f"{kind.replace(' ', '_')}.html")
    written["study"] = write_study(study(folder / "study"), folder / "study.html")
    return written
