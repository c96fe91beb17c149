"""Long recordings: windows give what whole records give, memory is foreseen, files are measured
before they are read.
"""

import dataclasses
import resource

import numpy as np
import pytest

import jaxid
from jaxid.base import errors
from jaxid.cli import app as cli
from jaxid.data import capacity, signals
from jaxid.fitting.noise_model import autoregressions, RecordResidual, score_covariance
from jaxid.fitting.problem_builder import ProblemBuilder
from jaxid.identification import regression as identification_rows
from jaxid.numerics import kept as programs
from jaxid.problem.binding import bind
from jaxid.problem.objective import linearise
from jaxid.problem.problem import rows
from jaxid.problem.residual import InverseDynamics, OutputError
from jaxid.simulation import batch as engine, sample_buffers as samples, windows


def recording(count=1600, rate=500.0, **settings):
    """A pendulum that is driven, as it would be recorded."""
    rng = np.random.default_rng(3)
    t = np.arange(count) / rate
    u = 0.4 * np.sin(2 * np.pi * 0.7 * t) + 0.2 * np.sin(2 * np.pi * 1.9 * t + 1)
    q = 0.3 * np.sin(2 * np.pi * 0.7 * t + 0.2) + 1e-3 * rng.standard_normal(count)
    return jaxid.Dataset.from_arrays(
        t, {"tau": u}, {"q": q}, model="pendulum", noise_std={"q": 1e-3}, **settings
    )


def expansions(data, effects=()):
    """What descents and their ends take from the runs of a dataset."""
    b = bind(None, data, effects=effects)
    found = {}
    for differences in (1,) if effects else (0, 1):
        bench = ProblemBuilder(b, differences=differences)
        for split in ("fit", "validation"):
            p = bench.problem(OutputError(), split, b.free, b.theta)
            z = p.z(b.theta)
            for share in (1.0, 0.4):
                at = linearise([(p, z), (p, p.precise().z(1.01 * b.theta))], share)
                found[differences, split, share] = np.array(
                    [[a.cost, *a.gradient, *a.hessian.ravel()] for a in at]
                )
            whole = list(rows([(p, z)]))
            found[differences, split, "rows"] = np.concatenate(
                [np.c_[w.r.ravel(), w.J.reshape(w.r.size, -1)] for w in whole]
            )
            found[differences, split, "loss"] = p.losses(np.array([z, 1.001 * z]))
            found[differences, split, "predictions"] = np.concatenate(p.predictions(z))
    p = ProblemBuilder(b).problem(InverseDynamics(decimate=1), "fit", b.free, b.theta)
    found["torque"] = linearise([(p, p.z(b.theta))])[0].hessian
    return found, p.runs.engine.long


@pytest.mark.parametrize("effects", [(), ("actuator_lag",)])
def test_windows_give_what_whole_records_give(monkeypatch, effects):
    data = recording()
    whole, long = expansions(data, effects)
    assert not long
    monkeypatch.setattr(engine, "LONG", 100)
    monkeypatch.setattr("jaxid.problem.long_records.WINDOW", 256)
    monkeypatch.setattr(windows, "WINDOW", 256)
    monkeypatch.setattr(programs, "_KEPT", type(programs._KEPT)())
    parts, long = expansions(data, effects)
    assert long
    for key, value in whole.items():
        assert np.allclose(value, parts[key], rtol=1e-10, atol=1e-10 * np.max(np.abs(value))), key


def test_problems_share_the_measurements_without_what_finer_steps_add():
    """A diagnosis makes thousands of problems: one array each would be a gigabyte."""
    bench, residual = ProblemBuilder(bind(None, recording())), OutputError()

    def made():
        return bench.problem(residual, "fit", bench.binding.free, bench.binding.theta)

    recorded = made().targets
    for off in (1e-3, 2e-3):
        bench.take_off(residual, "fit", np.full_like(recorded, off))
        first, second = made(), made()
        assert first.targets is second.targets
        np.testing.assert_array_equal(first.targets, recorded - off)


def test_a_long_series_is_transformed_in_the_same_way(monkeypatch):
    rng = np.random.default_rng(0)
    r = np.convolve(rng.standard_normal(900), np.ones(5), "same")[:, None]
    J = rng.standard_normal((900, 1, 3))
    inverse = np.linalg.inv(J[:, 0].T @ J[:, 0])
    either = []
    for long in (1 << 17, 100):
        monkeypatch.setattr("jaxid.fitting.noise_model.LONG", long)
        noise = autoregressions([RecordResidual(r, J)], inverse)
        either.append(score_covariance([RecordResidual(r, J)], noise))
    assert np.allclose(*either, rtol=1e-9)


@pytest.mark.parametrize("jitter", [0.0, 0.3])
def test_filtering_by_stretches(jitter):
    """Each stretch knows enough of its neighbourhood; where samples are irregular splines are
    local, too.
    """
    rng = np.random.default_rng(1)
    t = (np.arange(30_000) + jitter * rng.uniform(-0.5, 0.5, 30_000)) / 500
    x = rng.standard_normal((len(t), 2, 3)) + t[:, None, None]
    whole = signals.zero_phase(t, x.reshape(len(t), -1), 20.0).reshape(x.shape)
    parts = list(signals.zero_phase_stretches(t, x.__getitem__, 20.0, stretch=5000))
    assert len(parts) == 6 and [p[0].start for p in parts] == list(range(0, 30_000, 5000))
    together = np.concatenate([smooth for _, smooth, _ in parts])
    assert np.abs(together - whole).max() < 1e-9 * np.abs(whole).max()
    assert np.array_equal(np.concatenate([raw for *_, raw in parts]), x)


def arm(count=3000):
    rng = np.random.default_rng(0)
    t = np.arange(count) / 250
    q = np.stack(
        [
            0.6 * np.sin((0.9 + 0.4 * j) * t + j) + 0.3 * np.sin(2.3 * t * (1 + 0.1 * j))
            for j in range(6)
        ],
        1,
    )
    tau = (
        3 * np.sin(q)
        + np.tanh(np.gradient(q, t, axis=0) / 0.01)
        + 0.05 * rng.standard_normal(q.shape)
    )

    def name(x, s):
        return {f"{s}{j + 1}": x[:, j] for j in range(6)}

    return jaxid.Dataset.from_arrays(t, name(tau, "tau"), name(q, "q"), model="ur10")


@pytest.mark.slow
@pytest.mark.parametrize("method", ["wls", "tls", "rls"])
def test_identification_by_stretches(monkeypatch, method):
    data, found = arm(), []
    for stretch in (1 << 15, 1000):
        monkeypatch.setattr(signals, "STRETCH", stretch)
        monkeypatch.setattr(identification_rows, "STRETCH", stretch)
        monkeypatch.setattr(signals.zero_phase_stretches, "__defaults__", (stretch, signals.ORDER))
        found.append(jaxid.identify(None, data, method=method, friction="linear", cutoff_hz=20.0))
    a, b = found
    assert np.allclose(a.theta, b.theta, rtol=1e-6, atol=1e-6 * np.abs(a.theta).max())
    assert np.allclose(a.std(), b.std(), rtol=1e-6, equal_nan=True)
    for one, other in zip(a.experiments, b.experiments, strict=True):
        assert one.relative_error == pytest.approx(other.relative_error, rel=1e-6)
        assert one.unfiltered_relative_error == pytest.approx(
            other.unfiltered_relative_error, rel=1e-6
        )


def test_what_does_not_fit_is_refused_before_anything_is_computed(monkeypatch):
    data = recording()
    monkeypatch.setattr(capacity, "available", lambda: (0.5e9, "limit of a test"))
    for work in (lambda: jaxid.fit(None, data), lambda: jaxid.diagnose(None, data)):
        with pytest.raises(
            jaxid.UsageError,
            match=r"1,600 rows in 1 run: about 0\.7 GB.* only 0\.5 GB .*limit of a test",
        ):
            work()


def test_a_diagnosis_of_too_much_looks_at_the_first_part_and_says_so(monkeypatch):
    data = recording(40_000)
    wanted = capacity.need("diagnose", data, 1, 30)
    assert capacity.shortened(data, wanted) is data
    monkeypatch.setattr(capacity, "LONGEST_S", wanted.seconds / 4)
    less = capacity.shortened(data, wanted)
    assert [e.split for e in less.experiments] == ["fit", "validation", "report"]
    assert (
        0.2 * len(data.experiments[0])
        < sum(len(e) for e in less.experiments)
        < 0.3 * len(data.experiments[0])
    )
    assert "The first part of each run is looked at" in less.notes[-1] and "25 %" in less.notes[-1]


def test_the_estimate_grows_with_what_there_is():
    small, large = recording(1600), recording(16_000)
    assert capacity.need("fit", small, 1).bytes < capacity.need("fit", large, 1).bytes
    few, many = (capacity.need("diagnose", large, 1, n).seconds for n in (2, 10))
    assert capacity.START_S < few < many
    told = dataclasses.replace(capacity.need("diagnose", large, 1, 10), bytes=3.2e9, seconds=1200.0)
    assert (
        told.large and str(told) == "diagnose of 16,000 rows in 1 run: about 3.2 GB and 20 minutes"
    )
    fit = dataclasses.replace(capacity.need("fit", large, 1), bytes=1e9)
    assert not fit.large and str(fit) == "fit of 16,000 rows in 1 run: about 1.0 GB", (
        "how far a fit has to go is not known"
    )


def test_an_estimate_is_of_the_way_that_is_gone():
    """Along the measured motion nothing is simulated, and a short recording takes what starts."""
    rows = {1600: recording(1600), 16_000: recording(16_000)}
    ways = {
        way: [capacity.need("diagnose", data, 1, 30, way).seconds for data in rows.values()]
        for way in ("motion", "goals", "free runs")
    }
    assert ways["motion"][1] < ways["goals"][1] < ways["free runs"][1]
    for short, long in ways.values():
        more = (long - capacity.START_S) / (short - capacity.START_S)
        assert more == pytest.approx(10.0, rel=0.02)
        assert short < 2 * capacity.START_S


def test_a_limit_of_the_address_space_counts(monkeypatch):
    monkeypatch.setattr(resource, "getrlimit", lambda _: (1 << 20, 1 << 20))
    assert capacity.available() == (0.0, "limit of its address space, ulimit -v")


def test_samples_that_are_seconds_apart_are_refused():
    t = 5.0 * np.arange(2000)
    with pytest.raises(jaxid.DatasetError, match=r"step of 5 s: is t in ms\?"):
        jaxid.Dataset.from_arrays(t, {"tau": np.sin(t)}, {"q": np.cos(t)}, model="pendulum")
    data = recording(2000)
    data = dataclasses.replace(
        data,
        experiments=tuple(
            dataclasses.replace(e, t=5.0 * np.arange(len(e.t))) for e in data.experiments
        ),
    )
    with pytest.raises(jaxid.UsageError, match=r"step 5 s: is t in ms\?"):
        jaxid.fit(None, data)
    samples.refuse_endless(data.experiments, 1.0)  # of a step of 1 s five from one to the next


@pytest.mark.parametrize("kind", ["parquet", "csv"])
def test_a_file_is_measured_before_it_is_read(tmp_path, monkeypatch, kind):
    jaxid.save_dataset(recording(), tmp_path / "data", format=kind)
    monkeypatch.setattr(capacity, "available", lambda: (1e3, "limit of a test"))
    what = r"1,600 rows of 3 columns" if kind == "parquet" else r"MB of text"
    with pytest.raises(
        jaxid.DatasetError, match=rf"{what} take about .* GB to read, and 0\.0 GB are free"
    ):
        jaxid.load_dataset(tmp_path / "data")


def test_parameters_have_a_largest_size(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr("jaxid.base.small_files.LARGEST_BYTES", 1000)
    (tmp_path / "fit.json").write_text(" " * 1001)
    words = [
        "simulate",
        "nowhere",
        "--parameters",
        str(tmp_path / "fit.json"),
        "--out",
        str(tmp_path / "o"),
    ]
    assert cli.main(words) == errors.BAD_INPUT
    assert "larger than" in capsys.readouterr().err
