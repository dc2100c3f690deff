"""Ctrl-C ends every command with exit code 130, whatever the command is doing."""

import os
import signal
import subprocess
import sys
import time

import pytest

from tests.support.command_line import EYESPOT

PATIENCE_S = 20.0
"""Far longer than a command may take to end, far shorter than it would take to finish."""


def stopped(*words, after_s, cwd=None):
    """Ctrl-C as a terminal sends it, to all processes of a command; its code, errors, orphans."""
    command = subprocess.Popen(
        list(map(str, words)),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=cwd,
        start_new_session=True,
    )
    try:
        if isinstance(after_s, str):
            assert command.stdout is not None
            assert after_s in command.stdout.readline()
            time.sleep(0.3)  # until it is inside of what it announced
        else:
            with pytest.raises(subprocess.TimeoutExpired):
                command.wait(after_s)
        os.killpg(command.pid, signal.SIGINT)
        _, err = command.communicate(timeout=PATIENCE_S)
        return command.returncode, err, left_of(command.pid)
    finally:
        if left_of(command.pid, patience_s=0):
            os.killpg(command.pid, signal.SIGKILL)


def left_of(group, patience_s=10.0):
    """Whether processes of a group are still there after a while."""
    end = time.monotonic() + patience_s
    while True:
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return False
        if time.monotonic() > end:
            return True
        time.sleep(0.05)


DROPPED = """
import gc, sys, time
from eyespot.estimator.run.ctrl_c import ending_on_ctrl_c, end_now

def collected(phase, info):
    time.sleep(0.01)  # so that nearly every Ctrl-C comes in here, where Python drops it

try:
    with ending_on_ctrl_c():
        gc.callbacks.append(collected)
        print("ready", flush=True)
        while True:
            gc.collect(0)
except KeyboardInterrupt:
    end_now()
"""

NATIVE = """
import hashlib
from eyespot.estimator.run.ctrl_c import ending_on_ctrl_c

with ending_on_ctrl_c():
    print("ready", flush=True)
    hashlib.pbkdf2_hmac("sha256", b"", b"", 2 * 10**9)  # ten minutes in one call
"""


@pytest.mark.parametrize("code", [DROPPED, NATIVE], ids=["dropped in a callback", "native code"])
def test_neither_a_callback_nor_native_code_swallows_ctrl_c(code):
    assert stopped(sys.executable, "-c", code, after_s="ready") == (130, "", False)


FINISHING = """
import time
from eyespot.estimator.run.ctrl_c import ending_on_ctrl_c, finish_first
from eyespot.estimator.run.ctrl_c import PATIENCE_S

with ending_on_ctrl_c():
    try:
        print("ready", flush=True)
        time.sleep(100)
    except KeyboardInterrupt:
        finish_first()
        print("writing", flush=True)
        time.sleep({seconds} * PATIENCE_S)
        print("written", flush=True)
"""


@pytest.mark.parametrize(
    ("seconds", "again", "ended"), [(2, False, ("written\n", 0)), (100, True, ("", 130))]
)
def test_a_command_that_writes_its_results_ends_after_it_or_at_a_second_ctrl_c(
    seconds, again, ended
):
    """On a busy machine that takes longer than a command may take that does nothing of use."""
    command = subprocess.Popen(
        [sys.executable, "-c", FINISHING.format(seconds=seconds)], stdout=subprocess.PIPE, text=True
    )
    assert command.stdout is not None
    for line in ("ready\n", "writing\n"):
        assert command.stdout.readline() == line
        if line == "ready\n" or again:
            command.send_signal(signal.SIGINT)
    rest, _ = command.communicate(timeout=PATIENCE_S)
    assert (rest, command.returncode) == ended


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    folder = tmp_path_factory.mktemp("recording")
    # Of a lens, whose fit takes longer than the latest Ctrl-C.
    even = ["--set", "phantom.wall=uniform", "--set", "motion.frames=12"]
    subprocess.run([EYESPOT, "scene", "init", "scene.toml"], cwd=folder, check=True)
    subprocess.run(
        [EYESPOT, "render", "scene.toml", "--out", "stack", *even], cwd=folder, check=True
    )
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("after_s", [1.5, 5.0, 12.0])
@pytest.mark.parametrize(
    "words",
    [
        ("fit", "stack", "--out", "OUT.json"),
        ("study", "medium", "--quick", "--out", "OUT"),
        ("validate", "--quick", "--out", "OUT"),
        ("dataset", "static-v1", "--workers", "2", "--out", "OUT"),
        ("render", "scene.toml", "--out", "OUT", "--set", "motion.frames=2000"),
    ],
    ids=lambda words: words[0],
)
def test_every_command_can_be_stopped_at_any_time(recording, tmp_path, words, after_s):
    out = tmp_path / "out"
    words = [word.replace("OUT", str(out)) for word in words]
    code, err, left = stopped(EYESPOT, *words, after_s=after_s, cwd=recording)
    assert code == 130
    assert "Traceback" not in err
    assert "Exception ignored" not in err
    assert not left
    assert not out.with_suffix(".json").exists()


def test_workers_are_reached_from_this_machine_only():
    """A cluster's dashboard and ports have no password."""
    import psutil

    from eyespot.benchmarks.sets.workers import local_workers

    with local_workers(1) as client:
        client.wait_for_workers(1)
        here = psutil.Process()
        listening = {
            connection.laddr.ip
            for process in (here, *here.children(recursive=True))
            for connection in process.net_connections("inet")
            if connection.status == psutil.CONN_LISTEN
        }
    assert listening == {"127.0.0.1"}
