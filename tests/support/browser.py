"""A page of eyespot in a real Chromium: the browser, a program that serves it, and patience."""

import contextlib
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

HOME = Path(__file__).resolve().parents[2]
PATIENCE_S = 30.0


def wait_until(done: Callable[[], Any], what: str) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not done():
        assert time.monotonic() < deadline, f"waited in vain: {what}"
        time.sleep(0.02)


@pytest.fixture(scope="module")
def browser():
    pytest.importorskip("nicegui", reason="pip install 'eyespot[console]'")
    playwright = pytest.importorskip("playwright.sync_api", reason="pip install playwright")
    chromium = shutil.which("chromium")
    if chromium is None:
        pytest.skip("apt-get install chromium")
    with playwright.sync_playwright() as started:
        # Chromium's own sandbox does not run as root.
        browser = started.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        yield browser
        browser.close()


@contextlib.contextmanager
def console(*command: object, log: Path) -> Iterator[str]:
    """A program that serves the page; its address."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    words = [sys.executable, "-m", *(str(word).format(port=port) for word in command)]
    # NiceGUI starts otherwise where it sees pytest's variable.
    environment = {name: value for name, value in os.environ.items() if "PYTEST" not in name}
    with log.open("wb") as output:
        process = subprocess.Popen(
            words, cwd=HOME, env=environment, stdout=output, stderr=subprocess.STDOUT
        )
    address = f"http://127.0.0.1:{port}/"
    try:
        wait_until(lambda: process.poll() is not None or answers(address), "the page")
        assert process.poll() is None, log.read_text()
        yield address
        process.send_signal(signal.SIGINT)
        process.wait(10)
        assert "Traceback" not in log.read_text()
    finally:
        process.kill()
        process.wait()


def answers(address: str) -> bool:
    try:
        urllib.request.urlopen(address, timeout=5)
    except urllib.error.HTTPError:
        return True  # asks for a token
    except OSError:
        return False
    return True
