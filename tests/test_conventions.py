"""What a recording says about itself: each kind of finding, its size, the line that mends it, and
silence where all is well.
"""

import json
import os
from dataclasses import replace
from math import pi
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array
from scipy.signal import butter, lfilter, sosfilt

import jaxid
from benchmarks.conventions import found
from jaxid.base.errors import UsageError
from jaxid.benchmark.broken import broken, KINDS, recording
from jaxid.cli.app import main
from jaxid.conventions import checking, finding, law
from jaxid.conventions.mending import mended, Mending
from jaxid.conventions.missing_force import measured
from jaxid.conventions.readings import scaled_input, scaled_joint
from jaxid.conventions.words import finding_text
from jaxid.data.dataset import Controller
from jaxid.dynamics.mechanism import Rigid, Signature
from jaxid.dynamics.parameter import constant, param
from jaxid.fitters.short_fit import left_by_short_fit
from jaxid.force.columns import Forces
from jaxid.models.effects import ConstantTorque, CoulombFriction, ViscousFriction
from jaxid.problem.binding import bind


CASES = (
    Path(os.environ.get("JAXID_DATA", Path(__file__).parents[2] / "shared" / "data")).parent
    / "cases"
)
LINES = {
    "sign": "scale = -1",
    "zero": "offset = -1.5708", "scale": 'unit = "deg"', "row_shift": "shift = 1", "wrapped": "unwrap = true",
    "glitch": "drop_glitches = true", "repeated_rows": "sampled_every = 4", "time_unit": 'time_unit = "ms"',
    "not_at_rest": "at_rest = false",
}  # fmt: skip
#: What no line mends, or what is one of several explanations.
QUESTIONS = ("time_unit", "does_not_move", "unsigned", "filtered", "saturated")


def case(name: str) -> Path:
    if not (CASES / name).is_dir():
        pytest.skip(
            f"{name} is not in {CASES}: set JAXID_DATA to the folder of recordings beside them"
        )
    return CASES / name


def checked(dataset: jaxid.Dataset):
    """Without the simulation that confirms."""
    return checking.run_check(None, dataset)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("model", "effect"), [("pendulum", ""), ("pendulum", "drag"), ("planar_arm", "")]
)
def test_each_kind_is_found_with_its_size_and_its_line(model, effect, kind):
    if kind == "swapped_channels" and model == "pendulum":
        pytest.skip("a pendulum has one input and one output")
    r, channel, value = broken(
        kind, recording(model, 5, effect), np.random.default_rng(KINDS.index(kind))
    )
    findings = found(r)
    anywhere = kind in ("not_at_rest", "row_shift", "clock")  # all inputs, or any output
    own = [f for f in findings if f.kind == kind and (anywhere or f.channel == channel)]
    assert own, [str(f.kind) for f in findings]
    assert not [f for f in findings if f not in own and f.decisive]
    assert own[0].decisive == (kind not in QUESTIONS)
    assert own[0].line.split("  #")[0] == LINES.get(kind, own[0].line.split("  #")[0])
    if value is not None and own[0].interval_95 is not None:
        low, high = own[0].interval_95
        assert low - 0.05 * abs(value) <= value <= high + 0.05 * abs(value)
    elif value is not None:
        assert own[0].value == pytest.approx(value, rel=0.15, abs=1e-6)


@pytest.mark.parametrize("effect", ["", "drag", "spring"])
@pytest.mark.parametrize("model", ["joint", "pendulum", "planar_arm"])
def test_nothing_is_claimed_of_a_sound_recording(model, effect):
    assert not [f for f in found(recording(model, 11, effect)) if f.decisive]


@pytest.mark.parametrize("kind", ["zero", "scale"])
def test_a_fault_beside_a_strong_missing_effect_is_found_beside_its_law(kind):
    r, channel, value = broken(kind, recording("tracker", 5, "drag"), np.random.default_rng(0))
    (finding,) = [f for f in found(r) if f.decisive]
    assert (finding.kind, finding.channel, finding.value) == (kind, channel, value)


def test_counts_are_asked_about_by_their_number_per_turn():
    """4000 a turn are 2 % from 4096, and such a fit knows the factor no better."""
    r = recording("pendulum", 5)
    (finding,) = [f for f in found(replace(r, y=np.round(r.y * 4096 / (2 * pi)))) if f.gap_before]
    assert finding.kind == "scale" and finding.value == pytest.approx(4096 / (2 * pi))
    assert "counts of 4096 per turn" in finding.text and not finding.decisive


class Lever(Rigid):
    """A pendulum on a motor: how much torque a volt makes is fitted."""

    name: ClassVar[str] = "lever"
    signatures: ClassVar[tuple[Signature, ...]] = (
        Signature((("u", "V"),), (("q", "rad"),), ("q",)),
    )
    builtin: ClassVar[tuple[tuple[type, dict[str, str]], ...]] = (
        (ViscousFriction, {"coefficient": "viscous"}),
        (CoulombFriction, {"level": "coulomb"}),
        (ConstantTorque, {"torque": "offset"}),
    )
    equations: ClassVar[str] = (
        "inertia qdd + gravity_torque sin(q) + viscous qd + coulomb sign(qd) + offset = gain u"
    )
    source: ClassVar[str] = "textbook"
    inertia: Array = param(0.02, 1e-4, 10.0, unit="kg m^2", log=True)
    gain: Array = param(0.1, 1e-3, 10.0, unit="N m/V", log=True)
    gravity_torque: Array = constant(0.9, unit="N m")

    def drive(self, signature, u, q, qd):
        return self.gain * u

    def matrices(self, q, qd):
        return self.inertia[None, None], self.gravity_torque * jnp.sin(q)


@pytest.mark.parametrize(
    ("turned", "late", "found"), [(0.0, 1.2, []), (pi / 2, 0.0, [("zero", "q", pi / 2)])]
)
def test_no_scale_of_an_angle_hides_what_a_drive_of_volts_lacks(turned, late, found):
    """The larger the motion is taken, the more it takes: what remains is compared with that, not
    with what it took before.
    """
    r = recording("pendulum", 5)
    u = np.array([np.interp(r.t - late * r.t[1], r.t, x) for x in r.u[:, :, 0] / 0.15])
    data = jaxid.Dataset.from_arrays(
        [r.t] * 3,
        {"u": list(u)},
        {"q": list(r.y[:, :, 0] + turned)},
        units={"u": "V"},
        split=["fit", "fit", "validation"],
        check_model=False,
    )
    claimed = [f for f in checking.run_check(Lever(), data).findings if f.decisive]
    assert [(f.kind, f.channel, f.value) for f in claimed if f.kind != "row_shift"] == found


def test_degrees_of_a_servo_under_goals_are_told_from_other_units():
    """Gain, torque and back-EMF make up for much of a scale: the factor is sought from the numbers
    that fit with it.
    """
    r = recording("servo", 5, noise=0.0)
    speed = np.gradient(r.y, r.t, axis=1)
    goal = r.y + (r.u + 0.04 * speed) / (0.12 * 7.4 * 0.4)
    noisy = r.y + 3e-4 * np.random.default_rng(0).standard_normal(r.y.shape)
    (finding,) = [f for f in found(replace(r, u=goal, y=np.degrees(noisy))) if f.decisive]
    assert (finding.kind, finding.channel) == ("scale", "q") and finding.value == pytest.approx(
        180 / pi
    )


def test_a_slow_sensor_is_no_sign():
    r = recording("pendulum", 5)
    b, a = butter(1, 1.0, fs=200)  # pyright: ignore
    assert not [f for f in found(replace(r, y=lfilter(b, a, r.y, axis=1))) if f.decisive]


@pytest.mark.parametrize("kind", ["row_shift", "sign"])
def test_what_a_simulation_does_not_bear_out_is_a_question(kind):
    r, _, _ = broken(kind, recording("pendulum", 5, "spring"), np.random.default_rng(0))
    (finding,) = [
        f
        for f in checking.run_check(None, r.dataset(), gap=lambda *_: 20.0).findings
        if f.kind == kind
    ]
    assert not finding.decisive and finding.gap_before == finding.gap_if_mended == 20.0


@pytest.mark.slow
def test_what_is_found_beside_laws_is_simulated_beside_them():
    """A row's delay is a hundredth of what a spring leaves that the model lacks: without the spring
    no simulation shows it.
    """
    r, _, _ = broken("row_shift", recording("pendulum", 5, "spring"), np.random.default_rng(0))
    (finding,) = [
        f
        for f in checking.run_check(None, r.dataset(), gap=left_by_short_fit).findings
        if f.kind == "row_shift"
    ]
    assert finding.decisive and finding.gap_if_mended is not None and finding.gap_before is not None
    assert finding.gap_if_mended < 0.7 * finding.gap_before


@pytest.mark.parametrize(
    ("corner", "said"), [(0.1, True), (0.2, True), (0.35, False), (0.45, False)]
)
def test_a_filter_is_told_only_far_below_the_rate(corner, said):
    r = recording("pendulum", 5)
    noise = 0.01 * np.random.default_rng(1).standard_normal(r.y.shape)
    noisy = sosfilt(butter(4, corner * 200, fs=200, output="sos"), noise, axis=1)
    kinds = [f.kind for f in checking.run_check(None, replace(r, y=r.y + noisy).dataset()).findings]
    assert ("filtered" in kinds) is said


def test_a_reading_has_to_hold_in_the_runs_that_are_kept_back():
    """A sign leaves more than the whole drive of a run whose torque is four times too large: it is
    not all that is wrong.
    """
    r = recording("pendulum", 5)
    claimed = found(replace(r, u=-r.u * np.array([1.0, 1.0, 4.0])[:, None, None]))
    assert not [f for f in claimed if f.kind in ("sign", "zero", "scale")]


def test_small_faults_stay_the_effects_that_they_are():
    r = recording("pendulum", 3)
    for u, y in (
        (r.u, r.y + 0.03),
        (r.u, 1.07 * r.y),
        (1.07 * r.u, r.y),
        (r.u[:, :-3], r.y[:, 3:] + 0.0),
    ):
        late = replace(r, t=r.t[: u.shape[1]], u=u, y=y)
        claimed = [f for f in found(late) if f.decisive and f.kind != "row_shift"]
        assert not claimed


def test_a_causal_delay_of_whole_rows_is_a_question_beside_input_delay():
    r = recording("pendulum", 3)
    late = replace(r, t=r.t[:-2], u=r.u[:, 2:], y=r.y[:, :-2])
    (finding,) = [f for f in found(late) if f.kind == "row_shift"]
    assert (finding.value, finding.decisive, finding.line) == (-2.0, False, "shift = -2")
    assert ("input_delay", "tau") in finding.same_as


def test_a_lone_joint_cannot_tell_the_sign_of_torque_and_angle_apart():
    r, _, _ = broken("sign", recording("joint", 4), np.random.default_rng(0))
    result = checked(r.dataset())
    (finding,) = result.findings
    assert (finding.kind, finding.channel, finding.same_as) == ("sign", "tau", (("sign", "q"),))
    assert finding.applied and result.mended is not None
    assert np.array_equal(result.mended.experiments[0].u, -r.u[0])


def test_lines_compose_with_what_the_file_says():
    r = recording("pendulum", 5)
    y = np.degrees(r.y + pi / 2)
    raw = (y - 20.0) / 0.5
    data = replace(r, y=raw).dataset(scale={"q": 0.5}, offset={"q": 20.0}).channels
    plain = replace(r, y=r.y).dataset()
    degrees = jaxid.Dataset.from_arrays(
        [r.t] * 3,
        {"tau": list(r.u[:, :, 0])},
        {"q": list(raw[:, :, 0])},
        units={"q": "deg"},
        scale={"q": 0.5},
        offset={"q": 20.0},
        split=["fit", "fit", "validation"],
        model="pendulum",
    )
    assert len(data) == len(plain.channels)
    (finding,) = checked(degrees).findings
    assert (finding.kind, finding.line) == ("zero", "offset = -70")


def test_mending_is_what_the_line_would_do():
    r = recording("pendulum", 5)
    data = r.dataset()
    change = Mending({"tau": {"scale": -1.0, "shift": 1}}).then(
        Mending({"q": {"scale": 2.0, "offset": 0.5}})
    )
    got = mended(data, change)
    want = r.dataset(scale={"tau": -1.0, "q": 2.0}, offset={"q": 0.5}, shift={"tau": 1})
    for a, b in zip(got.experiments, want.experiments, strict=True):
        assert np.array_equal(a.t, b.t) and np.allclose(a.u, b.u) and np.allclose(a.y, b.y)


@pytest.mark.parametrize(
    ("name", "kind", "channel", "line"),
    [
        ("data_03_torque_sign_joint", "sign", "tau", "scale = -1"),
        ("data_05_wrapped_angle", "wrapped", "q", "unwrap = true"),
        ("data_10_input_one_row_late", "row_shift", "tau", "shift = 1"),
        ("data_12_pendulum_zero_is_horizontal", "zero", "q", "offset = -1.5708"),
        ("data_15_at_rest_is_false", "not_at_rest", "q", "at_rest = false"),
        ("rig_05_swapped_sign_no_hint", "sign", "tau", "scale = -1"),
    ],
)
def test_shared_cases(name, kind, channel, line):
    (finding,) = checked(jaxid.load_dataset(case(name))).findings
    assert (finding.kind, finding.channel, finding.line, finding.applied) == (
        kind,
        channel,
        line,
        True,
    )


@pytest.mark.filterwarnings("ignore::jaxid.base.errors.DatasetWarning")
def test_a_run_that_comes_to_rest_says_which_part_moves():
    findings = checked(jaxid.load_dataset(case("rec_03_report_stands_still"))).findings
    (still,) = [f for f in findings if f.channel == "run_1"]
    assert still.kind == "does_not_move" and still.line.startswith("window_s = [0, 1.5")


def test_asymmetric_friction_is_no_convention():
    assert not checked(jaxid.load_dataset(case("rec_04_asymmetric_called_nothing"))).findings


def test_command_writes_findings_and_exit_codes(tmp_path, capsys):
    good = tmp_path / "good"
    jaxid.save_dataset(recording("pendulum", 5).dataset(), good, format="csv")
    assert main(["check", str(good), "--out", str(tmp_path / "out")]) == 0
    assert "Nothing found" in capsys.readouterr().out
    content = json.loads((tmp_path / "out" / "check.json").read_text())
    assert content["data"] == {"findings": []} and content["usable"]
    assert "Nothing found" in (tmp_path / "out" / "report.html").read_text()
    slow = tmp_path / "slow"
    slow.mkdir()
    for file in good.iterdir():
        text = file.read_text()
        if file.suffix == ".csv":
            head, *rows = text.splitlines()
            text = "\n".join(
                [
                    head,
                    *(
                        f"{1000 * float(r.split(',')[0])},{','.join(r.split(',')[1:])}"
                        for r in rows
                    ),
                ]
            )
        (slow / file.name).write_text(text.replace('time_unit = "s"', ""))
    assert main(["check", str(slow), "--json"]) == 1
    (finding,) = json.loads(capsys.readouterr().out)["data"]["findings"]
    assert (finding["kind"], finding["line"]) == ("time_unit", 'time_unit = "ms"')
    assert main(["check", str(tmp_path / "nothing")]) == 2


@pytest.mark.slow
def test_an_answer_begins_with_what_was_applied_and_names_the_effect_after_it():
    r, _, _ = broken("sign", recording("pendulum", 5, "drag"), np.random.default_rng(0))
    data = r.dataset()
    result = jaxid.diagnose(
        None, data, effects=["quadratic_drag", "spring_torque", "torque_ripple"]
    )
    assert [e.effect for e in result.which.effects] == [
        "quadratic_drag"
    ] and result.which.verdict == "named"
    (finding,) = result.to_dict()["data"]["findings"]
    assert finding["applied"] and finding["gap_if_mended"] < 0.5 * finding["gap_before"]
    assert repr(result).startswith(
        "DATA: tau has the opposite sign; everything below takes it negated."
    )
    plain = jaxid.fit(None, data, budget=20, as_recorded=True)
    assert [f.applied for f in plain.data] == [False] and not repr(plain).startswith("DATA")


def test_effects_that_cannot_be_believed_are_said_so():
    from jaxid.diagnosis.believable import doubts
    from jaxid.fitting.result import Covariance, EffectEstimate, Estimate

    def number(value, std, lower=-1.0, upper=1.0, at_bound=False):
        return Estimate(value, std, "1", lower, upper, at_bound)

    off = EffectEstimate("torque_scale", "tau", {"gain": number(-0.895, 0.001, -0.9, 5.0)})
    nothing = EffectEstimate(
        "torque_ripple",
        "q",
        {"sine": number(0.2, 0.49), "cosine": number(0.1, 0.3), "order": number(3, 0.1)},
    )
    pushed = EffectEstimate(
        "spring_torque", "q", {"stiffness": number(4.0, 0.1, -4.0, 4.0, at_bound=True)}
    )
    sound = [
        EffectEstimate("spring_torque", "q", {"stiffness": number(0.4, 0.01)}),
        EffectEstimate("input_hold", "tau", {"linear": number(1.0, 0.01, 0.0, 1.0, at_bound=True)}),
        EffectEstimate("torque_scale", "tau", {"gain": number(0.1, 0.001)}),
    ]
    assert list(doubts([off, nothing, pushed, *sound])) == [str(off), str(nothing), str(pushed)]
    assert not doubts(sound)
    # A sine and a cosine of unknown phase: neither is sure, both together are.
    names = ("torque_ripple.sine@q", "torque_ripple.cosine@q")

    def together(share):
        return Covariance(
            names, np.array([[0.49**2, share * 0.49 * 0.3], [share * 0.49 * 0.3, 0.3**2]])
        )

    assert str(nothing) in doubts([nothing], together(0.0)) and not doubts(
        [nothing], together(-0.999)
    )
    assert str(nothing) in doubts([nothing], together(1.0)) and str(nothing) in doubts(
        [nothing], Covariance((), np.zeros((0, 0)))
    )


@pytest.fixture(scope="module")
def recorded_arm() -> jaxid.Dataset:
    folder = CASES.parent / "data" / "ur10e"
    if not folder.is_dir():
        pytest.skip(f"no recording of a UR10e at {folder}: set JAXID_DATA")
    return jaxid.load_dataset(folder)


@pytest.mark.parametrize(
    ("fault", "kind", "line"),
    [
        (Mending(), None, ""),
        (Mending({"tau2": {"scale": -1.0}}), "sign", "scale = -13.26"),
        (Mending({"q3": {"scale": -1.0}}), "sign", "scale = -1"),
        (Mending({"q2": {"scale": 180 / pi}}), "scale", 'unit = "deg"'),
        (Mending({"q3": {"scale": pi / 180}}), "scale", "scale = 57.2958"),
        (Mending({"tau3": {"scale": 1000.0}}), "scale", 'unit = "mN m"'),
        (Mending({"q2": {"offset": pi / 2}}), "zero", "offset = -1.5708"),
        (
            Mending(exchanged=(("tau4", "tau5"),)),
            "swapped_channels",
            'column = "i5"  # of tau4\ncolumn = "i4"  # of tau5',
        ),
    ],
)
@pytest.mark.filterwarnings("ignore::jaxid.base.errors.DatasetWarning")
def test_faults_of_an_arm_with_many_numbers(recorded_arm, fault, kind, line):
    """Six joints, 58 numbers, in a few seconds each."""
    findings = [
        f for f in jaxid.check(None, mended(recorded_arm, fault)).findings if f.kind != "glitch"
    ]
    assert [f.kind for f in findings] == ([kind] if kind else [])
    assert not kind or (
        findings[0].decisive
        and findings[0].line == line
        and findings[0].channel in line + str(fault)
    )


def test_columns_are_made_once_and_give_the_force():
    """One motion's columns serve every reading of its inputs; other numbers and few samples give
    what the model itself does.
    """
    binding = bind(None, recording("pendulum", 5).dataset())
    motion = measured(binding)
    assert motion is not None
    forces = Forces(binding.layout, binding.theta, binding.scale, binding.free, motion)
    theta = binding.theta.copy()
    theta[binding.free] = np.clip(
        1.3 * theta[binding.free] + 0.01, binding.lower[binding.free], binding.upper[binding.free]
    )
    for m in (
        motion,
        scaled_input(motion, 0, -1.0),
        scaled_joint(motion, 0, -1.0),
        motion.thinned(100),
    ):
        straight = forces.at(theta[None], m)[0]
        assert np.allclose(
            forces.missing(theta, m), straight, rtol=0, atol=1e-8 * np.abs(straight).max()
        )
    assert forces.linear and forces.additive
    assert forces.columns(motion)[1] is forces.columns(scaled_input(motion, 0, -1.0))[1]
    few = motion.thinned(100)
    at = np.arange(0, len(motion.q), -(-len(motion.q) // 100))
    assert np.array_equal(few.q, motion.q[at]) and np.array_equal(few.u, motion.u[at])


@pytest.mark.parametrize(
    ("error", "noted"), [(UsageError("too short"), True), (ValueError("a slip"), False)]
)
def test_only_what_the_data_do_not_allow_becomes_a_note(monkeypatch, error, noted):
    def fails(*_):
        raise error

    monkeypatch.setattr(checking, "measured", fails)
    data = recording("pendulum", 5).dataset()
    if noted:
        assert "too short" in " ".join(checked(data).notes)
    else:
        with pytest.raises(ValueError, match="a slip"):
            checked(data)


def test_a_current_is_no_torque_whatever_its_channel_is_called():
    """A dataset that names no model states units of its own; a model that is given beside it is
    held to them.
    """
    t = np.arange(400) / 100
    data = jaxid.Dataset.from_arrays(
        t, {"tau": np.sin(t)}, {"q": np.sin(t) ** 2}, units={"tau": "mA"}
    )
    with pytest.raises(UsageError, match="'tau' is in A, but model 'joint' needs N m"):
        jaxid.fit("joint", data)
    checked = jaxid.check("joint", data)
    assert not checked.model and any("'tau' is in A" in note for note in checked.notes)
    assert "no model was asked" in str(checked)


@pytest.mark.parametrize(
    ("as_read", "other", "late", "decisive"),
    [(71, 1.5, 27, True), (71, 20, 1.5, False), (71, 60, 71, None), (1.1, 0.7, 1, None)],
)
def test_a_law_is_read_otherwise_where_no_delay_comes_near(as_read, other, late, decisive):
    data = jaxid.Dataset.from_arrays(
        np.arange(100) / 100,
        {"q_cmd": np.sin(np.arange(100.0))},
        {"q": np.cos(np.arange(100.0))},
        units={"q_cmd": "rad"},
        controller=Controller("pd", {"kp": 20.0, "kd": 1.5}),
        check_model=False,
    )

    def driven(**law: Any) -> Any:
        return SimpleNamespace(
            chain=SimpleNamespace(mechanism=SimpleNamespace(drive_law=SimpleNamespace(**law)))
        )

    assert law.is_open(driven(rate=True, kd=(0.0, 1.5)), data)
    assert not law.is_open(driven(rate=True, kd=(1.5,)), law.read_as(data, "none"))
    assert not law.is_open(driven(rate=False, kd=(1.5,)), data) and not law.is_open(
        driven(rate=True, kd=(0.0,)), data
    )

    def left(d, effects):
        return (
            late if effects else other if "reference_velocity" in d.controller.settings else as_read
        )

    found = law.law_reading(data, left, ("q_cmd",))
    assert (found and found.decisive) == decisive
    if found is not None:
        assert found.line == 'reference_velocity = "none"' and bool(found.same_as) != decisive
        assert "under [controller]" in finding_text(found) and found.kind in finding.KINDS
