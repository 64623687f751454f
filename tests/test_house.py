"""The repository's own promises: light client, rates named once, short files, no recorded motion, licence."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

REPO = Path(__file__).resolve().parent.parent
PACKAGES = ("shared", "planner_service", "tracker_service", "orchestrator", "motionloop")

HEAVY = ("torch", "mujoco", "fastapi", "uvicorn", "scipy", "transformers", "matplotlib", "pydantic_settings")
BLOCK = f"""
import sys
class Block:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {HEAVY!r}:
            raise ImportError(name + " is not part of the light client")
sys.meta_path.insert(0, Block())
"""


def _tracked() -> list[Path]:
    found = subprocess.run(["git", "ls-files"], cwd=REPO, capture_output=True, text=True, check=False)
    if found.returncode:
        pytest.skip("not a git checkout")
    return [REPO / name for name in found.stdout.splitlines() if (REPO / name).is_file()]


@pytest.mark.parametrize("module", ["motionloop", "motionloop.cli", "orchestrator.client", "shared.protocol.client"])
def test_the_light_client_needs_nothing_heavy(module: str) -> None:
    done = subprocess.run(
        [sys.executable, "-c", f"{BLOCK}\nimport {module}"], cwd=REPO, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


def test_every_package_is_typed_and_shipped() -> None:
    include = tomllib.loads((REPO / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"]["find"]["include"]
    for package in PACKAGES:
        assert f"{package}*" in include
        assert (REPO / package / "py.typed").is_file()
        for folder in {path.parent for path in (REPO / package).rglob("*.py")}:
            assert (folder / "__init__.py").is_file(), f"{folder} would not be in the wheel"


def test_extras_that_are_named_exist() -> None:
    """pip passes over an extra that is not there with a warning that nobody reads."""
    project = tomllib.loads((REPO / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    named = {name for needs in extras.values() for need in needs for name in re.findall(r"^motionloop\[(.*)\]", need)}
    for page in [REPO / "README.md", *(REPO / "docs").glob("*.md")]:
        named |= set(re.findall(r"(?:'\.|motionloop)\[([a-z,]+)\]", page.read_text(encoding="utf-8")))
    missing = {extra for names in named for extra in names.split(",")} - set(extras)
    assert {"fast", "all"} <= set(extras) and not missing


def test_no_recorded_motion_is_committed() -> None:
    """NOTICE: loaders and trained weights, never the recordings; and no file over 20 MB."""
    for path in _tracked():
        assert path.suffix.lower() not in {".amc", ".asf", ".c3d", ".xz"}, path
        assert path.stat().st_size <= 20 * 2**20, path


def test_no_code_reaches_outside_the_checkout() -> None:
    needle = "../" + "shared"
    for path in _tracked():
        if path.suffix in {".py", ".toml", ".yml"} or path.name == "Makefile":
            assert needle not in path.read_text(encoding="utf-8"), path


def test_the_licence_is_apache_and_the_notice_names_every_source() -> None:
    assert "Apache License" in (REPO / "LICENSE").read_text()
    notice = (REPO / "NOTICE").read_text()
    for name in ("mocap.cs.cmu.edu", "EIA-0196217", "HDM05", "CC BY-SA 3.0", "DeepMimic", "ASAP", "MiniLM"):
        assert name in notice


def test_no_file_is_longer_than_400_lines() -> None:
    sources = [path for path in _tracked() if path.suffix in {".py", ".js", ".css"}]
    assert len(sources) > 100
    long = {str(path.relative_to(REPO)): n for path in sources if (n := len(path.read_text().splitlines())) > 400}
    assert not long


def test_rates_are_named_in_one_module() -> None:
    """`FPS = 30` anywhere else would go its own way when the rate is changed."""
    own = {"shared/motion/io/options.py: ASSUMED_HZ", "orchestrator/cli/watch.py: DRAWN_HZ"}
    found = set()
    for path in _tracked():
        name = str(path.relative_to(REPO))
        if path.suffix == ".py" and name.startswith(PACKAGES) and name != "shared/protocol/rates.py":
            for node in ast.parse(path.read_text(encoding="utf-8")).body:
                if isinstance(node, ast.Assign) and isinstance(node.value, ast.Constant):
                    targets = [target.id for target in node.targets if isinstance(target, ast.Name)]
                    found |= {f"{name}: {target}" for target in targets if target.endswith(("FPS", "_HZ"))}
    assert found == own
