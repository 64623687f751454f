"""Starting and ending: a taken port or folder is told at once, Ctrl-C is quiet, no proxy stands before loopback."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from orchestrator.api.listener import bind
from orchestrator.client import Client
from orchestrator.core.supervise import Stack
from orchestrator.store.lock import FolderLock, check_free
from shared.errors import ConflictError, InvalidInputError, UnavailableError

GIVE_UP_S = 60.0
PROXIES = {
    **dict.fromkeys(("HTTP_PROXY", "http_proxy", "HTTPS_PROXY", "https_proxy"), "http://127.0.0.1:9"),
    **dict.fromkeys(("ALL_PROXY", "all_proxy"), "socks5://127.0.0.1:9"),
}


def motionloop(*arguments: str, code: int) -> str:
    """What a command says; it must not need what it is refused for."""
    done = subprocess.run(
        [sys.executable, "-m", "motionloop", *arguments], capture_output=True, text=True, timeout=GIVE_UP_S, check=False
    )
    said = done.stdout + done.stderr
    assert done.returncode == code, said
    assert "Traceback" not in said
    return " ".join(said.split())


def test_a_second_server_on_a_data_folder_is_refused_before_anything_starts(tmp_path: Path) -> None:
    with FolderLock(tmp_path / "data"):
        said = motionloop("serve", "--data-dir", str(tmp_path / "data"), "--port", "0", code=1)
        assert f"in use by another server (process {os.getpid()})" in said
        assert "--data-dir" in said
        assert "planner" not in said
        with pytest.raises(ConflictError):
            check_free(tmp_path / "data")
    check_free(tmp_path / "data")


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_service_alone_ends_with_the_command_that_serves_it(number: signal.Signals) -> None:
    command = [sys.executable, "-m", "motionloop", "serve", "planner", "--endpoint", "tcp://127.0.0.1:0"]
    process = subprocess.Popen([*command, "--plugins", "stand"], stdout=subprocess.PIPE, text=True)
    service: psutil.Process | None = None
    try:
        assert process.stdout is not None
        assert "ready" in process.stdout.readline()
        (service,) = psutil.Process(process.pid).children()
        process.send_signal(number)
        process.communicate(timeout=GIVE_UP_S)
        assert process.returncode == 0
        assert not service.is_running()
    finally:
        process.kill()
        if service is not None and service.is_running():
            service.kill()
        process.communicate()


def test_a_taken_port_is_named_with_what_to_do(tmp_path: Path) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        for command in (["serve"], ["serve", "orchestrator"]):
            code = 1 if len(command) == 1 else 2
            said = motionloop(*command, "--port", str(port), "--data-dir", str(tmp_path), code=code)
            assert f"port {port} on 127.0.0.1 is taken" in said
            assert "--port" in said


def test_an_address_of_another_machine_is_refused_by_name() -> None:
    with pytest.raises(InvalidInputError, match=r"192\.0\.2\.1"):
        bind("192.0.2.1", 0)


HOLD = """
from pathlib import Path; import sys
from orchestrator.store.lock import FolderLock
FolderLock(Path(sys.argv[1])).acquire(); print("held", flush=True); input()
"""
RUN = """
import signal, sys; sys.argv[0] = "motionloop"
signal.signal(signal.SIGINT, signal.default_int_handler)  # a job in the background is started with it ignored
print("up", flush=True)
from motionloop.cli import main; main()
"""


def test_a_folder_that_a_killed_process_held_is_free(tmp_path: Path) -> None:
    command = [sys.executable, "-c", HOLD, str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stdin=subprocess.PIPE) as holder:
        assert holder.stdout is not None and holder.stdout.readline() == b"held\n"
        with pytest.raises(ConflictError, match=str(holder.pid)):
            check_free(tmp_path)
        holder.kill()
        holder.wait()
        check_free(tmp_path)


@pytest.mark.parametrize("after_s", [0.0, 0.3, 1.5])
@pytest.mark.parametrize("command", [["serve", "--port", "0"], ["eval", "text", "--planner", "stand"]])
def test_ctrl_c_at_any_moment_is_quiet(tmp_path: Path, command: list[str], after_s: float) -> None:
    """Whenever it comes: nothing of Python is shown, and the code is that of an interrupt or of a clean end."""
    if command[0] == "serve":
        command = [*command, "--data-dir", str(tmp_path)]
    process = subprocess.Popen(
        [sys.executable, "-c", RUN, *command], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        start_new_session=True,
    )  # fmt: skip
    assert process.stdout is not None and process.stdout.readline() == "up\n"
    time.sleep(0.01 + after_s)
    os.killpg(process.pid, signal.SIGINT)
    out, err = process.communicate(timeout=GIVE_UP_S)
    assert process.returncode in (0, 130), (process.returncode, err)
    assert "Traceback" not in out + err
    assert "KeyboardInterrupt" not in out + err


def test_a_client_reaches_loopback_past_any_proxy(stack: Stack, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in PROXIES.items():
        monkeypatch.setenv(name, value)
    with Client(stack.url) as client:
        assert client.ready()
        with client.character(pacing="lockstep") as character:
            assert character.step(3).tick == 3
    # Elsewhere the proxies count; one that cannot be used is told in a sentence.
    with pytest.raises(UnavailableError, match=r"proxy|nobody|no server"), Client("http://192.0.2.1:8080") as far:
        far.services()


def test_callers_wait_for_plans_and_plans_for_physics(stack: Stack) -> None:
    own = os.nice(0)
    assert stack.orchestrator is not None
    for process, niceness in ((stack.tracker, 0), (stack.planner, 5), (stack.orchestrator, 10)):
        assert psutil.Process(process.pid).nice() == min(own + niceness, 19), process.name
        group = Path(f"/proc/{process.pid}/autogroup")
        if group.exists() and niceness:
            assert group.read_text().split()[-2:] == ["nice", str(niceness)], process.name
