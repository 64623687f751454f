"""The plain install: client and command line without the server's packages."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

REPO = Path(__file__).resolve().parent.parent.parent
BLOCKED = (
    "torch", "mujoco", "fastapi", "starlette", "uvicorn", "scipy", "psutil", "prometheus_client", "safetensors",
    "tokenizers", "transformers", "matplotlib", "pydantic_settings", "PIL", "imageio_ffmpeg", "tensorboard",
)  # fmt: skip
WITHOUT = f"""
import sys
class Block:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {BLOCKED!r}:
            raise ModuleNotFoundError(name + " is blocked", name=name)
sys.meta_path.insert(0, Block())
from orchestrator.cli.main import main
sys.argv = ["motionloop", *sys.argv[1:]]
main()
"""


@pytest.mark.parametrize(
    ("arguments", "code", "says"),
    [
        (["say", "walk"], 1, "no server"),
        (["watch"], 1, "motionloop serve all"),
        (["episode", "examples/tour.yaml"], 1, "no server"),
        (["eval", "tasks"], 2, "motionloop[all]"),
        (["bench", "loop"], 2, "motionloop[all]"),
        (["--help"], 0, "conformance"),
    ],
)
def test_the_command_line_works_without_the_servers_packages(arguments: list[str], code: int, says: str) -> None:
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT, *arguments], cwd=REPO, capture_output=True, text=True, check=False,
        env={**os.environ, "MOTIONLOOP_URL": "http://127.0.0.1:1"},
    )  # fmt: skip
    assert done.returncode == code, done.stderr
    assert says in done.stdout + done.stderr


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_the_wheel_alone_gives_the_client(tmp_path: Path) -> None:
    """Built, installed into an empty environment without extras (needs a package index), and called.

    Without PYTHONPATH: on it the checkout would be found, by pip as installed already and by Python before the wheel.
    """
    alone = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    wheels = tmp_path / "wheels"
    pip = [sys.executable, "-m", "pip", "-q", "--disable-pip-version-check"]
    subprocess.run([*pip, "wheel", str(REPO), "--no-deps", "-w", str(wheels)], check=True, env=alone)
    (wheel,) = wheels.glob("*.whl")
    assert wheel.stat().st_size < 40 * 2**20
    subprocess.run([sys.executable, "-m", "venv", str(tmp_path / "env")], check=True, env=alone)
    python = tmp_path / "env" / "bin" / "python"
    install = [python, "-m", "pip", "-q", "install", str(wheel), "-c", str(REPO / "constraints.txt")]
    subprocess.run(install, check=True, env=alone)
    list_all = [python, "-m", "pip", "list"]
    listed = subprocess.run(list_all, capture_output=True, text=True, check=True, env=alone).stdout.lower()
    assert "\nmotionloop " in listed
    for package in ("torch", "mujoco", "fastapi", "uvicorn", "scipy"):
        assert f"\n{package} " not in listed
    use = "from motionloop import AsyncClient, Client; print(Client().address.url)"
    done = subprocess.run([python, "-c", use], cwd=tmp_path, capture_output=True, text=True, check=False, env=alone)
    assert done.stdout.startswith("http://"), done.stderr
    said = subprocess.run(
        [tmp_path / "env" / "bin" / "motionloop", "say", "walk", "--url", "http://127.0.0.1:1"],
        cwd=tmp_path, capture_output=True, text=True, check=False, env=alone,
    )  # fmt: skip
    assert (said.returncode, "no server" in said.stderr) == (1, True), said.stderr
