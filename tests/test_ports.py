"""What listens: on loopback alone, and between machines only by TLS to who has the certificate."""

from __future__ import annotations

import asyncio
import ipaddress
import json
import os
import shutil
import signal
import socket
import stat
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest

import jaxid
from benchmarks import memory
from emulators import Emulator
from jaxid.cli import app
from jaxid.study import cluster, run_study, slurm
from test_batch import (
    FLEET,
    running_scheduler as running_scheduler,
    SOLVE,
    write_dataset,
    write_study,
)


# As `sbatch`: starts two of the array's jobs on this machine.
SBATCH = """#!/bin/sh
cp "$1" "{folder}/submitted.sh"
for k in 1 2; do setsid sh "{folder}/submitted.sh" > "{folder}/log$k" 2>&1 & done
echo "Submitted batch job 4711"
"""
SCANCEL = """#!/bin/sh
echo "$1" > "{folder}/cancelled"
"""


def listening(*processes: psutil.Process) -> set[tuple[str, int]]:
    """Addresses on which processes and their children listen now."""
    found = set()
    for p in processes:
        for q in (p, *p.children(recursive=True)):
            try:
                sockets = q.net_connections(kind="inet")
            except psutil.Error:
                continue
            found |= {
                (s.laddr.ip, s.laddr.port)
                for s in sockets
                if s.status == psutil.CONN_LISTEN or not s.raddr
            }
    return found


def beyond_loopback(found: set[tuple[str, int]]) -> set[tuple[str, int]]:
    return {s for s in found if not ipaddress.ip_address(s[0]).is_loopback}


@pytest.fixture
def home(tmp_path):
    write_dataset(tmp_path / "small")
    return tmp_path


@pytest.fixture
def fake_slurm(tmp_path, monkeypatch):
    folder = tmp_path / "bin"
    folder.mkdir()
    for name, text in (("sbatch", SBATCH), ("scancel", SCANCEL)):
        (folder / name).write_text(text.format(folder=folder))
        (folder / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{folder}{os.pathsep}{os.environ['PATH']}")
    return folder


def workers_of(folder: Path) -> list[psutil.Process]:
    """The dask workers that a fake `sbatch` started."""
    key = str(folder.parent)
    lines = {p: p.info["cmdline"] or [] for p in psutil.process_iter(["cmdline"])}
    return [
        p for p, line in lines.items() if "--tls-key" in line and any(key in part for part in line)
    ]


def test_a_local_cluster_listens_nowhere(home):
    seen: list[set] = []
    study = write_study(home, "seeds = 30")

    def heard(progress):
        return seen.append(listening(psutil.Process()))

    before = listening(psutil.Process())
    result = run_study(
        study,
        cluster="local",
        workers=2,
        solver=(*SOLVE, "--sleep", "0.05"),
        check=False,
        heard=heard,
    )
    assert result.complete and seen and set().union(*seen) <= before


def test_workers_of_slurm_listen_by_tls_on_one_network(home, fake_slurm):
    """Everything between the nodes stays on the named network, here loopback; who has no
    certificate is refused.
    """
    pytest.importorskip("cryptography")
    store, seen, tries, private = home / "out", set(), [], []

    def heard(progress):
        if progress.new > 2 and not tries:
            seen.update(listening(psutil.Process(), *workers_of(fake_slurm)))
            (folder,) = store.glob(f"{slurm.PRIVATE}*")
            private.extend(stat.S_IMODE(p.stat().st_mode) for p in (folder, *folder.glob("*.pem")))
            scheduler = next(
                a
                for a in (fake_slurm / "submitted.sh").read_text().split()
                if a.startswith("tls://")
            )
            for address in (scheduler, scheduler.replace("tls://", "tcp://")):
                try:
                    tries.append(asyncio.run(asyncio.wait_for(cluster._kind(address), 3.0)))
                except Exception as error:
                    tries.append(type(error))

    study = write_study(home, "seeds = 120")
    solver = (*SOLVE, "--sleep", "0.05")
    result = run_study(
        study, cluster="slurm", interface="lo", workers=2, solver=solver, check=False, heard=heard
    )
    assert result.complete and result.status.done == 120
    assert len(seen) >= 3 and not beyond_loopback(
        seen
    )  # a scheduler and at least two ports of workers
    assert private == [0o700, 0o600, 0o600, 0o600]
    assert len(tries) == 2 and all(
        isinstance(t, type) and issubclass(t, Exception) for t in tries
    ), tries
    assert (fake_slurm / "cancelled").read_text().strip() == "4711" and not list(
        store.glob(f"{slurm.PRIVATE}*")
    )
    _, left = psutil.wait_procs(workers_of(fake_slurm), timeout=20)
    assert not left


@pytest.mark.parametrize(
    "more, said",
    [
        ({"interface": "lo"}, "--workers N"),
        ({"workers": 2}, "--interface .there is: .*lo"),
        (
            {"workers": 2, "interface": "lp"},
            "--interface lp: no network of this machine .did you mean 'lo'",
        ),
    ],
)
def test_what_slurm_needs(home, fake_slurm, more, said):
    with pytest.raises(jaxid.UsageError, match=said):
        run_study(write_study(home), cluster="slurm", solver=SOLVE, check=False, **more)


def test_without_slurm(home, monkeypatch):
    monkeypatch.setattr(shutil, "which", lambda *_: None)
    with pytest.raises(jaxid.UsageError, match="no `sbatch` here.*--cluster local"):
        run_study(
            write_study(home), cluster="slurm", interface="lo", workers=2, solver=SOLVE, check=False
        )


def test_an_sbatch_that_refuses(home, fake_slurm):
    pytest.importorskip("cryptography")
    (fake_slurm / "sbatch").write_text("#!/bin/sh\necho 'invalid partition' >&2; exit 1\n")
    with pytest.raises(jaxid.UsageError, match="sbatch refused the workers: invalid partition"):
        run_study(
            write_study(home), cluster="slurm", interface="lo", workers=2, solver=SOLVE, check=False
        )
    assert not list((home / "out").glob(f"{slurm.PRIVATE}*"))


def test_jobs_that_slurm_ended(home, fake_slurm, monkeypatch):
    pytest.importorskip("cryptography")
    (fake_slurm / "sbatch").write_text("#!/bin/sh\necho 'Submitted batch job 4711'\n")
    (fake_slurm / "squeue").write_text("#!/bin/sh\n")
    (fake_slurm / "squeue").chmod(0o755)
    monkeypatch.setattr(slurm, "ASK_S", 0.1)
    with pytest.raises(RuntimeError, match="SLURM has ended the workers .job 4711.*worker-.*log"):
        run_study(
            write_study(home), cluster="slurm", interface="lo", workers=2, solver=SOLVE, check=False
        )


def test_places_that_exclude_each_other(home):
    excluding: list[dict[str, Any]] = [
        {"scheduler": "tcp://10.0.0.1:1", "cluster": "local"},
        {"interface": "lo"},
        {"cluster": "slum"},
    ]
    for more in excluding:
        with pytest.raises(jaxid.UsageError, match="--cluster|--interface"):
            run_study(write_study(home), solver=SOLVE, check=False, **more)


@pytest.mark.parametrize(
    "address",
    [
        "nonsense",
        "http://example.com",
        "tcp://",
        "tcp://10.0.0.1",
        "10.0.0.1:port",
        "",
        " ",
        "tcp://a b:1",
        "file:x",
    ],
)
def test_what_is_no_address(home, address):
    with pytest.raises(jaxid.UsageError, match="no address of a scheduler; write it as in tcp://"):
        run_study(write_study(home), scheduler=address, solver=SOLVE, check=False)


def test_what_answers_otherwise(home, monkeypatch):
    """Silence, a web server and a name that nobody has: one sentence, and no wait at the end."""
    monkeypatch.setattr(cluster, "CONNECT_S", 2.0)
    web = subprocess.Popen(
        [sys.executable, "-m", "http.server", "0", "--bind", "127.0.0.1"],
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        until = time.monotonic() + 20
        while not (ports := listening(psutil.Process(web.pid))) and time.monotonic() < until:
            time.sleep(0.1)
        ((_, port),) = ports
        for address in (
            f"tcp://127.0.0.1:{port}",
            f"127.0.0.1:{port}",
            "nobody.invalid:8786",
            "tls://127.0.0.1:9",
        ):
            with pytest.raises(jaxid.UsageError, match="no scheduler answers there"):
                run_study(write_study(home), scheduler=address, solver=SOLVE, check=False)
    finally:
        web.kill()
        web.communicate()


def test_a_scheduler_that_dies(home, running_scheduler):
    """What was finished is kept, and the sentence is no fault of a file."""
    address, _ = running_scheduler
    port = int(address.rpartition(":")[2])
    (scheduler,) = [
        p for p in psutil.Process().children() if port in {at for _, at in listening(p)}
    ]
    study = write_study(home, "seeds = 200")
    code = (
        "import sys; from jaxid.study import run_study; from jaxid.study.coordinator import StudyFailed\n"
        f"solver = ({FLEET!r}, 'solve', '--sleep', '0.05')\n"
        "heard = lambda p: print(p.new, flush=True)\n"
        "try: run_study(sys.argv[1], scheduler=sys.argv[2], solver=solver, check=False, heard=heard)\n"
        "except StudyFailed as error: print('StudyFailed', error)"
    )
    command = [sys.executable, "-c", code, str(study), address]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        done = 0
        while done < 5:
            done = int(process.stdout.readline())
        os.kill(scheduler.pid, signal.SIGKILL)
        out, err = process.communicate(timeout=90)
    finally:
        process.kill()
    assert out.splitlines()[-1].startswith(
        "StudyFailed the scheduler has gone; what was finished is saved"
    ), out + err
    assert "Traceback" not in err
    from jaxid.study import study_status

    assert study_status(study)[2].done >= done


@pytest.mark.parametrize(
    "command",
    [["emulate", "ur10"], ["emulate", "dynamixel"], ["fit", "small", "--out", "out", "--quiet"]],
)
def test_commands_listen_on_loopback_alone(home, command):
    emulates = command[0] == "emulate"
    process = subprocess.Popen(
        [sys.executable, "-m", "jaxid.cli", *command],
        cwd=home,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=os.environ | {"PYTHONPATH": str(Path(__file__).resolve().parents[1])},
    )
    try:
        assert process.stdout is not None
        if emulates:
            process.stdout.readline()  # it tells its address when it listens
        seen, until = set(), time.monotonic() + (1 if emulates else 100)
        while time.monotonic() < until and process.poll() is None:
            seen |= listening(psutil.Process(process.pid))
            time.sleep(0.1)
        assert process.poll() is None if emulates else process.returncode == 0
        assert not beyond_loopback(seen)
        assert bool(seen) == (command[1] == "ur10")  # a servo is a serial line
    finally:
        process.kill()
        process.communicate()


# Runs commands one after the other in one process and tells every address that Python binds, be it
# for a moment.
IN_ONE_PROCESS = """
import json, socket, sys
def heard(event, about):
    if event == "socket.bind" and isinstance(about[1], tuple):
        print("bound", *about[1][:2], flush=True)
sys.addaudithook(heard)
own = socket.create_server(("127.0.0.1", 0))  # so that it is known that both ways of looking see
from jaxid.cli import app
for words in json.loads(sys.argv[1]):
    print("began", words[0], flush=True)
    try:
        code = app.main(words)
    except SystemExit as end:
        code = end.code
    print("ended", words[0], code, flush=True)
"""
QUICK = ["--quiet", "--out"]
#: Each command of `jaxid --help`, most with what it takes; `emulate` has a test of its own above.
WORDS: dict[str, list[str]] = {
    "models": [],
    "effects": [],
    "fitters": [],
    "check": ["small", "--quiet"],
    "fit": ["small", *QUICK, "fit"],
    "simulate": ["small", "--parameters", "fit/fit.json", *QUICK, "simulated"],
    "compare": [
        "small",
        "--fitters",
        "lm,de",
        "--seeds",
        "2",
        "--budget",
        "200",
        *QUICK,
        "compared",
    ],
    "diagnose": ["small", "--effects", "dead_zone", "--max-effects", "1", *QUICK, "diagnosis"],
    "batch": ["study.toml", "--workers", "1", "--quiet"],
    "identify": ["arm", "--friction", "linear", *QUICK, "identified"],
    "excite": [
        "--model",
        "joint",
        "--duration",
        "2",
        "--starts",
        "1",
        "--amplitude",
        "1",
        *QUICK,
        "excited",
    ],
    "import": [
        "csv",
        "small/run.csv",
        "--channel",
        "t=t:s",
        "--channel",
        "q=q:rad:output",
        "--out",
        "imported",
    ],
    "export": ["small", "--to", "mjcf", "--robot", "none.xml", "--out", "exported"],
    "replay": ["small", "--robot", "none.xml", "--out", "replayed"],
    "record": ["dynamixel", "--id", "1", "--seconds", "1", "--out", "recorded", "--port"],
    "reproduce": ["001", *QUICK, "paper"],
    "emulate": [],
}


@pytest.mark.slow
def test_no_command_listens_beyond_loopback(home, tmp_path):
    """All of them in one process: what Python binds, and what the kernel says of the process and
    its children meanwhile.
    """
    assert set(WORDS) == set(app.cli.commands) | set(app.MODULES)
    memory.write(home / "arm", "identify", 4000)
    write_study(home)
    path = np.column_stack([np.arange(500) / 500, np.zeros((500, 6))])
    np.savetxt(
        home / "path.csv",
        path,
        delimiter=",",
        header="t," + ",".join(f"q{j}" for j in range(1, 7)),
        comments="",
    )
    robot, servo = Emulator.ur(tmp_path), Emulator.servo(tmp_path)
    play = [
        "record",
        "ur10",
        "--host",
        robot.address,
        "--play",
        "path.csv",
        "--live",
        "--out",
        "played",
    ]
    words = [[name, *more] for name, more in WORDS.items() if name not in ("emulate", "reproduce")]
    words = [[*w, servo.address] if w[0] == "record" else w for w in words] + [
        play,
        ["reproduce", *WORDS["reproduce"]],
    ]
    process = subprocess.Popen(
        [sys.executable, "-c", IN_ONE_PROCESS, json.dumps(words)],
        cwd=home,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONPATH": str(Path(__file__).resolve().parents[1])},
    )
    seen, said = set(), []

    def read() -> None:
        assert process.stdout is not None
        said.extend(iter(process.stdout.readline, ""))

    reader = threading.Thread(target=read)
    reader.start()
    paper = 0.0
    try:
        while process.poll() is None and not (paper and time.monotonic() > paper + 20):
            seen |= listening(psutil.Process(process.pid))
            paper = (
                paper or ("began reproduce\n" in said) * time.monotonic()
            )  # takes minutes: its first 20 s
            time.sleep(0.02)
    finally:
        process.kill()
        reader.join()
        robot.close()
        servo.close()
    ended = [tuple(line.split()[1:]) for line in said if line.startswith("ended")]
    bound = {(line.split()[1], int(line.split()[2])) for line in said if line.startswith("bound")}
    assert seen and bound and not beyond_loopback(seen | bound), (seen, bound)
    refused = {"export": "2", "replay": "2"}  # they want a robot, and have no need of a network
    assert ended == [(w[0], refused.get(w[0], "0")) for w in words[:-1]], (
        ended,
        process.stderr and process.stderr.read(),
    )


@pytest.mark.slow
@pytest.mark.skipif(
    shutil.which("openssl") is None, reason="the recipe makes its certificate with openssl"
)
def test_the_recipe_without_slurm(home, tmp_path):
    """The commands of docs/batch.md as they stand there, with loopback for the network between the
    nodes: who has no certificate is refused, and nothing listens elsewhere.
    """
    page = (Path(__file__).resolve().parents[1] / "docs" / "batch.md").read_text()
    blocks = [b.partition("```")[0] for b in page.split("```sh\n")[1:]]
    (certificate,) = [b for b in blocks if "openssl req" in b]
    (parts,) = [b for b in blocks if "dask scheduler" in b]
    parts = (
        parts.replace("ib0", "lo")
        .replace("10.0.0.1:8786", f"127.0.0.1:{(port := free_port())}")
        .replace("\\\n", " ")
    )
    lines = [line.partition("  #")[0].strip() for line in parts.splitlines() if line.strip()]
    settings = "\n".join(line for line in lines if not line.startswith(("dask ", "jaxid ")))
    scheduler, worker, batch = (line for line in lines if line.startswith(("dask ", "jaxid ")))
    scheduler, worker = (
        f"{scheduler} --port {port}",
        worker.replace("--nworkers 16", "--nworkers 1"),
    )
    for name, module in (
        ("dask", "dask"),
        ("jaxid", "jaxid.cli"),
    ):  # of this Python, whatever PATH has
        command = tmp_path / "bin" / name
        command.parent.mkdir(exist_ok=True)
        command.write_text(f'#!/bin/sh\nexec {sys.executable} -m {module} "$@"\n')
        command.chmod(0o700)
    path = {
        "PATH": f"{tmp_path / 'bin'}{os.pathsep}{os.environ['PATH']}",
        "PYTHONPATH": str(Path(__file__).resolve().parents[1]),
    }
    environment = os.environ | {"HOME": str(tmp_path)} | path
    both = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}

    def shell(text):
        return subprocess.Popen(
            ["bash", "-c", f"{settings}\nexec {text}"], cwd=home, env=environment, **both
        )

    subprocess.run(["bash", "-ec", certificate], env=environment, check=True, capture_output=True)
    assert stat.S_IMODE((tmp_path / "dask-tls" / "key.pem").stat().st_mode) == 0o600
    write_study(home, "seeds = 2")
    started = [shell(scheduler), shell(worker)]
    try:
        until = time.monotonic() + 100
        nodes = [psutil.Process(p.pid) for p in started]
        while (
            len(seen := listening(*nodes)) < 3
            and all(p.poll() is None for p in started)
            and time.monotonic() < until
        ):
            time.sleep(0.2)
        assert len(seen) >= 3 and not beyond_loopback(seen), (
            seen
        )  # messages of both, pages of the scheduler
        for address in (f"tls://127.0.0.1:{port}", f"tcp://127.0.0.1:{port}"):
            with pytest.raises(jaxid.UsageError, match="no scheduler answers there"):
                run_study(home / "study.toml", scheduler=address, solver=SOLVE, check=False)
        told, _ = (ours := shell(batch)).communicate(timeout=200)
        assert ours.returncode == 0, told
        assert not beyond_loopback(listening(*nodes))
    finally:
        for process in started:
            for part in (
                psutil.Process(process.pid).children(recursive=True)
                if process.poll() is None
                else []
            ):
                part.kill()
            process.kill()
            process.communicate()


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as server:
        return server.getsockname()[1]
