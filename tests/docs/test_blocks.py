"""Every code block of README and docs is run against real services, read by a parser, or says why not."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from orchestrator.client import Client
from orchestrator.core.episode_spec import EpisodeSpec
from shared.scenes.schema import Scene
from tests.docs.blocks import PAGES, REPO, blocks_of, pages_with, script
from tests.docs.conftest import Served

GIVE_UP_S = 400  # far above what a page takes; many commands are started, on a machine that may be busy
RUN = {"python", "sh"}
READ = {"json", "yaml", "toml"}
SHOWN = {"mermaid", "text"}


def page_id(page: Path) -> str:
    return page.stem


def run(command: list[str], served: Served, folder: Path) -> subprocess.CompletedProcess[str]:
    done = subprocess.run(
        command, cwd=folder, env=served.environment, capture_output=True, text=True, timeout=GIVE_UP_S, check=False
    )
    assert done.returncode == 0, f"{done.stdout[-3000:]}\n{done.stderr[-3000:]}"
    return done


@pytest.fixture
def server(served: Served) -> Iterator[Served]:
    """Whatever a page does, the next one finds the usual plug-ins and no characters."""
    yield served
    with Client(served.url) as client:
        for character in client.characters:
            character.close()
        client.swap("planner", "stand")
        client.swap("tracker", "kinematic")


@pytest.mark.timeout(GIVE_UP_S + 20)
@pytest.mark.parametrize("page", pages_with("python"), ids=page_id)
def test_the_python_of_a_page_runs(page: Path, server: Served, tmp_path: Path) -> None:
    file = tmp_path / "page.py"
    file.write_text(server.localised(script(page, "python")))
    run([sys.executable, str(file)], server, tmp_path)


@pytest.mark.timeout(GIVE_UP_S + 20)
@pytest.mark.parametrize("page", pages_with("sh"), ids=page_id)
def test_the_shell_of_a_page_runs(page: Path, server: Served, tmp_path: Path) -> None:
    run(["bash", "-euo", "pipefail", "-c", server.localised(script(page, "sh"))], server, tmp_path)


def test_the_error_in_the_http_guide_is_what_the_server_says(served: Served, tmp_path: Path) -> None:
    guide = REPO / "docs" / "http.md"
    asked = next(block.code for block in blocks_of(guide) if '"pacing": "slow"' in block.code)
    said = run(["bash", "-c", f"URL={served.url}\n{asked}"], served, tmp_path).stdout
    written = next(json.loads(block.code) for block in blocks_of(guide) if block.language == "json")
    assert json.loads(said) == written


@pytest.mark.parametrize("page", PAGES, ids=page_id)
def test_every_other_block_is_read_or_says_why_it_is_not_run(page: Path) -> None:
    targets = set(re.findall(r"^([a-z-]+):", (REPO / "Makefile").read_text(), re.M))
    for block in blocks_of(page):
        assert block.language in RUN | READ | SHOWN, f"{block.place}: what language is {block.language!r}?"
        if block.language == "json":
            json.loads(block.code)
        elif block.language == "yaml":
            data = yaml.safe_load(block.code)
            (Scene if "bodies" in data else EpisodeSpec).model_validate(data)
        elif block.language == "toml":
            assert tomllib.loads(block.code), block.place
        elif block.why is not None:
            sys.stdout.write(f"{block.place} is not run: {block.why}\n")
            named = re.findall(r"^(?:.*&& )?make ([a-z-]+)", block.code, re.M)
            assert set(named) <= targets, f"{block.place}: no such target"


def test_the_code_of_the_guides_is_that_of_the_examples() -> None:
    """The pages leave comments and docstrings out; what runs is the same."""
    for page, example in (("writing_a_planner", "glide_planner"), ("writing_a_tracker", "ahead_tracker")):
        shown = (REPO / "docs" / f"{page}.md").read_text()
        code = (REPO / "examples" / example / f"{example}.py").read_text()
        body = code[
            code.index("    def _plan" if "planner" in page else "        targets = []") : code.index("def make_")
        ]
        for line in body.splitlines():
            bare = line.split("  # ")[0].strip()
            if bare and not bare.startswith(("#", '"""')):
                assert bare in shown, f"docs/{page}.md lacks: {bare}"


def test_the_blocks_are_found(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(
        "text\n\n```sh\necho 1\n```\n\n<!-- not run: it is long -->\n```sh\nmake demo\n```\n```json\n{}\n```\n"
    )
    found = blocks_of(page)
    assert [(block.language, block.code, block.why) for block in found] == [
        ("sh", "echo 1\n", None),
        ("sh", "make demo\n", "it is long"),
        ("json", "{}\n", None),
    ]
    assert found[1].line == 8
