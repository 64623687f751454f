"""The documents as a site, without a warning and without anything from another host."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest
import yaml

from tests.docs.blocks import REPO


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("site")
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(out)],
        cwd=REPO, env={**os.environ, "NO_MKDOCS_2_WARNING": "1"}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return out


def test_the_site_is_built_without_a_warning(site: Path) -> None:
    """`--strict` turns broken links, missing pages and pages that are in no menu into errors."""
    for page in (REPO / "docs").glob("*.md"):
        assert (site / page.with_suffix(".html").name).is_file()
    assert (site / "images" / "loop.svg").is_file()


def test_the_site_loads_nothing_from_other_hosts(site: Path) -> None:
    loading = re.compile(r"<(?:script|link|img|iframe)[^>]+?(?:src|href)=[\"']?(https?://[^\"'> ]+)")
    for page in site.glob("*.html"):
        assert loading.findall(page.read_text()) == [], page.name


def test_the_pictures_are_ours_and_small() -> None:
    for picture in (REPO / "docs" / "images").iterdir():
        assert picture.stat().st_size <= 2_000_000, picture.name
        if picture.suffix == ".svg":
            assert ElementTree.parse(picture).getroot().get("aria-label")
    assert (REPO / "docs" / "images" / "demo.gif").read_bytes()[:6] == b"GIF89a"


def test_the_links_of_the_readme_lead_somewhere() -> None:
    for link in re.findall(r"\]\((?!https?://|#)([^)#]+)", (REPO / "README.md").read_text()):
        assert (REPO / link).exists(), link


def test_the_menu_has_every_page_once() -> None:
    menu = yaml.safe_load((REPO / "mkdocs.yml").read_text())["nav"]

    def names(entry: object) -> list[str]:
        if isinstance(entry, str):
            return [entry]
        parts = entry.values() if isinstance(entry, dict) else entry
        return [name for part in parts for name in names(part)]  # type: ignore[attr-defined]

    assert sorted(names(menu)) == sorted(page.name for page in (REPO / "docs").glob("*.md"))
