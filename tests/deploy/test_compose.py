"""What the compose file and its images promise, as far as that can be told without a container engine."""

from __future__ import annotations

import subprocess
from pathlib import Path

import psutil
import yaml

REPO = Path(__file__).resolve().parents[2]
START = REPO / "docker" / "start.sh"


def test_no_service_depends_on_another_lest_podman_never_start_it_again() -> None:
    services = yaml.safe_load((REPO / "docker-compose.yml").read_text())["services"]
    lasting = {name: each for name, each in services.items() if each["restart"] != "no"}
    assert set(lasting) == {"planner", "tracker", "orchestrator"}
    assert not [name for name, each in lasting.items() if "depends_on" in each]


def test_every_image_starts_by_the_script_that_is_let_into_the_build() -> None:
    ignored = (REPO / ".dockerignore").read_text().splitlines()
    assert f"!{START.relative_to(REPO)}" in ignored
    for name in ("planner", "tracker", "orchestrator"):
        lines = (REPO / "docker" / f"Dockerfile.{name}").read_text().splitlines()
        assert "COPY docker/start.sh /usr/local/bin/start-with-keys" in lines
        assert 'ENTRYPOINT ["start-with-keys"]' in lines


def begun(folder: Path | None) -> subprocess.Popen[str]:
    environment = {"PATH": "/usr/bin:/bin", **({} if folder is None else {"MOTIONLOOP_CURVE_DIR": str(folder)})}
    return subprocess.Popen([str(START), "echo", "served"], env=environment, stdout=subprocess.PIPE, text=True)


def test_a_service_without_keys_starts_at_once() -> None:
    assert begun(None).communicate(timeout=60.0)[0] == "served\n"


def waits(service: subprocess.Popen[str]) -> bool:
    """Whether it has come to where it sleeps between two looks."""
    while service.poll() is None:
        if psutil.Process(service.pid).children():
            return True
    return False


def test_a_service_waits_until_all_its_keys_are_there(tmp_path: Path) -> None:
    for name in ("server.key", "server.key_secret"):
        (tmp_path / name).touch()
    service = begun(tmp_path)
    assert waits(service)
    (tmp_path / "client.key").touch()
    assert service.communicate(timeout=60.0)[0] == "served\n"


def test_a_service_that_waits_for_keys_ends_when_told(tmp_path: Path) -> None:
    service = begun(tmp_path)
    assert waits(service)
    service.terminate()
    assert service.communicate(timeout=60.0)[0] == ""
    assert service.returncode == 0
