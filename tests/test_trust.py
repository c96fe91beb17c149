"""How far stated numbers are trusted, and how near a model has to come."""

import numpy as np
import pytest

import jaxid
from jaxid.base.errors import UsageError
from jaxid.data.dataset import Dataset, ModelSpec, ParameterPrior
from jaxid.data.noise import Noise
from jaxid.models import Robot
from jaxid.problem.accuracy import accuracy_of, beside_accuracy
from jaxid.problem.binding import bind
from jaxid.problem.trust import CHOICES, sentence, spread_of, SPREADS, told, trusting


ARM = """<mujoco><worldbody><body name="upper"><joint name="lift" axis="0 1 0" armature="0.02"
damping="0.2"/><inertial pos="0.1 0 0" mass="0.4" diaginertia="2e-3 3e-3 4e-3"/></body></worldbody>
<actuator><position name="lift" joint="lift" kp="20" kv="0.4"/></actuator></mujoco>"""


def pendulum(trust: str | None = None, **priors: ParameterPrior) -> jaxid.Dataset:
    t = np.arange(0, 4, 0.01)
    return jaxid.Dataset.from_arrays(
        t,
        {"tau": np.sin(3 * t)},
        {"q": 0.1 * np.sin(3 * t)},
        units={"tau": "N m", "q": "rad"},
        model=ModelSpec("pendulum", parameters=priors, trust=trust),
        check_model=False,
    )


def test_what_is_stated_is_known_by_its_kind():
    stated = {
        "inertia": ParameterPrior(0.06),
        "viscous": ParameterPrior(0.2),
        "coulomb": ParameterPrior(None, prior={"mean": 0.3, "std": 0.01}),
    }
    bound = trusting(bind(None, pendulum(None, **stated)))
    known = {bound.layout.names[i]: prior for i, prior in bound.priors.items()}
    assert known["inertia"] == (0.06, pytest.approx(0.006))
    assert known["viscous"] == (0.2, pytest.approx(0.1))
    assert known["coulomb"] == (0.3, 0.01)  # its own prior comes first
    assert "gravity_torque" not in known  # nobody stated it
    assert told(bound) == {"level": "measured", "spreads": {"inertia": 0.1, "damping": 0.5}}
    assert (
        sentence(bound) == "stated numbers count as measured: inertia to 10 % and damping to 50 %"
    )


def test_a_robots_file_states_what_it_has():
    t = np.arange(0, 4, 0.01)
    data = jaxid.Dataset.from_arrays(
        t, {"lift_cmd": np.sin(t)}, {"lift": np.sin(t)}, units={"lift_cmd": "rad", "lift": "rad"}
    )
    bound = trusting(bind(Robot.from_mjcf("arm.xml", text=ARM), data))
    known = {bound.layout.names[i]: std for i, (_, std) in bound.priors.items()}
    assert known["com_x@upper"] == 6e-3 and known["armature@lift"] == pytest.approx(0.01)
    assert "frictionloss@lift" not in known  # nothing is no statement of how large
    counted = trusting(bind(Robot.from_mjcf("arm.xml", text=ARM), data), inflation=100.0)
    i = counted.layout.index("com_x@upper")
    assert counted.priors[i][1] == pytest.approx(6e-4)


def test_less_trust_is_a_wider_prior():
    for kind in SPREADS:
        each = [spread_of(kind, 2.0, trust) for trust in CHOICES]
        assert 0 < each[0] < each[1] < each[2], kind
        if kind != "centre of mass":
            assert spread_of(kind, 0.0, "measured") == 0.0


def test_trust_is_read_written_and_refused(tmp_path):
    jaxid.save_dataset(pendulum("loose", inertia=ParameterPrior(0.06)), tmp_path / "kept")
    again = jaxid.load_dataset(tmp_path / "kept")
    assert again.model is not None and again.model.trust == "loose"
    toml = tmp_path / "kept" / "dataset.toml"
    toml.write_text(toml.read_text().replace('"loose"', '"blind"'))
    with pytest.raises(jaxid.DatasetError, match=r"(?s)trust.*exact.*measured.*loose"):
        jaxid.load_dataset(tmp_path / "kept")


def test_an_accuracy_is_of_a_channel_or_a_dimension():
    channels = {"tau": "N m", "q": "rad", "position": "m"}
    outputs = {"q": "rad", "position": "m"}
    assert accuracy_of("1 mrad", channels, outputs) == {"q": pytest.approx(1e-3)}
    both = accuracy_of("q = 1 mrad, position = 0.1 mm", channels, outputs)
    assert both == {"q": pytest.approx(1e-3), "position": pytest.approx(1e-4)}
    assert accuracy_of("tau = 0.5 N m", channels, outputs) == {"tau": 0.5}


@pytest.mark.parametrize(
    "text, words",
    [
        ("1", "not a size"),
        ("-1 mrad", "not above 0"),
        ("1 N", "no output is in N"),
        ("x = 1 mrad", "no channel 'x'"),
        ("q = 1 mm", "another dimension"),
    ],
)
def test_what_is_no_accuracy_is_refused(text, words):
    with pytest.raises(UsageError, match=words):
        accuracy_of(text, {"q": "rad"}, {"q": "rad"})


def test_an_accuracy_counts_beside_the_noise():
    noise = {"q": Noise(3e-4, "sensor", "rad", "q 0.3 mrad")}
    dataset = Dataset("", (), accuracy={"q": 4e-4})
    asked = beside_accuracy(noise, dataset)
    assert asked["q"].std == pytest.approx(5e-4) and "not asked for" in asked["q"].text
    assert noise["q"].std == 3e-4


def test_what_is_left_within_the_accuracy_is_not_missing():
    """A pendulum with dry friction that the model lacks: 1 mrad of its motion."""
    truth = jaxid.models.Pendulum()
    t = np.arange(0, 8, 0.01)
    u = 0.5 * np.sin(2 * np.pi * 0.4 * t)
    data = jaxid.Dataset.from_arrays(
        t, {"tau": u}, {"q": u}, units={"tau": "N m", "q": "rad"}, check_model=False
    )
    values = {"inertia": 0.05, "gravity_torque": 1.5, "viscous": 0.3, "coulomb": 0.0}
    (run,) = jaxid.simulate(truth, data, {"parameters": values}).runs
    rng = np.random.default_rng(0)
    off = 1e-3 * np.sin(20 * run["q"]) + 1e-5 * rng.standard_normal(len(t))
    data = jaxid.Dataset.from_arrays(
        t,
        {"tau": u},
        {"q": run["q"] + off},
        units={"tau": "N m", "q": "rad"},
        noise_std={"q": 1e-5},
        check_model=False,
    )
    near = jaxid.diagnose(truth, data, effects=["sensor_scale"], accuracy="2 mrad")
    assert near.which.verdict == "none", near.which.text
    kept = near.to_dict()
    assert kept["accuracy"] == {"q": pytest.approx(2e-3)} and kept["trust"]["level"] == "measured"
    exact = jaxid.diagnose(truth, data, effects=["sensor_scale"])
    assert exact.which.verdict != "none" and exact.to_dict()["accuracy"] == {}
