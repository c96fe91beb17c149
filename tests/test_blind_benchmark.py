"""The public benchmark: cases remade to the byte, scored as the rules say, entered by a stranger."""

from __future__ import annotations

import ast
import hashlib
import json
import os
import shutil
import subprocess
import sys
import warnings
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

import jaxid
from benchmarks import public
from jaxid.base.errors import DatasetWarning, UsageError
from jaxid.benchmark import (
    arm_sets,
    case,
    goal_arms,
    make as making,
    paper_sets,
    rig_sets,
    score as scoring,
    withheld,
)
from jaxid.benchmark.answers import CaseAnswer, read_entry
from jaxid.benchmark.intervals import mean_interval
from jaxid.cli.app import main
from jaxid.dynamics import catalogue
from jaxid.study.papers.twins import space_arm


ROOT = Path(__file__).parents[1]
#: Sets that take no long integration, and cases of each here.
QUICK = {"arms": 2, "conventions": 4, "robots": 1}


def digests(folder: Path) -> dict[str, str]:
    return {
        str(p.relative_to(folder)): hashlib.sha256(p.read_bytes()).hexdigest()
        for p in sorted(folder.rglob("*"))
        if p.is_file()
    }


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("benchmark")
    for name, count in QUICK.items():
        making.make(name, 5, folder / name, count, workers=1)
    return {name: folder / name for name in QUICK}


def truths(folder: Path) -> dict[str, Any]:
    return json.loads((folder / "key.json").read_text())["cases"]


def perfect(truth: dict[str, Any]) -> dict[str, Any]:
    """The answer of one who has read the key."""
    names = {f"{one['effect']}@{one['joint']}": one for one in truth["missing"]}
    out: dict[str, Any] = {"missing": dict.fromkeys(names, 1.0), "seconds": 1.0}
    out["nothing"] = float(not names and not truth["outside"])
    out["other"] = float(bool(truth["outside"]))
    out["where"] = dict.fromkeys(truth["over"][:1], 1.0)
    out["size"] = {n: one["size"] for n, one in names.items() if one["size"] is not None}
    if truth["exam"]:
        out["exam"], out["how_far"] = truth["exam"]["truth"], [0.9, 1.0]
    return out


def entered(path: Path, answers: dict[str, Any]) -> Path:
    path.write_text(json.dumps({"entry": "test", "answers": answers}))
    return path


@pytest.mark.parametrize("name", QUICK)
def test_cases_are_remade_to_the_byte(made, tmp_path, name):
    """By another number of processes, too; another seed makes others."""
    making.make(name, 5, tmp_path / "again", QUICK[name], workers=2)
    assert digests(tmp_path / "again") == digests(made[name])
    making.make(name, 6, tmp_path / "other", QUICK[name], workers=1)
    assert digests(tmp_path / "other") != digests(made[name])


def test_many_more_groups_than_processes_come_to_an_end(monkeypatch, tmp_path):
    """Processes end after some groups, and others take their place."""
    monkeypatch.setattr(making, "GROUPS_PER_PROCESS", 1)
    alone = making.make("conventions", 5, tmp_path / "alone", 8, workers=1)
    made = making.make("conventions", 5, tmp_path / "made", 8, workers=2)
    groups = {d.group for d in making.KNOWN["conventions"].drafts("conventions", 5, range(100))}
    assert len(groups) == 4 and made.key_sha256 == alone.key_sha256


@pytest.mark.parametrize("simulator, number", [("mujoco", 1), ("numpy", 7)])
def test_rigs_are_remade_to_the_byte(monkeypatch, tmp_path, simulator, number):
    monkeypatch.setitem(withheld.SECONDS, "pendulum", 0.4)
    monkeypatch.setattr(rig_sets, "EXAM_S", 0.4)
    found = []
    for folder in (tmp_path / "a", tmp_path / "b"):
        drafts = rig_sets.drafts("poor", 11, [number])
        found.append(making._written(drafts, {("poor", number): "0001"}, folder, 1))
    assert digests(tmp_path / "a") == digests(tmp_path / "b") and found[0] == found[1]
    assert found[0]["0001"]["simulator"] == simulator
    data = jaxid.load_dataset(tmp_path / "a" / "0001")
    assert data.model is not None and data.model.name == "pendulum"
    assert (tmp_path / "a" / "0001" / "model.xml").is_file()


def test_inputs_that_stand_still_are_meant(monkeypatch, tmp_path):
    """Steps at one joint at a time warn of nothing on the terminal of who makes the cases."""
    monkeypatch.setitem(rig_sets.SHORT, "planar_arm", 0.2)
    monkeypatch.setattr(rig_sets, "EXAM_S", 0.1)
    drafts = rig_sets.drafts("poor", 11, [4])
    with pytest.warns(DatasetWarning, match="excites nothing"):
        drafts[0].simulate(drafts)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        making._write_group(drafts, ["0001"], tmp_path)
    assert (tmp_path / "0001" / "run_1.csv").is_file()


def test_the_published_folder_does_not_tell_the_key(made):
    for name, folder in made.items():
        text = "".join(p.read_text() for p in (folder / "cases").rglob("*.json"))
        about = json.loads((folder / "cases" / "benchmark.json").read_text())
        digest = hashlib.sha256((folder / "key.json").read_bytes()).hexdigest()
        assert about["key_sha256"] == digest, name
        for word in ("seed", "outside", "alike", "truth", "number"):
            assert f'"{word}"' not in text, (name, word)


def test_a_file_of_the_model_is_read_by_the_product(made):
    """Robots by their MJCF, which stands beside the recording."""
    for name in ("arms", "robots"):
        folder = made[name] / "cases" / "0001"
        data = jaxid.load_dataset(folder)
        question = json.loads((folder / "case.json").read_text())
        assert set(question["joints"]) <= {c.name for c in data.outputs}


@pytest.mark.parametrize("name", QUICK)
def test_who_knows_the_key_has_all(made, tmp_path, name):
    key = truths(made[name])
    path = entered(tmp_path / "answers.json", {k: perfect(t) for k, t in key.items()})
    found = scoring.score(made[name], path).overall
    for measure in ("class", "place", "size", "where", "how_far", "how_far_held"):
        if found[measure] is not None:
            assert found[measure]["value"] == 1.0, measure
    assert found["brier"]["value"] == 0.0 and found["calibration_error"] == 0.0
    assert found["sure_and_wrong"] is None or found["sure_and_wrong"]["value"] == 0.0


def test_saying_nothing_earns_nothing(made, tmp_path):
    found = scoring.score(made["arms"], entered(tmp_path / "a.json", {})).overall
    assert found["class"]["value"] == 0.0 and found["brier"]["value"] == 1.0
    assert found["how_far"]["value"] == 0.0 and found["sure"] == 0


MISSING = [{"effect": "input_delay", "joint": "q", "size": 0.01, "alike": ["sensor_delay@q"]}]
TRUTH: dict[str, Any] = {
    "set": "rigs",
    "missing": MISSING,
    "outside": "",
    "over": ["command"],
    "joints": ["q"],
    "exam": {"truth": {"q": [1.0, 1.0]}, "stated": {"q": [1.5, 0.5]}, "noise": {"q": 0.1}},
}


def test_what_no_recording_tells_apart_counts_as_the_same():
    told = CaseAnswer(missing={"sensor_delay@q": 0.6, "input_delay@q": 0.3}, nothing=0.1)
    found = scoring.marks_of(TRUTH, told, ["input_delay"])
    assert found.right and found.brier == pytest.approx(0.1**2 + 0.1**2)
    wrong = CaseAnswer(missing={"dead_zone@q": 0.96}, nothing=0.04)
    marks = scoring.marks_of(TRUTH, wrong, ["input_delay"])
    assert not marks.right and marks.claims == (False,)
    assert marks.brier == pytest.approx(0.96**2 + 0.04**2 + 1.0)


def test_a_tie_is_no_answer():
    tied = CaseAnswer(missing={"input_delay@q": 0.5, "dead_zone@q": 0.5})
    assert not scoring.marks_of(TRUTH, tied, []).right


@pytest.mark.parametrize("error, expected", [(0.0, 1.0), (0.3, 1 - 8 / 24), (0.5, 0.0), (5, -1.0)])
def test_how_far_is_the_share_of_the_gap_beyond_the_noise(error, expected):
    told = CaseAnswer(exam={"q": [1.0 + error, 1.0 - error]})
    assert scoring.how_far(TRUTH["exam"], told) == pytest.approx(expected)


def test_calibration_error_is_that_of_the_bins():
    said = [(0.75, True), (0.75, False), (0.25, False), (0.0, True)]
    expected = (2 * abs(0.75 - 0.5) + abs(0.25 - 0.0)) / 3
    assert scoring.calibration_error(said) == pytest.approx(expected)


@pytest.mark.parametrize(
    "answer, words",
    [
        ({"missing": {"coulomb_friction@j1": 1.5}}, ["'missing'", "1.5 is not a probability"]),
        ({"missing": {"coulom_friction@j1": 0.5}}, ["'missing'", "coulomb_friction"]),
        ({"missing": {"coulomb_friction@j99": 0.5}}, ["'missing'", "joint after @"]),
        ({"nothing": "no"}, ["'nothing'", "'no' is not a probability"]),
        ({"where": {"weather": 0.5}}, ["'where'", "position, speed"]),
        ({"exam": {"j1_tau": [0.0]}}, ["'exam'", "list of 40 numbers"]),
        ({"how_far": [1.0, 0.0]}, ["'how_far'", "[low, high]"]),
        ({"mising": {}}, ["'mising'", "missing"]),
        ([], ["not an object"]),
    ],
)
def test_bad_answers_exit_2_and_name_case_and_key(made, tmp_path, capsys, answer, words):
    path = entered(tmp_path / "answers.json", {"0001": answer})
    assert main(["benchmark", "score", str(made["arms"]), str(path)]) == 2
    said = capsys.readouterr().err
    assert all(word in said for word in ("'0001'", *words)), said
    assert not (tmp_path / "score.json").exists()


def test_an_unknown_case_and_another_key_are_refused(made, tmp_path):
    path = entered(tmp_path / "answers.json", {"9999": {}})
    with pytest.raises(UsageError, match="9999"):
        scoring.score(made["arms"], path)
    with pytest.raises(UsageError, match="no set is called"):
        making.make("rig", 1, tmp_path / "x")
    with pytest.raises(UsageError, match="JSON"):
        (tmp_path / "bad.json").write_text("{")
        read_entry(tmp_path / "bad.json", {})
    other = tmp_path / "other"
    making.make("arms", 7, other, 1, workers=1)
    (other / "key.json").write_text((made["arms"] / "key.json").read_text())
    with pytest.raises(UsageError, match="hash"):
        scoring.score(other, entered(tmp_path / "a.json", {}))


def imported(script: str) -> set[str]:
    """The packages that a script imports anywhere."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(script)):
        if isinstance(node, ast.Import):
            names |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            names.add((node.module or "").partition(".")[0])
    return names


def test_a_stranger_needs_numpy_alone_and_the_page():
    """Every key that it reads or writes stands on the page of rules."""
    script = (ROOT / "tests" / "stranger.py").read_text()
    page = (ROOT / "docs" / "benchmark.md").read_text()
    assert imported(script) - set(sys.stdlib_module_names) == {"numpy"}
    strings = [n.value for n in ast.walk(ast.parse(script)) if isinstance(n, ast.Constant)]
    keys = {s for s in strings if isinstance(s, str) and s.isidentifier()}
    assert {"joints", "exam", "rows", "outputs", "missing", "nothing", "other", "where"} <= keys
    unknown = {key for key in keys if key not in page and key != "__main__"}
    assert not unknown


def test_a_stranger_enters_by_the_rules_alone(made, tmp_path):
    """From a folder that holds what is published alone, where jaxid cannot be imported."""
    path = tmp_path / "answers.json"
    (tmp_path / "blocked" / "jaxid").mkdir(parents=True)
    (tmp_path / "blocked" / "jaxid" / "__init__.py").write_text("raise ImportError('not here')")
    environment = {**os.environ, "PYTHONPATH": str(tmp_path / "blocked")}
    for name, folder in made.items():
        published = tmp_path / name
        shutil.copytree(folder / "cases", published)
        command = [sys.executable, str(ROOT / "tests" / "stranger.py"), str(published), str(path)]
        subprocess.run(command, cwd=tmp_path, check=True, timeout=300, env=environment)
        assert main(["benchmark", "score", str(folder), str(path), "--json"]) == 0
        found = json.loads((tmp_path / "score.json").read_text())
        assert found["entry"] == "a stranger" and found["answered"] == QUICK[name]


def test_the_page_tells_every_set_and_how_many_cases():
    page = (ROOT / "docs" / "benchmark.md").read_text()
    told: dict[str, int] = {}
    for line in page.splitlines():
        cells = [cell.strip() for cell in line.split("|")]
        if line.startswith("| `"):
            names = cells[1].replace("`", "").split(", ")
            told |= dict(zip(names, map(int, cells[2].split(", ")), strict=True))
    assert told == {name: own.cases for name, own in making.SETS.items()}


@pytest.mark.parametrize("rig", paper_sets.ARMS)
def test_arms_of_the_papers_are_what_their_file_says(rig):
    """Against MuJoCo's inverse dynamics of the published file, which knows damping but no sign of
    the speed.
    """
    arm, rng = paper_sets.ARMS[rig](), np.random.default_rng(0)
    mj: Any = mujoco
    model = mj.MjModel.from_xml_string(arm.xml())
    data = mj.MjData(model)
    for _ in range(20):
        state = rng.normal(size=(3, len(arm.bodies)))
        data.qpos[:], data.qvel[:], data.qacc[:] = state
        mj.mj_inverse(model, data)
        q, qd, qdd = state[:, None]
        own = arm.torque((q, qd, qdd))[0]
        friction = arm.viscous * qd[0] + arm.dry * np.sign(qd[0])
        known = data.qfrc_inverse + data.qfrc_passive + data.qfrc_constraint
        assert np.allclose(own - friction, known, atol=1e-6 * np.abs(own).max())
        assert np.allclose(model.dof_frictionloss, arm.dry)
        assert np.allclose(model.dof_damping, arm.viscous)


def test_the_space_manipulator_is_that_of_its_paper():
    t, q, qd, qdd = space_arm.path(1)
    arm = paper_sets.space_manipulator()
    own = arm.torque((q, qd, qdd)) - arm.drives * qdd - arm.viscous * qd - arm.dry * np.sign(qd)
    theirs = space_arm.torque((t, q, qd, qdd), friction=None)
    assert np.allclose(own, theirs, atol=1e-9 * np.abs(theirs).max())


def test_sets_of_the_papers_hold_each_rig_and_stand_beside_all(tmp_path):
    drafts = paper_sets.drafts("papers", 3, range(8))
    groups = [draft.group for draft in drafts]
    for rig in paper_sets.RIGS:
        assert sum(group.endswith(rig) for group in groups) == 2
    assert "papers" not in making.SETS and "papers" in making.KNOWN
    (case_,) = drafts[2].simulate(drafts[2:3])
    assert case_.question["robot"] == "model.xml" and len(case_.question["joints"]) == 6


@pytest.mark.parametrize("number", [0, 3])
def test_a_floor_that_is_withheld_shows_in_the_recording(number):
    """Of the first of these cases the floor that was drawn is never touched."""
    draft = arm_sets.goal_drafts("contact", 1, [number])[0]
    (case_,) = draft.simulate([draft])
    assert case_.outside == "a floor that the file has not"
    mj: Any = mujoco
    model = mj.MjModel.from_xml_string(case_.files["model.xml"])
    data, run = mj.MjData(model), case_.dataset.experiments[0]
    per = round((run.t[1] - run.t[0]) / model.opt.timestep)
    most = 0.0
    for u, y in zip(run.u, run.y, strict=True):
        most = max(most, float(np.abs(y - data.qpos).max()))
        data.ctrl[:] = u
        for _ in range(per):
            mj.mj_step(model, data)
    assert most > 0.8 * arm_sets.SEEN * goal_arms.NOISE


def test_sealed_sets_are_entered_together(tmp_path):
    """Three seeds that nobody chose; the hashes are published, the seeds are not."""
    kept = tmp_path / "sealed.json"
    hashes = public.seal(tmp_path / "sets", "arms", 1, kept)
    assert len(set(hashes)) == 3
    text = kept.read_text()
    folders = [tmp_path / "sets" / str(k) for k in (1, 2, 3)]
    for folder, digest in zip(folders, hashes, strict=True):
        key = json.loads((folder / "key.json").read_text())
        assert digest in text and str(key["seed"]) not in text
        answers = {name: perfect(truth) for name, truth in key["cases"].items()}
        (folder / "answers").mkdir()
        entered(folder / "answers" / "test.json", answers)
    board = tmp_path / "board"
    public.enter(folders, "test", "reads the key", "1", board)
    (row,) = public.rows(board)
    assert row["cases"] == "3 of 3" and row["class"].startswith("1.00 (")
    assert all(digest[:8] in row["key"] for digest in hashes)
    assert f"| {hashes[0][:8]} | arms | 1.00 of 3 |" in public.page(board)
    with pytest.raises(UsageError, match="hash"):
        (folders[0] / "key.json").write_text((folders[1] / "key.json").read_text())
        public.enter(folders, "test", "", "1", board)


def test_every_effect_that_may_be_withheld_has_its_words():
    words = set(case.DEPENDS_ON)
    assert words <= set(catalogue.effect_names())
    for groups in rig_sets.ALIKE.values():
        assert words >= set(np.concatenate([np.array(g) for g in groups]))
    for model in rig_sets.MODELS:
        plant, chain = rig_sets.PLANTS[model], rig_sets.chain_of(model)
        assert set(rig_sets.names_of(plant, chain)) <= words
    assert set(rig_sets.NUMBERS) <= set(case.SIZES) <= words
    assert sum(one.cases for one in making.SETS.values()) == 1200
    assert making.SETS["outsiders"].cases == 300


def test_one_case_is_no_certainty():
    """Nor are several that are alike; intervals close as cases come and stay within bounds."""
    widths = []
    for count in (1, 4, 24, 400):
        found = mean_interval([0.0] * count, least=-1.0, most=1.0)
        assert found is not None and found["count"] == count
        low, high = found["interval_95"]
        assert -1.0 <= low < 0.0 < high <= 1.0
        widths.append(high - low)
    assert widths[0] == 2.0 and widths == sorted(widths, reverse=True) and widths[-1] < 0.01
    assert mean_interval([]) is None


def test_intervals_of_means_hold_the_mean():
    """Of 2,000 samples of five values that are spread evenly over 0 to 2."""
    rng = np.random.default_rng(0)
    held = 0
    for _ in range(2000):
        found = mean_interval(rng.uniform(0.0, 2.0, 5).tolist(), least=0.0)
        assert found is not None
        held += found["interval_95"][0] <= 1.0 <= found["interval_95"][1]
    assert 0.93 <= held / 2000 <= 0.99
