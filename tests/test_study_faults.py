"""Every fault of a study is told at once: keys, values, datasets, and the names of models, effects
and fitters.
"""

from __future__ import annotations

import pytest

from jaxid.study import run_study
from jaxid.study.plan import StudyError
from test_batch import SOLVE, write_dataset


STUDY = """name = "x"
{store}
stoer = "b"
[[runs]]
command = "fit"
datasets = ["small", "nowhere"]
models = ["joit", "joint"]
effects = [["dead_zon"], []]
fitters = ["lmm", "de"]
sedes = 3
[[runs]]
command = {command}
datasets = ["smal"]
models = ["jiont"]
effects = [["backlsh"]]
without = ["coulom"]
seeds = 2
[[runs]]
command = "fit"
datasets = ["small"]
fitters = ["shde"]
effects = [["dead_zone@nowhere"]]
"""
FAULTS = {
    "stoer": "did you mean 'store'?",
    "runs[1].datasets": "'nowhere' is not a folder",
    "runs[1].models": "no model 'joit' (did you mean 'joint'?)",
    "runs[1].effects": "no effect 'dead_zon' (did you mean 'dead_zone'?)",
    "runs[1].fitters": "no fitter 'lmm' (did you mean 'lm'?)",
    "runs[1].sedes": "did you mean 'seeds'?",
    "runs[2].datasets": "'smal' is not a folder",
    "runs[2].models": "no model 'jiont' (did you mean 'joint'?)",
    "runs[2].effects": "no effect 'backlsh' (did you mean 'backlash'?)",
    "runs[2].without": "no effect 'coulom' (did you mean 'coulomb_friction'?)",
    "runs[3].fitters": "no fitter 'shde' (did you mean 'shade'?)",
    "runs[3].effects": "cannot act at 'nowhere'",
}


@pytest.mark.parametrize(
    "store, command, more",
    [
        ('store = "out"', '"diagnose"', {}),
        ("", '"diagnose"', {"store": "State 'store'"}),
        ('store = "out"', '"diagnos"', {"runs[2].command": "did you mean 'diagnose'?"}),
        ("store = 3", "7", {"store": "'store' is 3", "runs[2].command": "Write one of"}),
    ],
    ids=["names alone", "no store", "wrong command", "wrong types"],
)
def test_all_at_once(tmp_path, store, command, more):
    write_dataset(tmp_path / "small")
    (tmp_path / "study.toml").write_text(STUDY.format(store=store, command=command))
    with pytest.raises(StudyError) as caught:
        run_study(tmp_path / "study.toml", solver=SOLVE)
    told = {p.column: str(p) for p in caught.value.problems}
    assert told.keys() == (FAULTS | more).keys()
    assert all(text in told[key] for key, text in (FAULTS | more).items())
    rows = [p.row or 0 for p in caught.value.problems]
    assert rows == sorted(rows) and not (tmp_path / "out").exists()
