"""The table of the menagerie's robots, on a folder of our own and on a checkout where one is at hand
($JAXID_MENAGERIE).
"""

import os
from pathlib import Path

import pytest

from benchmarks import menagerie
from jaxid import UsageError
from jaxid.robots.mjcf import read_mjcf


LINK = '<inertial pos="0.05 0 0.02" mass="0.4" diaginertia="8e-4 9e-4 7e-4"/>'
ARM = f"""<mujoco><worldbody><body name="a" gravcomp="0.5"><joint name="lift" axis="0 1 0"/>{LINK}
<body name="l" pos="0 0 0.2"><joint name="left" axis="1 0 0"/>{LINK}</body>
<body name="r" pos="0 0 0.1"><joint name="right" axis="1 0 0" range="-20 20"/>{LINK}</body>
<body name="k" pos="0 0 0.1"><joint name="knuckle" axis="0 1 0"/>{LINK}</body></body></worldbody>
<equality><joint joint1="right" joint2="left" polycoef="0.1 -1 0 0 0"/></equality>
<tendon><fixed name="t" stiffness="3"><joint joint="knuckle" coef="1"/></fixed></tendon></mujoco>"""
DRONE = f"<mujoco><worldbody><body><freejoint/>{LINK}</body></worldbody></mujoco>"
KEYS = '<mujoco><keyframe><key name="home" qpos="0 0 0 0"/></keyframe></mujoco>'
SCENE = '<mujoco><include file="arm.xml"/></mujoco>'


def test_robots_parts_and_scenes_are_counted_and_compared(tmp_path, monkeypatch):
    files = {"arm/arm.xml": ARM, "arm/scene.xml": SCENE, "arm/keys.xml": KEYS, "fly/fly.xml": DRONE}
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    monkeypatch.setattr(menagerie, "PAGE", tmp_path / "page.md")
    rows = {row["what"]: row["number"] for row in menagerie.main(tmp_path)["rows"]}
    assert rows["robots' files, taken / all"] == "1 / 2"
    assert rows["refused: only a free joint or balls"] == rows["of them followers"] == "1"
    assert rows["scenes, taken / all"] == "1 / 1" and rows["parts of robots, refused"] == "1"
    assert float(rows["largest difference of a force"]) < 1e-12
    page = (tmp_path / "page.md").read_text()
    assert "| `arm/arm.xml` | yes, gravcomp | 4 | 1 | 1 by tendons |" in page
    assert "| `fly/fly.xml` | no: it moves freely" in page
    assert "| `arm/keys.xml` | it holds no `<body>`, so it is not a robot |" in page


def test_a_folder_that_is_none_is_said(tmp_path):
    with pytest.raises(FileNotFoundError, match="JAXID_MENAGERIE"):
        menagerie.main(tmp_path)


def test_every_file_of_the_menagerie_is_taken_or_refused_in_words():
    folder = Path(os.environ.get("JAXID_MENAGERIE", "menagerie"))
    files = sorted(folder.glob("*/*.xml"))
    if not files:
        pytest.skip("there is no checkout of the menagerie: set JAXID_MENAGERIE")
    refused = {}
    for file in files:
        try:
            read_mjcf(file)
        except UsageError as error:
            refused[file.relative_to(folder).as_posix()] = str(error)
    assert len(refused) < 0.1 * len(files), refused
    taken = menagerie.tried(folder / "robotiq_2f85" / "2f85.xml", folder, compare=True)
    assert taken.difference < 1e-12
