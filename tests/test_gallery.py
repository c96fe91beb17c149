"""The gallery of public recordings: its figures are those that were kept, its files can be had."""

from __future__ import annotations

import json
import re
import subprocess
from dataclasses import dataclass
from pathlib import Path

import pytest

from benchmarks import gallery


ROOT = Path(__file__).resolve().parents[1]


@dataclass(frozen=True)
class Published:
    """A repository of somebody's, and one commit of it."""

    remote: str
    commit: str


@pytest.fixture
def published(tmp_path) -> Published:
    home = tmp_path / "remote" / "owner" / "name"
    (home / "data").mkdir(parents=True)
    (home / "data" / "log.csv").write_text("t,q\n0,1\n")
    (home / "large.bin").write_bytes(b"0" * 1000)

    def git(*words: str) -> str:
        who = ("-c", "user.name=a", "-c", "user.email=a@b.c")
        done = subprocess.run(
            ["git", "-C", str(home), *who, *words], check=True, capture_output=True, text=True
        )
        return done.stdout.strip()

    git("init", "--quiet")
    git("config", "uploadpack.allowFilter", "true")
    git("config", "uploadpack.allowAnySHA1InWant", "true")
    git("add", ".")
    git("commit", "--quiet", "-m", "first")
    commit = git("rev-parse", "HEAD")
    (home / "data" / "log.csv").write_text("t,q\n0,2\n")
    git("commit", "--quiet", "-a", "-m", "second")
    return Published((tmp_path / "remote").as_uri() + "/{}", commit)


def test_the_files_of_a_commit_are_fetched_and_no_others(published, tmp_path):
    recording = gallery.RECORDINGS[0]._replace(
        repository="owner/name", commit=published.commit, paths=("data",)
    )
    place = gallery.fetch(recording, tmp_path / "got", published.remote)
    files = sorted(p.relative_to(place).as_posix() for p in place.rglob("*") if p.is_file())
    assert files == ["data/log.csv"]
    assert (place / "data" / "log.csv").read_text() == "t,q\n0,1\n"


def test_ten_recordings_stand_there_with_repository_and_commit():
    page = gallery.page()
    assert len(gallery.RECORDINGS) >= 10
    for recording in gallery.RECORDINGS:
        assert re.fullmatch(r"[0-9a-f]{40}", recording.commit) and recording.licence
        assert f"## {recording.machine}\n" in page and f"`{recording.name}`" in page
        assert (ROOT / "benchmarks" / f"{recording.result}.py").is_file()


def test_what_is_said_changes_with_what_was_measured(tmp_path):
    """No answer is written by hand: another verdict among the kept figures is another sentence."""
    for file in gallery.RESULTS.glob("*.json"):
        text = file.read_text(encoding="utf-8")
        text = text.replace('"partly', '"unknown').replace("13.8, 13.8", "7.31, 7.31")
        (tmp_path / file.name).write_text(text, encoding="utf-8")
    kept, changed = gallery.page(), gallery.page(tmp_path)
    assert "**partly**" in kept and "**partly**" not in changed
    assert "7.31 times the noise" in changed and "7.31 times the noise" not in kept
    rows = json.loads((gallery.RESULTS / "robot_recordings.json").read_text())["rows"]
    whole = gallery.only(rows, recording="go2_chirp", joint="all")
    assert f"{whole['with effects']:.3g} rad" in kept


def test_a_name_that_is_none_is_refused(capsys):
    assert gallery.command(["out", "no_such_thing"]) == 2
    assert "no_such_thing" in capsys.readouterr().err
