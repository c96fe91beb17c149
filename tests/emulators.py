"""Emulators in processes of their own, as a user starts them, and what their logs say."""

from __future__ import annotations

import itertools
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from jaxid.hardware.link import Driver
from jaxid.hardware.transfer import Sender


_NUMBER = itertools.count(1)
#: Longest delay this machine may add to a deadline (s); tests state deadlines without it.
SLACK_S = float(os.environ.get("JAXID_TEST_SLACK_S", "0.25"))
#: How long things may be silent while something moves: far more than on a robot, for a machine that
#: does other things too.
PATIENT_S = 0.8


class Emulator:
    """`jaxid emulate …`; `address` is its host or port, `order` types a line."""

    def __init__(self, folder: Path, *arguments: str):
        self.log_file = folder / f"emulator_{next(_NUMBER)}.jsonl"
        self.log_file.touch()
        command = [
            sys.executable,
            "-m",
            "jaxid.cli",
            "emulate",
            *arguments,
            "--log",
            str(self.log_file),
        ]
        self.process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        assert self.process.stdout is not None
        self.address = self.process.stdout.readline().strip()
        assert self.address, "the emulator did not start"

    @classmethod
    def ur(cls, folder: Path, plant: str = "ideal") -> Emulator:
        number = next(_NUMBER)
        host = f"127.{1 + os.getpid() % 200}.{os.getpid() // 200 % 250}.{number}"
        return cls(folder, "ur10", "--host", host, "--plant", plant)

    @classmethod
    def servo(cls, folder: Path, *more: str, plant: str = "ideal") -> Emulator:
        fast = () if "--return-delay" in more else ("--return-delay", "0")
        return cls(folder, "dynamixel", "--plant", plant, "--latency", "0.0005", *fast, *more)

    def order(self, text: str) -> float:
        """Types an order and waits until it was carried out; returns when it was typed (monotonic
        s).
        """
        assert self.process.stdin is not None and self.process.stdout is not None
        typed = time.monotonic()
        self.process.stdin.write(text + "\n")
        self.process.stdin.flush()
        answer = self.process.stdout.readline().strip()
        assert answer == "ok", answer
        return typed

    def log(self, *what: str, since: float = 0.0) -> list[dict]:
        entries = [
            json.loads(line)
            for line in self.log_file.read_text().splitlines()
            if line.endswith("}")
        ]
        return [e for e in entries if e["at"] >= since and (not what or e["what"] in what)]

    def wait_for(self, condition: Callable[[list[dict]], bool], seconds: float = 20.0) -> None:
        until = time.monotonic() + seconds
        while not condition(self.log()):
            assert time.monotonic() < until, "the emulator never saw it"
            time.sleep(0.01)

    def close(self) -> None:
        assert self.process.stdin is not None and self.process.stdout is not None
        self.process.stdin.close()
        try:
            self.process.wait(3)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        self.process.stdout.close()


def servoing(log: list[dict]) -> int:
    """How many servoJ commands a UR emulator saw."""
    return sum(e.get("name") == "servoJ" for e in log)


def stops(log: list[dict]) -> list[dict]:
    """What ended a motion of a UR."""
    return [e for e in log if e["what"] == "halt" or e.get("name") in ("servoStop", "stopScript")]


def writes(log: list[dict], address: int | None = None) -> list[dict]:
    """Registers written on a servo."""
    return [e for e in log if e["what"] == "write" and (address is None or e["address"] == address)]


def signed(data: list[int]) -> int:
    return int.from_bytes(bytes(data), "little", signed=True)


def hand_over(
    driver: Driver, rows: np.ndarray | Sequence[Sequence[float]], seconds: float = 10.0
) -> int:
    """Gives a driver the table of a path; returns in how many pieces."""
    path = Sender(np.array(rows, float), driver.send)
    until, pieces, others = time.monotonic() + seconds, 0, []
    while True:
        for message in driver.messages(0.02):
            if message["kind"] == "want":
                path.answer(message)
                pieces += 1
            elif message["kind"] == "loaded":
                driver.inbox = others + driver.inbox
                return pieces
            else:
                others.append(message)
        assert time.monotonic() < until, "the driver did not take the path"
        driver.send("beat")
