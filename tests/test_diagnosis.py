"""The diagnosis on twins whose missing effect it is not told, on controls, and on real recordings
where they are present.
"""

import dataclasses
import functools
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

import jaxid
from jaxid.data.dataset import ModelSpec, ParameterPrior
from jaxid.diagnosis import search, shortlist
from jaxid.diagnosis.budget import shrink
from jaxid.diagnosis.evidence import held_out, HeldOut, inflation, knowledge, memory, shifted
from jaxid.diagnosis.how_far import interval_of_further_run
from jaxid.diagnosis.hypothesis import candidates, Hypothesis, SearchResult
from jaxid.diagnosis.prior_pull import put_back
from jaxid.diagnosis.probability import RULE
from jaxid.diagnosis.proposals import left_out
from jaxid.diagnosis.reasons import Lacks
from jaxid.diagnosis.refits import Refits, THOROUGH
from jaxid.diagnosis.search import Searcher
from jaxid.diagnosis.selection import mirrored
from jaxid.diagnosis.verdict import Gaps, judge, upheld, Verdict
from jaxid.dynamics import catalogue
from jaxid.fitting.least_squares import levenberg_marquardt
from jaxid.fitting.lost_runs import growth
from jaxid.fitting.problem_builder import ProblemBuilder, start_values
from jaxid.problem.binding import bind
from jaxid.problem.residual import OutputError
from reference import multisine


ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))
from jaxid.benchmark import numpy_twin as twins, plants  # noqa: E402


DATA = Path(os.environ.get("JAXID_DATA", ROOT.parent / "shared" / "data"))
NOISE = 3e-4
CHOICE = ("load_dependent_friction", "quadratic_drag", "dead_zone")


@functools.cache
def recording(model: str, seed: int, **truth) -> jaxid.Dataset:
    """Four runs of 6 s at 200 Hz with steps and rests: two to fit, one to choose, one to report."""
    splits = ["fit", "fit", "validation", "report"]
    t = np.arange(1200) / 200
    us = []
    for k in range(4):
        rng = np.random.default_rng(100 * seed + k)
        u = multisine(t, [0.4], seed=100 * seed + k, periods=rng.uniform(1.5, 3), lines=8)
        for _ in range(3):
            a = int(rng.integers(0, 1000))
            u[a : a + int(rng.integers(40, 160))] = (
                rng.uniform(-0.5, 0.5) if rng.uniform() < 0.6 else 0.0
            )
        us.append(u)
    plant = dataclasses.replace(plants.PLANTS[model], rate=200, noise=NOISE, resolution=0.0)
    numbers = plant.nominal | {k: np.array([x]) for k, x in truth.items()}
    y = twins.recorded(
        plant,
        np.array(us),
        {k: np.tile(x, (4, 1)) for k, x in numbers.items()},
        np.random.default_rng(seed),
    )
    return jaxid.Dataset.from_arrays(
        [t] * 4,
        {"tau": [u[:, 0] for u in us]},
        {"q": list(y[:, :, 0])},
        units={"tau": "N m", "q": "rad"},
        split=splits,
        at_rest=True,
        noise_std={"q": NOISE},
        model=model,
    )


@functools.cache
def diagnosed(among: tuple[str, ...] | None, **truth) -> Any:
    return jaxid.diagnose("pendulum", recording("pendulum", 1, **truth), effects=among)


@pytest.mark.parametrize(
    ("effect", "place", "truth", "parameters", "among"),
    [
        ("load_dependent_friction", "q", {"load": 0.1}, {"mu": 0.1}, CHOICE),
        pytest.param(
            "load_dependent_friction", "q", {"load": 0.1}, {"mu": 0.1}, None, marks=pytest.mark.slow
        ),
        pytest.param(
            "input_delay", "tau", {"delay": 0.004}, {"delay": 0.004}, None, marks=pytest.mark.slow
        ),
    ],
)
def test_a_withheld_effect_is_named(effect, place, truth, parameters, among):
    """Among a few effects, and among all of them."""
    d = diagnosed(among, **truth)
    assert d.which.verdict == "named"
    assert [(e.effect, e.location) for e in d.which.effects] == [(effect, place)]
    for name, value in parameters.items():
        found = d.which.effects[0].parameters[name]
        assert found.std is not None and abs(found.value - value) < 4 * found.std + 1e-3 * value
    assert d.how_far.gap_after < 1.1 < d.how_far.gap_retuned
    assert d.how_far.shrinkage is not None and d.how_far.shrinkage > 0.97
    assert d.where and d.where[0].location == place
    json = d.to_dict()
    assert json["schema"] == 1 and json["which"]["ranking"][0]["effect"] == effect


RIPPLE: dict[str, Any] = {"ripple": 0.05, "ripple_order": 27.7}


@pytest.mark.slow
def test_the_order_of_a_ripple_is_read_off_the_missing_torque():
    """A joint without end stops passes dozens of its periods: no probe is near, and a free run has
    a minimum at every one. From the probes alone this fit ends at an order of 12.7.
    """
    data = recording("joint", 7, **RIPPLE)
    assert np.ptp(data.experiments[0].y) * 27.7 > 12 * 2 * np.pi  # periods
    fit = jaxid.fit("joint", data, effects=["torque_ripple"])
    found = fit.effects[0].parameters["order"]
    assert (
        fit.loss < 1.2 and found.std is not None and abs(found.value - 27.7) < 4 * found.std + 1e-4
    )


@pytest.mark.slow
def test_a_ripple_on_a_long_travel_is_named():
    d = jaxid.diagnose("joint", recording("joint", 7, **RIPPLE), effects=["torque_ripple", *CHOICE])
    assert d.which.verdict == "named" and [e.effect for e in d.which.effects] == ["torque_ripple"]


@pytest.mark.slow
def test_windows_name_the_same_effect():
    data = recording("pendulum", 1, load=0.1)
    d = jaxid.diagnose("pendulum", data, residual="multiple_shooting", effects=CHOICE)
    assert [e.effect for e in d.which.effects] == [
        "load_dependent_friction"
    ] and d.residual == "multiple_shooting"
    assert d.traces and all(t.windows and len(t.simulated) == 2 for t in d.traces)


@pytest.mark.parametrize(("angle", "least", "most"), [(np.pi - 0.02, 60.0, 1e4), (0.3, 0.0, 3.0)])
def test_growth_of_a_difference_at_the_start(angle, least, most):
    """A pendulum that falls from the top multiplies it, one that swings below does not."""
    t = np.arange(800) / 200
    data = jaxid.Dataset.from_arrays(
        [t, t],
        {"tau": [0 * t] * 2},
        {"q": [angle + 0.1 * np.sin(t)] * 2},
        units={"tau": "N m", "q": "rad"},
        split=["fit", "validation"],
        initial={"q": angle, "qd": 0.0},
        noise_std={"q": NOISE},
        model="pendulum",
    )
    binding = bind("pendulum", data)
    theta = binding.theta.copy()
    theta[binding.layout.index("coulomb")] = 0.0
    assert least < growth(ProblemBuilder(binding), theta) < most


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_an_arm_thrown_over_the_top():
    """A two-link arm that is thrown over the top; its command has another scale than the model's at
    joint 2.
    """
    t, rng = np.arange(1200) / 200, np.random.default_rng(3)
    plant = dataclasses.replace(plants.PLANTS["planar_arm"], rate=200)
    lines = 2 * np.pi * rng.uniform(0.3, 1.5, (4, 2, 6)), rng.uniform(0, 6, (4, 2, 6))
    u = (
        np.array([22.0, 7.0])
        * np.sin(lines[0][:, None] * t[:, None, None] + lines[1][:, None]).sum(3)
        / np.sqrt(6)
    )
    numbers = plant.nominal | {"scale": (0.0, 0.07)}
    every = {
        k: np.tile(numbers.get(k, (plants.NEUTRAL.get(k, 0.0),) * 2), (4, 1))
        for k in {**plants.NEUTRAL, **numbers}
    }
    y = twins.recorded(plant, u, every, rng)
    data = jaxid.Dataset.from_arrays(
        [t] * 4,
        {f"tau{j + 1}": list(u[:, :, j]) for j in (0, 1)},
        {f"q{j + 1}": list(y[:, :, j]) for j in (0, 1)},
        split=["fit", "fit", "validation", "report"],
        at_rest=True,
        noise_std={f"q{j}": plant.noise for j in (1, 2)},
        resolution={f"q{j}": plant.resolution for j in (1, 2)},
        model="planar_arm",
    )
    assert np.ptp(y[:, :, 0], axis=1).max() > 2 * np.pi
    d = jaxid.diagnose(
        None,
        data,
        effects=["torque_scale", "supply_droop", "back_emf", "torque_ripple", "sensor_bias"],
    )
    # A drive that gives 7 % more at one joint is one that gives 7 % less at the other, on an arm
    # heavier by as much.
    assert d.which.verdict == "named" and len(d.which.effects) == 1
    assert {str(e) for e in (*d.which.effects, *d.which.confusable_with)} == {
        "torque_scale at tau1",
        "torque_scale at tau2",
    }


@dataclasses.dataclass(frozen=True)
class Answer:
    which: Any
    how_far: Any
    notes: tuple[str, ...] = ()
    wall_time_s: float = 0.0
    data: tuple[Any, ...] = ()


@pytest.mark.parametrize(
    ("given", "first", "left", "grown", "second", "expected"),
    [
        (None, "unknown", 80.0, 900.0, "named", "named"),
        (None, "unknown", 80.0, 900.0, "unknown", "unknown"),
        (None, "partly", 80.0, 900.0, "none", "partly"),
        (None, "named", 1.1, 900.0, "", "named"),
        (None, "unknown", 80.0, 9.0, "", "unknown"),
        ("output_error", "unknown", 80.0, 900.0, "", "unknown"),
        (None, "named", 80.0, 900.0, "partly", "partly"),
        (None, "named", 80.0, 900.0, "none", "named"),
        (None, "named", 80.0, 9.0, "", "named"),
    ],
)
def test_windows_are_asked_where_chaotic_free_runs_find_nothing(
    monkeypatch, given, first, left, grown, second, expected
):
    asked = []

    def answer(request, *_):
        asked.append(request.residual.name)
        found = Answer(
            SimpleNamespace(verdict=second if len(asked) > 1 else first),
            SimpleNamespace(gap_after=left),
        )
        return SimpleNamespace(diagnosis=found, request=request, growth=lambda: grown)

    def unasked(request, found, others):  # tests/test_late_effects.py, test_rest_before.py
        return found

    monkeypatch.setattr("jaxid.diagnosis.free_runs.answered", answer)
    monkeypatch.setattr("jaxid.diagnosis.free_runs._asked_further", unasked)
    d = jaxid.diagnose("pendulum", recording("pendulum", 2), residual=given)
    assert (
        d.which.verdict == expected
        and asked == ["output_error", "multiple_shooting"][: 2 if second else 1]
    )
    assert bool(d.notes) == (second == expected != first)


def answer_of(d: Any) -> list[tuple[str, str, dict[str, float]]]:
    """Verdict and effects with their numbers."""
    named = [
        (e.effect, e.location, {k: p.value for k, p in e.parameters.items()})
        for e in d.which.effects
    ]
    return [
        (d.which.verdict, "", {"before": d.how_far.gap_retuned, "after": d.how_far.gap_after}),
        *named,
    ]


def written(
    folder: Path,
    data: jaxid.Dataset,
    order: list[int],
    names: dict[str, str],
    units: dict[str, tuple[str, float]],
):
    """A dataset on disk: runs in this order, channels under these column names, in these units
    (name, size in SI).
    """
    folder.mkdir()
    signals = {"tau": lambda e: e.u[:, 0], "q": lambda e: e.y[:, 0]}
    lines = ["name = 'written'", "[model]", "name = 'pendulum'"]
    for channel, role in (("tau", "input"), ("q", "output")):
        lines += [
            f"[channels.{channel}]",
            f"role = '{role}'",
            f"unit = '{units[channel][0]}'",
            f"column = '{names[channel]}'",
        ]
    lines += [f"noise_std = {NOISE / units['q'][1]!r}"]
    for k in order:
        e = data.experiments[k]
        columns = [e.t, *(signals[c](e) / units[c][1] for c in names)]
        rows = "\n".join(
            ",".join(repr(float(x)) for x in row) for row in zip(*columns, strict=True)
        )
        (folder / f"{e.name}.csv").write_text(f"t,{','.join(names.values())}\n{rows}\n")
        lines += [
            "[[experiments]]",
            f"name = '{e.name}'",
            f"file = '{e.name}.csv'",
            f"split = '{e.split}'",
            "at_rest = true",
        ]
    (folder / "dataset.toml").write_text("\n".join(lines) + "\n")
    return folder


def test_names_units_and_order_change_no_answer(tmp_path):
    other = written(
        tmp_path / "b",
        recording("pendulum", 1, load=0.1),
        [3, 1, 2, 0],
        {"q": "enc_1", "tau": "cmd"},
        {"tau": ("mN m", 1e-3), "q": ("deg", np.pi / 180)},
    )
    first = answer_of(diagnosed(CHOICE, load=0.1))
    second = answer_of(jaxid.diagnose(None, jaxid.load_dataset(other), effects=CHOICE))
    assert first[0][0] == "named" and [x[:2] for x in first] == [x[:2] for x in second]
    for (_, _, a), (_, _, b) in zip(first, second, strict=True):
        assert a == pytest.approx(b, rel=1e-3)


DIAGNOSED = """
import json, os, sys
if sys.argv[2] == "1":
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    os.cpu_count = lambda: 1
import jaxid
d = jaxid.diagnose(None, jaxid.load_dataset(sys.argv[1]), effects=sys.argv[3].split(","))
print(json.dumps([d.which.verdict, d.how_far.gap_after, [[e.effect, {k: p.value for k, p in e.parameters.items()}]
                  for e in d.which.effects]]))
"""


@pytest.mark.slow
@pytest.mark.skipif(
    not hasattr(os, "sched_setaffinity"), reason="this system ties no process to a core"
)
def test_one_core_and_all_give_the_same_bits(tmp_path):
    data = recording("pendulum", 1, load=0.1)
    folder = written(
        tmp_path / "a",
        data,
        [0, 1, 2, 3],
        {"tau": "tau", "q": "q"},
        {"tau": ("N m", 1.0), "q": ("rad", 1.0)},
    )
    command = [sys.executable, "-c", DIAGNOSED, str(folder)]
    said = [
        subprocess.run([*command, n, ",".join(CHOICE)], capture_output=True, text=True, check=True)
        for n in ("1", "all")
    ]
    assert said[0].stdout == said[1].stdout and "load_dependent_friction" in said[0].stdout


def test_a_model_that_lacks_nothing_gets_none():
    d = jaxid.diagnose("pendulum", recording("pendulum", 2))
    assert d.which.verdict == "none" and not d.which.effects and not d.which.confusable_with
    assert d.how_far.shrinkage is None and d.how_far.gap_after == pytest.approx(
        d.how_far.gap_retuned
    )
    assert not d.where


def commanded_arm(drag: tuple[float, float]) -> jaxid.Dataset:
    """A two-link arm along prescribed motion without rests, its torque by the twin's equations with
    noise: three runs of 6 s.
    """
    t, plant = np.arange(1200) / 200, plants.PLANTS["planar_arm"]
    numbers = {
        k: np.tile(x, (len(t), 1))
        for k, x in {"payload": (0.0, 0.0), "tilt": (0.0, 0.0), **plant.nominal}.items()
    }
    taus, qs = [], []
    for k in range(3):
        rng = np.random.default_rng(k)
        a, w, phase = (
            rng.uniform(0.2, 0.5, (3, 2)),
            2 * np.pi * rng.uniform(0.3, 1.2, (3, 2)),
            rng.uniform(0, 6, (3, 2)),
        )
        angle = w * t[:, None, None] + phase
        q, qd, qdd = (
            (a * np.sin(angle)).sum(1),
            (a * w * np.cos(angle)).sum(1),
            -(a * w * w * np.sin(angle)).sum(1),
        )
        M, bias = plant.matrices(q, qd, numbers)
        friction = (
            numbers["viscous"] * qd
            + numbers["coulomb"] * np.sign(qd)
            + np.array(drag) * np.abs(qd) * qd
        )
        taus.append(
            np.einsum("tij,tj->ti", M, qdd) + bias + friction + 0.05 * rng.standard_normal(q.shape)
        )
        qs.append(q + 1e-6 * rng.standard_normal(q.shape))
    return jaxid.Dataset.from_arrays(
        [t] * 3,
        {f"tau{j + 1}": [x[:, j] for x in taus] for j in (0, 1)},
        {f"q{j + 1}": [x[:, j] for x in qs] for j in (0, 1)},
        split=["fit", "validation", "report"],
        model="planar_arm",
    )


@pytest.mark.parametrize(
    ("drag", "places"),
    [
        pytest.param((0.0, 0.15), {"q2"}, marks=pytest.mark.slow),
        ((0.2, 0.15), {"q1", "q2"}),
    ],
)
def test_an_arm_is_diagnosed_by_its_torque(drag, places):
    """Nothing is simulated; an effect that is found at one joint is looked for at the others."""
    data = commanded_arm(drag)
    d = jaxid.diagnose(
        None, data, residual="inverse_dynamics", effects=["quadratic_drag", "spring_torque"]
    )
    assert d.which.verdict == "named" and d.residual == "inverse_dynamics"
    assert {(e.effect, e.location) for e in d.which.effects} == {
        ("quadratic_drag", p) for p in places
    }
    for e in d.which.effects:
        found = e.parameters["coefficient"]
        assert (
            found.std is not None
            and abs(found.value - drag[int(e.location[1]) - 1]) < 4 * found.std
        )
    assert (
        set(d.how_far.per_channel) == {"tau1", "tau2"}
        and d.how_far.gap_after < 1.2 < d.how_far.gap_retuned
    )
    assert {t.channel for t in d.traces} == {"tau1", "tau2"} and "report" in {
        t.split for t in d.traces
    }
    assert d.where[0].location in places


@pytest.mark.slow
def test_a_nominal_term_taken_out_is_found():
    d = jaxid.diagnose("pendulum", recording("pendulum", 3), without=["coulomb_friction"])
    named = {e.effect for e in (*d.which.effects, *d.which.confusable_with)}
    assert "coulomb_friction" in named and "coulomb" in d.final.parameters


@pytest.mark.parametrize("dry", [0.02, 0.0])
@pytest.mark.slow
def test_what_refines_an_effect_that_is_missing_comes_with_it(dry):
    """Stribeck friction is no law without dry friction: a model that has none is asked for both,
    and keeps what the data need.
    """
    data = recording("pendulum", 5, coulomb=dry, stribeck=0.02, stribeck_speed=0.15)
    choice = ["coulomb_friction", "stribeck_friction", *CHOICE]
    d = jaxid.diagnose("pendulum", data, without=["coulomb_friction"], effects=choice)
    found = {e.effect: e.parameters for e in d.which.effects}
    assert d.which.verdict == "named" and set(found) == {"stribeck_friction"} | (
        {"coulomb_friction"} if dry else set()
    )
    extra = found["stribeck_friction"]["extra"]
    assert extra.std is not None and abs(extra.value - 0.02) < 4 * extra.std


@pytest.mark.slow
def test_of_two_effects_neither_need_help_alone():
    """A lag beside asymmetric friction explains the fit runs and spoils the validation runs, which
    go where the friction counts; what a lag of the sensor explains is less, of both.
    """
    data = recording("joint", 3, lag=0.0138, dry_asymmetry=0.0143, viscous_asymmetry=0.002)
    timing = ["input_delay", "sensor_delay", "actuator_lag", "sensor_lag"]
    d = jaxid.diagnose(
        "joint", data, effects=[*timing, "asymmetric_friction", "position_dependent_friction"]
    )
    assert d.which.verdict == "named" and d.how_far.gap_after < 1.2
    assert {e.effect for e in d.which.effects} == {"actuator_lag", "asymmetric_friction"}


@pytest.mark.slow
def test_something_small_is_found_beside_what_was_named():
    """The first effect brings the model near the noise; what is left has the shape of the second,
    and is more than the noise may be off by (6 % of its mean square).
    """
    data = recording("pendulum", 1, load=0.1, drag=3e-4)
    d = jaxid.diagnose("pendulum", data, effects=[*CHOICE, "spring_torque"])
    assert d.which.verdict == "named"
    found = {e.effect: e.parameters for e in d.which.effects}
    assert set(found) == {"load_dependent_friction", "quadratic_drag"}
    (drag,) = found["quadratic_drag"].values()
    assert drag.std is not None and abs(drag.value - 3e-4) < 4 * drag.std


@pytest.mark.slow
def test_a_cause_outside_the_library_is_not_named():
    data = recording("pendulum", 4)
    t = data.experiments[0].t
    pushed = [
        e.y[:, 0] + 0.02 * np.sin(2 * np.pi * 1.3 * t + k) for k, e in enumerate(data.experiments)
    ]
    data = jaxid.Dataset.from_arrays(
        [t] * 4,
        {"tau": [e.u[:, 0] for e in data.experiments]},
        {"q": pushed},
        units={"tau": "N m", "q": "rad"},
        split=["fit", "fit", "validation", "report"],
        noise_std={"q": NOISE},
        model="pendulum",
    )
    d = jaxid.diagnose(None, data)
    assert d.which.verdict in ("unknown", "partly")


def test_wrong_arguments_are_named():
    t = np.arange(400) / 200
    series = [np.sin(t + k) for k in range(4)]
    data = jaxid.Dataset.from_arrays(
        [t] * 4,
        {"tau": series},
        {"q": series},
        units={"tau": "N m", "q": "rad"},
        split=["fit", "fit", "validation", "report"],
        model="joint",
    )
    wrong: list[tuple[dict[str, Any], str]] = [
        ({"effects": ["dead_zon"]}, "dead_zone"),
        ({"max_effects": 0}, "max_effects"),
        ({"without": ["backlash"]}, "backlash"),
        ({"effects": ["coulomb_friction"]}, "coulomb_friction"),
    ]
    for arguments, word in wrong:
        with pytest.raises(jaxid.UsageError, match=word):
            jaxid.diagnose("joint", data, **arguments)
    # By torque, half a second at each end goes to the filter: the first tenth of a run holds no
    # row.
    assert (
        jaxid.diagnose(
            "joint", data, residual="inverse_dynamics", effects=["spring_torque"]
        ).residual
        == "inverse_dynamics"
    )


@pytest.mark.slow
def test_the_order_of_runs_and_the_unit_change_nothing():
    data = recording("pendulum", 1, load=0.1)
    runs = data.experiments
    turned = jaxid.Dataset.from_arrays(
        [e.t for e in runs[::-1]],
        {"tau": [e.u[:, 0] for e in runs[::-1]]},
        {"q": [np.degrees(e.y[:, 0]) for e in runs[::-1]]},
        units={"tau": "N m", "q": "deg"},
        split=[e.split for e in runs[::-1]],
        at_rest=True,
        noise_std={"q": np.degrees(NOISE)},
        model="pendulum",
    )
    a, b = jaxid.diagnose(None, data, effects=CHOICE), jaxid.diagnose(None, turned, effects=CHOICE)
    assert [str(e) for e in a.which.effects] == [str(e) for e in b.which.effects]
    assert a.how_far.gap_after == pytest.approx(b.how_far.gap_after, rel=1e-3)


def test_evidence_counts_memory():
    rng = np.random.default_rng(0)
    white = rng.normal(size=(4000, 1))
    slow = np.convolve(rng.normal(size=4050), np.ones(50) / np.sqrt(50), "valid")[:4000, None]
    assert memory([white]) == 1 and 30 < memory([slow]) < 80
    held = HeldOut([white], [white], 1.0, 4000)
    assert inflation(held) == 1.0
    assert shrink(100.0, 1.0) == 1.0


def test_an_interval_holds_a_further_run():
    """Of runs whose errors are alike, and of those of which few are far worse than the others
    (log-normal).
    """
    rng = np.random.default_rng(1)

    def runs(count: int, spread: float) -> tuple[HeldOut, HeldOut]:
        sizes = np.exp(spread * rng.normal(size=count))

        def noise():
            return [rng.normal(size=(300, 1)) for _ in sizes]

        before = [r + 30.0 for r in noise()]
        after = [r + 0.5 * s for r, s in zip(noise(), sizes, strict=True)]
        return HeldOut(before, before, 900.0, 300 * count), HeldOut(after, after, 1.25, 300 * count)

    def square(r):
        return float(np.mean(r**2))

    def shares(b, a):
        return [shrink(square(x), square(y)) for x, y in zip(b.residual, a.residual, strict=True)]

    for spread in (0.0, 1.5):
        hits = []
        for _ in range(60):
            interval, made_of, _ = interval_of_further_run(*runs(8, spread))
            assert interval is not None and made_of == "runs"
            hits += [interval[0] <= s <= interval[1] for s in shares(*runs(20, spread))]
        assert 0.9 <= np.mean(hits) <= 0.98


@pytest.mark.slow
def test_runs_that_begin_in_motion_are_not_taken_for_a_gap():
    """A joint that turns freely keeps the speed that its first samples tell badly; a part that was
    cut off knows it better.
    """
    runs = recording("joint", 4).experiments
    later = [(e.t[400:] - e.t[400], e.u[400:, 0], e.y[400:, 0]) for e in runs]
    t, u, q = zip(*later, strict=True)

    def cut(**more):
        return jaxid.Dataset.from_arrays(
            t,
            {"tau": u},
            {"q": q},
            units={"tau": "N m", "q": "rad"},
            noise_std={"q": NOISE},
            model="joint",
            **more,
        )

    stated, parts = cut(split=[e.split for e in runs]), cut()
    d, by_parts = (jaxid.diagnose(None, data, effects=CHOICE) for data in (stated, parts))
    assert d.which.verdict == by_parts.which.verdict == "none"
    assert d.how_far.gap_after > 2 and "starts of the report runs leave open" in d.how_far.text
    assert by_parts.how_far.gap_after < 1.3 and "leave open" not in by_parts.how_far.text


def test_an_interval_needs_blocks():
    rng = np.random.default_rng(0)
    white = rng.normal(size=(4000, 1))
    slow = np.convolve(rng.normal(size=4050), np.ones(50) / np.sqrt(50), "valid")[:4000, None]
    held = HeldOut([white], [white], 1.0, 4000)
    interval, made_of, reason = interval_of_further_run(
        HeldOut([10 * white], [white], 100.0, 4000), held
    )
    assert (made_of, reason) == ("blocks", "") and interval is not None
    assert (
        interval[0]
        < shrink(100.0 * float(np.mean(white**2)), float(np.mean(white**2)))
        < interval[1]
    )
    short = HeldOut([slow[:300]], [slow[:300]], 1.0, 300)
    interval, made_of, reason = interval_of_further_run(
        HeldOut([10 * slow[:300]], [slow[:300]], 100.0, 300), short
    )
    assert interval is None and not made_of and "blocks" in reason


@pytest.mark.parametrize("left", [0.0, 0.3])
def test_an_interval_holds_where_the_model_before_is_wrong_for_long(left):
    """What was left before is one slow curve of which a report run holds few independent parts.
    Where the effect leaves none of it the interval knows enough; where it leaves a share, that is
    as slow, and there may be none.
    """
    rng = np.random.default_rng(5)
    kernel = np.ones(100) / 10

    def run() -> tuple[np.ndarray, np.ndarray]:
        curve = np.convolve(rng.normal(size=1500), kernel, "valid")[:, None]
        noise = rng.normal(size=curve.shape)
        return 30 * curve + noise, left * 30 * curve + noise

    hits, none = [], 0
    for _ in range(40):
        before, after = run()

        def held(r):
            return HeldOut([r], [r], float(np.mean(r**2)), len(r))

        interval, _, _ = interval_of_further_run(held(before), held(after))
        none += interval is None
        if interval is not None:

            def square(r):
                return float(np.mean(r**2))

            hits += [interval[0] <= shrink(*map(square, run())) <= interval[1] for _ in range(20)]
    assert none == 0 if left == 0.0 else 5 < none < 35
    assert 0.9 < np.mean(hits) < 0.99


def _possible(diagnosis: jaxid.Diagnosis) -> set[str]:
    """Effects that are claimed or said to be possible."""
    claimed, belief = {e.effect for e in diagnosis.which.effects}, diagnosis.which.belief
    assert belief is not None
    return claimed | {effect for effect, *_ in belief.possible(RULE.possible)}


@pytest.mark.slow
@pytest.mark.skipif(not (DATA / "emps").is_dir(), reason="the EMPS recording is not in $JAXID_DATA")
def test_emps_lacks_a_law_of_friction():
    """One free run bears no claim of which law it is: by torque it would be another one."""
    data = jaxid.load_dataset(DATA / "emps")
    d = jaxid.diagnose(None, data)
    assert d.which.verdict != "none"
    possible = _possible(d)
    assert possible and all(effect.endswith("friction") for effect in possible)
    fit = jaxid.fit(None, data, effects=["load_dependent_friction"])
    errors = [jaxid.simulate(None, data, f).rmse[1]["position"] for f in (d.nominal, fit)]
    assert errors[1] <= 5.5e-3 and errors[1] <= 0.6 * errors[0]


@pytest.mark.slow
@pytest.mark.skipif(
    not (DATA / "multiarm_single_pendulum").is_dir(),
    reason="the free pendulum is not in $JAXID_DATA",
)
def test_a_free_pendulum_lacks_what_takes_energy():
    """Dry friction and drag follow it, and so does friction that falls as it warms up."""
    data = jaxid.load_dataset(DATA / "multiarm_single_pendulum")
    d = jaxid.diagnose(None, data)
    assert d.which.verdict != "none"
    takes = {"quadratic_drag", "coulomb_friction", "temperature_dependent_friction"}
    possible = _possible(d)
    assert possible and possible <= takes
    fit = jaxid.fit(None, data, effects=["coulomb_friction", "quadratic_drag"])
    assert fit.parameters["viscous"].value < 0.02 * d.nominal.parameters["viscous"].value
    assert fit.scores["fit"]["q"].rmse <= 3.0e-3


@pytest.mark.slow
@pytest.mark.skipif(
    not (DATA / "xl330_pendulum").is_dir(), reason="the XL330 recording is not in $JAXID_DATA"
)
def test_no_wrong_law_is_claimed_of_a_recorded_servo():
    """Load-dependent friction closes half of its gap, which bears no claim; a fit with it predicts
    the gain that was left out as well as the recording's notes do.
    """
    from benchmarks import xl330

    data = xl330.data(200)
    d = jaxid.diagnose(None, data)
    assert d.which.verdict != "none" and _possible(d) <= {"load_dependent_friction"}
    errors = xl330.errors(jaxid.fit(None, data, effects=["load_dependent_friction@q"]), data)
    assert np.mean([errors[e.name] for e in data.split("report")]) < 0.032


@pytest.mark.slow
def test_a_delay_at_either_end_of_a_plant_is_the_same_to_any_recording():
    names = ["input_delay", "sensor_delay", "spring_torque"]
    bench = ProblemBuilder(
        bind(
            "pendulum",
            recording("pendulum", 1),
            candidates=[catalogue.effect_class(n) for n in names],
        )
    )
    pool = candidates(bench, names)
    into, out, spring = (next(c for c in pool if c.effect == n) for n in names)

    def named(*effects):
        return cast(Any, SimpleNamespace(effects=effects))

    assert mirrored(bench, named(into), pool) == [out] and mirrored(
        bench, named(out, spring), pool
    ) == [into]
    assert mirrored(bench, named(spring), pool) == mirrored(bench, named(into, out), pool) == []


def test_a_run_that_diverges_is_held_against_no_other():
    """Held-out residuals beyond any number: nothing is taken off them, and nothing fails."""
    r = [np.full((5, 1), 1e12), np.ones((5, 1))]
    slopes = [np.full((5, 1, 2), 1e12), np.ones((5, 1, 2))]
    for about in (np.full((1, 1), np.inf), np.eye(1)):
        moved, price = shifted(r, slopes, about, [np.eye(1), np.eye(1)])
        assert np.isfinite(price) and all(np.isfinite(m).all() for m in moved)


def leaving(fit_loss: float, loss: float, *effects: str) -> Any:
    """What a verdict sees of a hypothesis that leaves these mean squares of fit and validation
    runs.
    """
    path: Any = SimpleNamespace(loss=fit_loss, count=4000)
    return Hypothesis(cast(Any, effects), np.zeros(0), path, HeldOut([], [], loss, 4000))


@pytest.mark.parametrize(
    ("several", "left", "verdict"),
    [(False, 9.0, "named"), (True, 9.0, "partly"), (True, 2.0, "named")],
)
def test_several_effects_must_come_down_to_the_noise(several, left, verdict):
    """Three effects that leave three times the noise of two thousand come close to something
    else.
    """
    found = judge(
        SearchResult(leaving(4e6, 4e6), leaving(left, left, "one", "two", "three"), several=several)
    )
    assert found.name == verdict and "100 %" not in found.text


@pytest.mark.parametrize(
    ("zeros", "wave", "verdict"),
    [
        ((0.5, -0.4), 0.0, "none"),
        ((0.5, -0.4), 0.6, "unknown"),
        ((1.2, -0.4), 0.0, "unknown"),
        ((0.0, 0.0), 0.0, "none"),
    ],
)
def test_where_an_encoder_counts_from_within_a_step_is_no_gap(zeros, wave, verdict):
    """Each run reads its own zero, in steps; more than half a step, or anything that moves, is a
    gap.
    """
    rng = np.random.default_rng(0)
    error = [
        rng.uniform(-0.5, 0.5, (2000, 1)) + z + wave * np.sin(np.arange(2000) / 50)[:, None]
        for z in zeros
    ]
    residual = [np.sqrt(12) * e for e in error]
    loss = float(np.mean(np.square(residual)))
    path: Any = SimpleNamespace(loss=loss, count=4000)
    model: Any = Hypothesis((), np.zeros(0), path, HeldOut([], residual, loss, 4000))
    model.residuals = residual
    assert judge(SearchResult(model, model), np.array([True])).name == verdict
    assert judge(SearchResult(model, model)).name == (
        "none" if loss < 1.2 else "unknown"
    )  # of a channel with noise it is one


@pytest.mark.parametrize(
    "fit_loss, verdict", [(1.0, "named"), (2.0, "named"), (8.0, "named"), (15.5, "partly")]
)
def test_what_is_named_closes_the_gap_of_the_fit_runs_too(fit_loss, verdict):
    """On a tracker whose motors are not as their formula has them, one effect left 15.5 of 429
    there.
    """
    assert (
        judge(
            SearchResult(leaving(429.0, 366.0), leaving(fit_loss, 7.1, "one"), several=False)
        ).name
        == verdict
    )


@pytest.mark.parametrize(
    "retuned, after, verdict",
    [
        (10.0, 1.0, "named"),
        (10.0, 8.0, "partly"),
        (10.0, 12.0, "unknown"),
        (1.1, 1.05, "named"),
        (1.1, 1.105, "unknown"),
        (1.0, 1.005, "named"),  # nothing to be seen there
        (1.07, 1.33, "unknown"),
        (100.0, 40.0, "partly"),
        (100.0, 9.0, "named"),
        (18.5, 3.71, "partly"),
        (3.0, 1.4, "named"),
    ],
)
def test_report_data_withdraw_what_does_not_hold_on_them(retuned, after, verdict):
    judged, gaps = Verdict("named", (Lacks("drag", 1.0),)), Gaps(np.inf, retuned, after)
    found = upheld(judged, gaps)
    assert found.name == verdict and "drag" in found.text
    assert found.text.startswith("The model lacks drag") != (
        verdict == "unknown" and after < retuned
    )
    assert upheld(judged, gaps, several=True).name == (
        "partly" if verdict == "named" and after > 1.5 else verdict
    )


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e300])
def test_a_run_that_diverged_remembers_itself_whole(bad):
    """A candidate that diverges ends no diagnosis."""
    residual = np.random.default_rng(0).normal(size=(100, 2))
    assert memory([residual]) <= 2
    residual[50:, 1] = bad
    assert memory([residual]) == 100


def test_a_number_that_went_as_far_as_the_data_let_it_is_put_back():
    """A small goal never brings the servo's duty to its limit: of motor constant and gain only the
    product is seen. A fit that began where the gain is too large stays there; from there the
    numbers that the user gave are as good.
    """
    t = np.arange(800) / 200
    goal = 0.2 * multisine(t, [1.0], seed=3, periods=2, lines=6)[:, 0]
    truth = {"torque_constant": 0.2, "gain_scale": 1e-3}
    spec = ModelSpec("servo", parameters={n: ParameterPrior(v) for n, v in truth.items()})

    def recorded(q):
        return jaxid.Dataset.from_arrays(
            [t],
            {"q_cmd": [goal]},
            {"q": [q]},
            units={"q_cmd": "rad", "q": "rad"},
            split="fit",
            at_rest=True,
            noise_std={"q": NOISE},
            model=spec,
        )

    numbers = {"parameters": {n: {"value": v} for n, v in truth.items()}, "effects": []}
    q = jaxid.simulate(None, recorded(goal), numbers).runs[0]["q"]
    bench = ProblemBuilder(
        bind(
            None, recorded(q + NOISE * np.random.default_rng(0).standard_normal(800)), splits=False
        )
    )
    b = bench.binding

    def problem(free, theta):
        return bench.problem(OutputError(), "fit", free, theta)

    gain, constant = (b.layout.index(n) for n in ("gain_scale", "torque_constant"))
    theta = b.theta.copy()
    theta[[gain, constant]] = 2e-3, 0.1
    p = problem(b.free, theta)
    astray = levenberg_marquardt([(p, p.z(theta))], 30, 1e-8)[0]
    assert p.theta(astray.z)[gain] > 1.5e-3 and astray.loss < 1.1
    found = put_back(astray, b.theta, b.free, problem)
    assert p.theta(found.z)[gain] == pytest.approx(1e-3, rel=1e-3) and found.cost <= astray.cost + 2
    assert p.theta(found.z)[constant] == pytest.approx(0.2, rel=0.05)


@pytest.mark.slow
def test_held_out_runs_tell_what_the_fit_runs_leave_open():
    """A limit that the fit run does not reach: the validation run does, and says where it is."""
    t = np.arange(800) / 200
    u = [
        a * multisine(t, [0.4], seed=k, periods=2, lines=6)[:, 0] for k, a in enumerate((0.35, 1.0))
    ]
    plant = dataclasses.replace(plants.PLANTS["pendulum"], rate=200, noise=NOISE, resolution=0.0)
    numbers = {
        k: np.tile(x, (2, 1)) for k, x in (plant.nominal | {"limit": np.array([0.3])}).items()
    }
    y = twins.recorded(plant, np.array(u)[:, :, None], numbers, np.random.default_rng(3))
    data = jaxid.Dataset.from_arrays(
        [t] * 2,
        {"tau": u},
        {"q": list(y[:, :, 0])},
        units={"tau": "N m", "q": "rad"},
        split=["fit", "validation"],
        at_rest=True,
        noise_std={"q": NOISE},
        model="pendulum",
    )
    assert np.abs(u[0]).max() < 0.3 < np.abs(u[1]).max()
    bench = ProblemBuilder(bind("pendulum", data, effects=["saturation"]), 1.25e-3)
    (limit,) = bench.binding.layout.of_effect("saturation")
    theta = start_values(bench, bench.binding.free, 0)[0]
    theta[limit] = 0.39  # anywhere above the fit run's command
    p = bench.problem(OutputError(), "fit", bench.binding.free, theta)
    path = levenberg_marquardt([(p, p.z(theta))], 30, 1e-8)[0]
    assert 2 * path.cost / path.count < 1.2
    told, theta = [knowledge(path)], p.theta(path.z)
    first, followed = (
        held_out(bench, "validation", [theta], None, told, follow)[0] for follow in (None, [path])
    )
    assert first.gap > 5 and followed.gap == first.gap  # the prediction is what it is
    assert (
        followed.loss < 1.2
        and followed.theta is not None
        and abs(followed.theta[limit] - 0.3) < 2e-3
    )


@pytest.mark.slow
def test_a_limit_far_below_the_commands_is_found():
    """A servo that hardly follows its goals is re-tuned to one that stands still, which milder
    limits move no more.
    """
    t = np.arange(1200) / 200
    u = [2 * multisine(t, [1.0], seed=k, periods=2, lines=6)[:, 0] for k in range(3)]
    plant = dataclasses.replace(plants.PLANTS["servo"], rate=200, noise=NOISE, resolution=0.0)
    numbers = {
        k: np.tile(x, (3, 1)) for k, x in (plant.nominal | {"limit": np.array([0.25])}).items()
    }
    y = twins.recorded(plant, np.array(u)[:, :, None], numbers, np.random.default_rng(3))
    data = jaxid.Dataset.from_arrays(
        [t] * 3,
        {"q_cmd": u},
        {"q": list(y[:, :, 0])},
        units={"q_cmd": "rad", "q": "rad"},
        split=["fit", "validation", "report"],
        at_rest=True,
        noise_std={"q": NOISE},
        model="servo",
    )
    d = jaxid.diagnose(
        "servo", data, effects=["saturation", "torque_scale", "sensor_bias"], max_effects=1
    )
    (found,) = d.which.effects
    (limit,) = found.parameters.values()
    assert (
        found.effect == "saturation"
        and limit.std
        and abs(limit.value - 0.25) < 4 * limit.std + 1e-3
    )


def test_what_leads_a_screen_and_what_may_equal_it_is_refitted_however_many_there_are(monkeypatch):
    names = [
        "quadratic_drag",
        "dead_zone",
        "saturation",
        "asymmetric_friction",
        "spring_torque",
        "power_law_friction",
    ]
    bench = ProblemBuilder(
        bind(
            "pendulum",
            recording("pendulum", 2),
            candidates=[catalogue.effect_class(n) for n in names],
        )
    )
    ranked = [(1 / (1 + k), c, []) for k, n in enumerate(names) for c in candidates(bench, [n])]

    def kept(free, torque):
        return [
            c.effect for _, c, _ in shortlist.shortlist(bench, free, torque, lambda c: False, False)
        ]

    assert kept(ranked, []) == names  # one screen only
    monkeypatch.setattr(shortlist, "MINIMUM", 1)
    assert kept(ranked, ranked[4:5]) == [
        "quadratic_drag",
        "spring_torque",
        *names[1:4],
        "power_law_friction",
    ]
    monkeypatch.setattr(shortlist, "FRONT", 1)
    monkeypatch.setattr(shortlist, "MAXIMUM", 1)
    assert kept(ranked, ranked[4:5]) == ["quadratic_drag", "spring_torque", "power_law_friction"]


@pytest.mark.slow
def test_an_effect_is_left_out_with_the_others_where_they_end_without_it():
    """A scale of the torque and the model's own numbers are known only together: without it they
    have to go along.
    """
    kinds = [catalogue.effect_class(n) for n in ("torque_scale", "dead_zone")]
    bench = ProblemBuilder(
        bind("pendulum", recording("pendulum", 2, dead_zone=0.05), candidates=kinds)
    )
    (scale,), (zone,) = (candidates(bench, [k.name]) for k in kinds)
    own, theta = bench.binding.free, bench.binding.theta.copy()
    theta[list(zone.index)] = 0.05
    less, more = (
        bench.problem(OutputError(), "fit", [*own, *zone.index, *i], theta)
        for i in ((), scale.index)
    )
    end = levenberg_marquardt([(less, less.z(theta))], 40, 1e-8)[0]
    theta = less.theta(end.z)
    theta[own] *= 1.01  # along the valley
    theta[list(scale.index)] = 0.01
    path = levenberg_marquardt([(more, more.z(theta))], 0, 1e-8)[0]
    effects, (retuned, plain) = left_out(
        bench, cast(Any, SimpleNamespace(path=path, theta=theta, effects=(scale, zone))), scale
    )
    there, here = levenberg_marquardt([(less, less.z(t)) for t in (retuned, plain)], 0, 1e-6)
    assert (
        effects == (zone,)
        and not retuned[list(scale.index)].any()
        and not plain[list(scale.index)].any()
    )
    assert path.loss < 10 and there.loss < 1.1 * path.loss and here.loss > 10 * path.loss
    path.hessian = None
    assert (
        len(
            left_out(
                bench,
                cast(Any, SimpleNamespace(path=path, theta=theta, effects=(scale, zone))),
                scale,
            )[1]
        )
        == 1
    )


@pytest.mark.slow
def test_a_search_that_has_simulated_enough_ends_and_says_so(monkeypatch):
    """All single effects are asked in any case; what would come beside them is not, where nothing
    may be simulated any more.
    """
    both = recording("pendulum", 5, load=0.1, lag=0.03)
    effects = [
        "load_dependent_friction",
        "actuator_lag",
        "quadratic_drag",
        "input_delay",
        "spring_torque",
    ]
    whole = jaxid.diagnose("pendulum", both, effects=effects)
    assert {e.effect for e in whole.which.effects} == {"load_dependent_friction", "actuator_lag"}
    assert "ended" not in whole.which.text
    monkeypatch.setattr(search, "MOST_STEPS", 0)
    monkeypatch.setattr(search, "MOST_RUNS", 0)
    short = jaxid.diagnose("pendulum", both, effects=effects)
    assert len(short.which.effects) < 2 and short.which.verdict != "named"
    assert "The search ended early, at what it may simulate" in short.which.text and short.complete
    one = jaxid.diagnose("pendulum", recording("pendulum", 1, load=0.1), effects=effects)
    assert [e.effect for e in one.which.effects] == [
        "load_dependent_friction"
    ] and "ended" not in one.which.text


class Stuck(Refits):
    """No descent of its nominal model leads out of the minimum where it stands."""

    def descended(self, h, descent=THOROUGH):
        return super().descended(h, descent) if h.effects else h


def test_an_effect_that_only_led_out_of_a_local_minimum_is_not_named():
    """The effect's refit comes down to the noise and is accepted; once the model without it gets
    there too, it names nothing.
    """
    binding = bind(
        "pendulum", recording("pendulum", 2), candidates=[catalogue.effect_class("quadratic_drag")]
    )
    bench = ProblemBuilder(binding, differences=1)
    p = bench.problem(OutputError(), "fit", binding.free, binding.theta)
    right = levenberg_marquardt([(p, p.z(start_values(bench, binding.free, 0)[0]))], 20, 1e-8)[0]
    theta = p.theta(right.z)
    theta[binding.layout.index("inertia")] *= 1.2
    off = levenberg_marquardt([(p, p.z(theta, p.starts(right.z)))], 0, 1e-8)[0]
    assert off.loss > 100
    pool = candidates(bench, ["quadratic_drag"])
    found = Searcher(Stuck(bench, OutputError(), off)).run(pool, 3)
    assert any(h.effects and h.fit_loss < 1.1 for h in found.tried)
    assert not found.chosen.effects and not found.confusable and found.nominal.fit_loss < 1.1
