"""Recordings of others' robots, each as its README asks; skipped where they are not at hand."""

import os
import shutil
from pathlib import Path

import numpy as np
import pytest

import jaxid
from jaxid import UsageError
from jaxid.cli.app import main
from jaxid.diagnosis.equivalence import equivalences
from jaxid.robots.match import robot_from
from jaxid.robots.urdf_tree import read_urdf_tree


DATA = Path(os.environ.get("JAXID_DATA", "../shared/data"))
CASES = DATA.parent / "cases"


def case(name):
    if not (CASES / name).is_dir():
        pytest.skip(f"{CASES / name} is not here")
    return CASES / name


@pytest.mark.slow
def test_the_torque_of_an_arm_under_a_law_is_the_laws():
    data = jaxid.load_dataset(case("robot_03_pd_arm_without_torque_refused") / "ds")
    found = jaxid.identify(None, data)
    assert next(e for e in found.experiments if e.split == "validation").relative_error < 0.02
    value, std = found.theta[found.names.index("mx3")], found.std()[found.names.index("mx3")]
    assert abs(value - 0.18) < 3 * std < 0.01  # the true link of 1.5 kg; the file has 1.0
    assert any(n.startswith("link 3 carries 5") and "more first moment" in n for n in found.answers)


def test_the_file_is_the_yardstick():
    found = jaxid.identify(
        None, jaxid.load_dataset(case("robot_09_nominal_urdf_not_compared") / "ds")
    ).to_dict()
    rows = {r["parameter"]: r for r in found["stated"]}
    assert abs(rows["mx3"]["stated"] - 0.12) < 1e-9 and abs(rows["mx2"]["stated"] - 0.6) < 1e-9
    assert rows["mx3"]["deviation"] > 5 and rows["mx3"]["joint"] == "q3"
    for row in found["how_far"]["per_joint"]:
        assert row["as_it_stands"] > 3 * row["retuned"]
    assert found["notes"][1].startswith("link 3 carries 5") and "97 % at pan" in found["notes"][
        2
    ].replace("97.4", "97")


def test_what_the_file_has_wrong_stands_first_on_the_page_of_an_identification_and_beside_each_number(
    tmp_path,
):
    found = jaxid.identify(
        None, jaxid.load_dataset(case("robot_09_nominal_urdf_not_compared") / "ds")
    )
    page = found.report(tmp_path / "report.html").read_text()
    assert page.index("Link 3 carries 5") < page.index("Torque, measured against predicted")
    row = page[page.index("<code>mx3</code>") :].split("</tr>")[0]
    apart = next(r for r in found.stated if r["parameter"] == "mx3")["deviation"]
    assert "0.1200" in row and f"{apart:+.1f}" in row
    assert f"{apart:+.1f}" in repr(found)


def test_an_mjcf_is_read_from_the_dataset_and_from_the_command_line():
    folder = case("robot_04_mjcf_refused")
    data = jaxid.load_dataset(folder)
    assert [c.name for c in data.outputs] == ["lift", "elbow"] and "q1 = lift" in " ".join(
        data.notes
    )
    tree = robot_from(str(folder / "arm2.xml")).tree.tree
    assert tree.actuators["lift"].kp == 20 and np.allclose(tree.frictionloss, 0.05)


@pytest.mark.slow
def test_a_robot_that_goals_drive_lacks_nothing_but_friction_that_its_file_understates():
    folder = case("robot_04_mjcf_refused")
    found = jaxid.diagnose(str(folder / "arm2.xml"), jaxid.load_dataset(folder))
    assert not found.which.effects
    stated = {(r.parameter, r.joint): r for r in found.nominal.stated}
    for joint in ("lift", "elbow"):  # both were doubled
        row = stated["frictionloss", joint]
        assert row.stated == 0.05 and abs(row.fitted - 0.1) < 0.003 and (row.deviation or 0) > 3
        for right in ("armature", "damping", "kp", "kd"):
            row = stated[right, joint]
            assert abs(row.fitted - row.stated) < 0.02 * row.stated
    # The readings have no noise, and every fifth goal was logged of one that moved on in between.
    assert found.how_far.gap_retuned < 0.1 * found.how_far.gap_before
    assert "along straight lines" in " ".join(found.notes)


@pytest.mark.slow
def test_what_the_numbers_of_a_robot_take_up_under_its_law():
    """Back-EMF is viscous friction; a delay, a gain or a torque that ends is nothing that the file
    has a number for.
    """
    found = equivalences(str(case("robot_04_mjcf_refused") / "arm2.xml"))
    taken = {(p.effect, p.location) for p in found.absorbed}
    assert {("back_emf", "lift_tau"), ("back_emf", "elbow_tau")} <= taken
    assert not {e for e, _ in taken} & {
        "input_delay",
        "stribeck_friction",
        "torque_scale",
        "saturation",
    }
    assert "joint_elasticity" in found.excitation  # not compared, and said so


@pytest.mark.slow
def test_joints_of_the_recording_in_another_order_go_by_name(tmp_path):
    folder = case("robot_10_joint_names_ignored")
    rows = np.genfromtxt(CASES / "run_1.csv", delimiter=",", names=True)
    order = {"q1": "q3", "q2": "q2", "q3": "q1"}  # elbow, lift, pan: as a bag has them
    columns = {"t": rows["t"]} | {new: rows[old] for new, old in order.items()}
    columns |= {f"tau{k[1]}": rows[f"tau{old[1]}"] for k, old in order.items()}
    np.savetxt(
        tmp_path / "run.csv",
        np.column_stack(list(columns.values())),
        delimiter=",",
        header=",".join(columns),
        comments="",
    )
    shutil.copy(folder / "arm3.urdf", tmp_path)
    channels = [
        f'[channels.q{k}]\nrole = "output"\nunit = "rad"\n[channels.tau{k}]\nrole = "input"\nunit = "N m"'
        for k in (1, 2, 3)
    ]
    joints = '[model]\nrobot = "arm3.urdf"\n[model.joints]\nq1 = "elbow"\nq2 = "lift"\nq3 = "pan"'
    text = ['name = "bag"', joints, *channels, '[[experiments]]\nfile = "run.csv"']
    (tmp_path / "dataset.toml").write_text("\n".join(text))
    found = jaxid.identify(None, jaxid.load_dataset(tmp_path))
    assert abs(found.theta[found.names.index("mx3")] - 0.18) < 0.02
    assert any("1 pan, 2 lift, 3 elbow" in n for n in found.notes)


def test_an_end_is_named_where_a_robot_branches(tmp_path, capsys):
    folder = case("robot_11_branching_urdf_no_tip_option")
    assert read_urdf_tree(folder / "tree.urdf").limbs() == (("left",), ("right",))
    with pytest.raises(UsageError, match="la, lb"):
        robot_from(str(folder / "tree.urdf"), "lc")
    assert robot_from(str(folder / "tree.urdf"), "lb").signatures[0].joints == ("right",)
    data = case("robot_09_nominal_urdf_not_compared") / "ds"
    assert (
        main(["identify", str(data), "--model", str(folder / "tree.urdf"), "--out", str(tmp_path)])
        == 2
    )
    assert "left, right" in capsys.readouterr().err
    assert main(["identify", str(data), "--tip", "lb", "--out", str(tmp_path)]) == 2
    assert "--model" in capsys.readouterr().err


def test_inertias_that_no_body_can_have_are_named():
    path = DATA / "kinova_gen3" / "gen3.urdf"
    if not path.is_file():
        pytest.skip(f"{path} is not here")
    tree = read_urdf_tree(path)
    assert len(tree.joints) == 7 and len(tree.impossible) == 3
    assert all("link '" in text and "kg m^2" in text for _, text in tree.impossible)


@pytest.mark.slow
def test_a_short_run_of_an_arm_under_position_control_is_compared_by_torque_and_said_to_determine_nothing():
    found = jaxid.diagnose(None, jaxid.load_dataset(case("robot_08_arm_free_run_diverges")))
    assert found.residual == "inverse_dynamics" and "the free run diverges" in found.notes[-1]
    assert found.which.verdict == "unknown" and not found.which.effects and not found.where
    assert "worse than no model on data that were not fitted" in " ".join(repr(found).split())
