"""One server for everything the documents say, with the examples as installed packages."""

from __future__ import annotations

import os
import shutil
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from orchestrator.core.supervise import Stack
from tests.orchestrator.support import light
from tests.planner_service.motion import write_library

REPO = Path(__file__).resolve().parent.parent.parent
EXAMPLES = ("glide_planner", "own_rate", "ahead_tracker", "touch_task")


def install(example: Path, site: Path) -> None:
    """What pip would leave of an example in site-packages: its modules, its metadata and its entry points."""
    about = tomllib.loads((example / "pyproject.toml").read_text())
    for module in about["tool"]["setuptools"]["py-modules"]:
        shutil.copy(example / f"{module}.py", site)
    project = about["project"]
    folder = site / f"{project['name'].replace('-', '_')}-{project['version']}.dist-info"
    folder.mkdir(parents=True)
    metadata = f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n"
    (folder / "METADATA").write_text(metadata)
    lines = []
    for group, entries in project["entry-points"].items():
        lines += [f"[{group}]", *(f"{name} = {target}" for name, target in entries.items())]
    (folder / "entry_points.txt").write_text("\n".join(lines) + "\n")


@dataclass(frozen=True)
class Served:
    """The addresses of what runs, and the environment of a reader's terminal."""

    url: str
    planner: str
    tracker: str
    environment: dict[str, str]

    def localised(self, text: str) -> str:
        """A block of a document with the addresses of these services in place of the default ones."""
        for written, real in (
            ("http://127.0.0.1:8080", self.url),
            ("tcp://127.0.0.1:5601", self.planner),
            ("tcp://127.0.0.1:5602", self.tracker),
        ):
            text = text.replace(written, real)
        return text


@pytest.fixture(scope="session")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """Planner `stand` (with `clip` and the examples), tracker `kinematic` (`pd`, `ahead`, `learned` if it loads)."""
    site = tmp_path_factory.mktemp("site")
    for name in EXAMPLES:
        install(REPO / "examples" / name, site)
    library = write_library(tmp_path_factory.mktemp("library"))
    path = os.pathsep.join([str(site), str(REPO)])
    options = light(tmp_path_factory.mktemp("data"), library)
    options = replace(options, planner_args=("--plugins", "stand,clip,glide,drift,sway", *options.planner_args[2:]))
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", path)
        with Stack(options) as stack:
            environment = {
                **os.environ,
                "MOTIONLOOP_URL": stack.url,
                "PATH": os.pathsep.join([str(REPO / ".venv" / "bin"), os.environ["PATH"]]),
            }
            yield Served(stack.url, stack.planner.address, stack.tracker.address, environment)
