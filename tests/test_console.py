"""Expected errors are one sentence at the command line, in whatever command they happen."""

from __future__ import annotations

import json
import subprocess
import sys
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

import pytest
from pydantic import BaseModel
from typer.testing import CliRunner

from orchestrator.cli import main as cli
from shared.console import check_output_file, errors_for_people, in_words
from shared.errors import InvalidInputError


class _Model(BaseModel):
    fps: int


def _undecodable(folder: Path) -> None:
    (folder / "x").write_bytes(b"\xff\xfe\xfa")
    (folder / "x").read_text(encoding="utf-8")


def _no_zip(folder: Path) -> None:
    (folder / "x").write_bytes(b"nothing")
    zipfile.ZipFile(folder / "x")


CASES: dict[str, tuple[Callable[[Path], object], str]] = {
    "missing": (lambda folder: (folder / "no").read_text(), "no: there is no such file or folder"),
    "a folder": (lambda folder: folder.read_text(), "it is a folder where a file is needed"),
    "a file in the way": (lambda folder: (folder / "file").mkdir(exist_ok=True), "a file where a folder is needed"),
    "below a file": (lambda folder: (folder / "file" / "x").mkdir(parents=True), "a part of the path is a file"),
    "not text": (_undecodable, "text that cannot be decoded"),
    "not json": (lambda folder: json.loads("{"), "not JSON"),
    "not a zip": (_no_zip, "cut off or broken"),
    "not deflated": (lambda folder: zlib.decompress(b"xx"), "cut off or broken"),
    "not a number": (lambda folder: _Model.model_validate({"fps": "x"}), "invalid_input in fps: "),
}


@pytest.mark.parametrize("name", CASES)
def test_expected_errors_are_one_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str) -> None:
    fail, sentence = CASES[name]
    (tmp_path / "file").write_text("x")
    with pytest.raises(SystemExit) as end, errors_for_people():
        fail(tmp_path)
    assert end.value.code == 1
    said = capsys.readouterr().err
    assert sentence in said and said.count("\n") == 1


def test_a_message_of_several_lines_becomes_one() -> None:
    assert in_words(InvalidInputError("not YAML:\n  line 3\n    ^")) == "invalid_input: not YAML: line 3 ^"


def test_faults_of_the_program_stay_faults() -> None:
    with pytest.raises(ZeroDivisionError), errors_for_people():
        _ = 1 / 0


def test_our_own_errors_keep_their_field_and_what_is_allowed() -> None:
    assert in_words(InvalidInputError("no", field="fps", allowed="5-1000")) == (
        "invalid_input in fps: no\n  allowed: 5-1000"
    )


def test_a_folder_for_a_result_is_made(tmp_path: Path) -> None:
    check_output_file(tmp_path / "a" / "b" / "result.json")
    assert (tmp_path / "a" / "b").is_dir()
    check_output_file(None)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("demo", "--out", "{file}/below"), "a part of the path is a file"),
        (("conformance", "nonsense"), "no address of a service"),
        (("data", "import", "{file}", "{file}/below"), "a part of the path is a file"),
        (("data", "build", "{folder}", "{file}/below"), "there is a file where a folder is needed"),
    ],
)
def test_commands_tell_it_in_a_sentence(tmp_path: Path, arguments: tuple[str, ...], sentence: str) -> None:
    (tmp_path / "file.bvh").write_text("HIERARCHY\n")
    filled = [a.format(file=tmp_path / "file.bvh", folder=tmp_path) for a in arguments]
    shown = CliRunner().invoke(cli.app, filled)
    assert shown.exit_code == 1
    assert sentence in shown.output and "Traceback" not in shown.output


@pytest.mark.parametrize(
    ("fails", "sentence"), [("open({path!r}, 'w')", "a part of the path is a file"), ("1 / 0", "")]
)
def test_what_no_command_tells_is_told_by_the_program(tmp_path: Path, fails: str, sentence: str) -> None:
    """An error of a path in a command that does not catch it is a sentence; a fault of the program is not hidden."""
    (tmp_path / "file").write_text("x")
    code = (
        "from orchestrator.cli import main\n"
        "@main.app.command('late')\n"
        f"def late() -> None: {fails.format(path=str(tmp_path / 'file' / 'x'))}\n"
        "main.main()"
    )
    done = subprocess.run([sys.executable, "-c", code, "late"], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 1
    assert ("Traceback" in done.stderr) == (not sentence)
    assert sentence in done.stderr
