"""A PostgreSQL server of the tests' own: in a folder under /tmp, on a socket there, as a user who is not root."""

from __future__ import annotations

import glob
import os
import pwd
import shutil
import signal
import subprocess
import tempfile
import time
from pathlib import Path
from types import TracebackType
from typing import Any

import psycopg

GIVE_UP_S = 120.0
STOP_S = 60.0


def programs() -> Path | None:
    """Where `initdb` and `postgres` are; None where they are not installed (Debian: postgresql)."""
    found = shutil.which("initdb")
    places = [*([Path(found).resolve().parent] if found else []), *map(Path, glob.glob("/usr/lib/postgresql/*/bin"))]
    return next((place for place in places if (place / "initdb").exists() and (place / "postgres").exists()), None)


def _identity() -> dict[str, Any]:
    """Who runs it: PostgreSQL refuses root."""
    if os.geteuid() != 0:
        return {}
    known = {entry.pw_name: entry for entry in pwd.getpwall()}
    user = known.get("postgres") or known["nobody"]
    return {"user": user.pw_uid, "group": user.pw_gid, "extra_groups": []}


class PostgresServer:
    """A server with nothing in it; a context manager.

    Args:
        bin_dir: as `programs` says.
    """

    def __init__(self, bin_dir: Path):
        self._bin = bin_dir
        self._who = _identity()
        self.folder = Path(tempfile.mkdtemp(prefix="pg-", dir="/tmp"))  # short: a socket's path has a limit
        self._process: subprocess.Popen[bytes] | None = None
        self._databases = 0

    def __enter__(self) -> PostgresServer:
        if self._who:
            os.chown(self.folder, self._who["user"], self._who["group"])
        try:
            self._run("initdb", "-D", str(self.folder / "data"), "-U", "motionloop", "-A", "trust", "-E", "UTF8",
                      "--locale=C", "--no-sync")  # fmt: skip
            self.start()
        except BaseException:
            self.__exit__(None, None, None)
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()
        shutil.rmtree(self.folder, ignore_errors=True)

    def start(self) -> None:
        """Start it, and wait until it answers."""
        command = [
            str(self._bin / "postgres"), "-D", str(self.folder / "data"), "-k", str(self.folder),
            "-c", "listen_addresses=", "-c", "fsync=off", "-c", "shared_buffers=16MB",
        ]  # fmt: skip
        with (self.folder / "log").open("ab") as log:
            self._process = subprocess.Popen(command, stdout=log, stderr=log, cwd="/", **self._who)
        until = time.monotonic() + GIVE_UP_S
        while not self._answers():
            said = (self.folder / "log").read_text(errors="replace")[-2000:]
            assert self._process.poll() is None, f"postgres has ended: {said}"
            assert time.monotonic() < until, f"postgres does not answer: {said}"
            time.sleep(0.1)

    def _answers(self) -> bool:
        try:
            psycopg.connect(self.url("postgres"), connect_timeout=5).close()
        except psycopg.OperationalError:
            return False
        return True

    def stop(self) -> None:
        """End it, at once for those who are connected. Safe to call twice."""
        if self._process is None:
            return
        self._process.send_signal(signal.SIGINT)
        try:
            self._process.wait(STOP_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._process = None

    def url(self, database: str) -> str:
        """Of one of its databases."""
        return f"postgresql://motionloop@/{database}?host={self.folder}"

    def new_database(self) -> str:
        """The URL of an empty one."""
        self._databases += 1
        name = f"test{self._databases}"
        with psycopg.connect(self.url("postgres"), autocommit=True) as connection:
            connection.execute(f"CREATE DATABASE {name}".encode())
        return self.url(name)

    def _run(self, program: str, *arguments: str) -> None:
        done = subprocess.run(
            [str(self._bin / program), *arguments], capture_output=True, text=True, cwd="/", check=False, **self._who
        )
        assert done.returncode == 0, f"{program}: {done.stderr}"
