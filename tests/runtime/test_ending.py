"""Signals end a command within two seconds, whatever it does, and leave nothing half written."""

import contextlib
import os
import pathlib
import signal
import subprocess
import sys
import time

import pytest

from neurosym_jax.errors import InputError
from neurosym_jax.runtime.files import refuse_unwritable
from tests.repository import ROOT, exhaustive

COMMAND = """
import concurrent.futures, pathlib, subprocess, sys, time
from neurosym_jax.commands._running import run_command
from neurosym_jax.runtime.ending import when_ended
from neurosym_jax.runtime.files import new_file

def sleep():
    print("ready", flush=True)
    time.sleep(60)

def swallow():
    with new_file("made.txt") as beside:
        beside.write_text("half")
        print("ready", flush=True)
        while True:
            try:
                time.sleep(60)
            except BaseException:
                pass

def translate():
    try:
        sleep()
    except KeyboardInterrupt:
        raise ValueError("setting an array element with a sequence") from None

def return_early():
    try:
        sleep()
    except KeyboardInterrupt:
        return 0

def wait_for_threads():
    with concurrent.futures.ThreadPoolExecutor(1) as pool:
        pool.submit(time.sleep, 60)
        sleep()

def wait_for_a_child():
    child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])
    pathlib.Path("child").write_text(str(child.pid))
    with child, when_ended(child.terminate):
        print("ready", flush=True)
        child.wait()

action = sys.argv[1]

def run():
    return globals()[action]()

run_command(run, arguments=[])
"""


def restore():
    """Not ignored, as in what a shell runs in the background."""
    signal.signal(signal.SIGINT, signal.default_int_handler)


def wait_until_ended(number, seconds):
    """A container's first process may leave a process that has ended as a zombie."""
    deadline = time.monotonic() + seconds
    status = pathlib.Path(f"/proc/{number}/stat")
    while status.exists() and status.read_text().rpartition(")")[2].split()[0] != "Z":
        assert time.monotonic() < deadline, f"process {number} still runs"
        time.sleep(0.05)


@pytest.fixture
def start(tmp_path):
    """Start the command with an action, and wait until that has begun."""
    with contextlib.ExitStack() as stack:

        def run(action, before=restore):
            process = subprocess.Popen(
                [sys.executable, "-c", COMMAND, action],
                cwd=tmp_path,
                env={**os.environ, "PYTHONPATH": str(ROOT)},
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
                preexec_fn=before,
            )
            stack.enter_context(process)
            stack.callback(process.kill)
            assert process.stdout.readline() == "ready\n"
            return process

        yield run


@pytest.mark.parametrize(
    ("action", "number"),
    [
        ("sleep", signal.SIGINT),
        exhaustive("sleep", signal.SIGTERM),
        exhaustive("sleep", signal.SIGHUP),
        ("translate", signal.SIGINT),
        ("return_early", signal.SIGTERM),
        ("swallow", signal.SIGTERM),
        ("wait_for_threads", signal.SIGHUP),
        ("wait_for_a_child", signal.SIGTERM),
    ],
)
def test_a_signal_ends_a_command_within_two_seconds(start, tmp_path, action, number):
    if signal.getsignal(number) is signal.SIG_IGN:
        pytest.skip("the tests run in the background, where this signal is ignored")
    process, since = start(action), time.monotonic()
    process.send_signal(number)
    _, errors = process.communicate(timeout=30)
    # Two seconds are asked of an idle machine.
    assert time.monotonic() - since < 2 + os.getloadavg()[0]
    assert (process.returncode, errors) == (128 + number, "interrupted\n")
    if action == "wait_for_a_child":
        wait_until_ended(int((tmp_path / "child").read_text()), seconds=20)
    else:
        assert not list(tmp_path.iterdir())


def test_what_is_ignored_stays_ignored(start):
    """As under nohup."""
    process = start("sleep", lambda: signal.signal(signal.SIGHUP, signal.SIG_IGN))
    process.send_signal(signal.SIGHUP)
    with pytest.raises(subprocess.TimeoutExpired):
        process.wait(2.5)


def test_a_device_is_no_file_to_write():
    """Reading what was there before would not end."""
    with pytest.raises(InputError, match="/dev/zero: cannot be written"):
        refuse_unwritable("/dev/zero")
