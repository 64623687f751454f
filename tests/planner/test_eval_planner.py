"""`motionloop eval planner`: the whole command on a small corpus, its suites' rules by hand, recorded episodes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import planner_service.dip.planner as dip_planner
import planner_service.training.evaluate as command
from planner_service.builtin.stand import StandPlanner
from planner_service.dip.config import preset
from planner_service.dip.features_torch import Normalizer
from planner_service.dip.network import DipNetwork
from planner_service.dip.weights import save_weights
from planner_service.training.dataset import load_material
from planner_service.training.evaluate_quality import within_bounds
from planner_service.training.evaluate_recorded import judged_recorded, read_recorded
from planner_service.training.evaluate_retrieval import Heldout, continued, retrieval
from planner_service.training.evaluate_suites import PROMPTS, SWITCHES, Prompt, switch_pairs, troubles
from planner_service.training.evaluate_sweep import VARIANTS, sweep
from planner_service.training.evaluator.network import EvaluatorConfig, EvaluatorNetwork
from planner_service.training.evaluator.weights import Evaluator, save_evaluator
from shared.data.corpus import ClipInfo, Corpus, write_corpus
from shared.errors import InvalidInputError
from shared.motion.ik import standing_clip
from shared.motion.skeleton import CANONICAL
from tests.planner.dip_helpers import HashEncoder, moving_body

STANDING = standing_clip(1, 20).positions_w_m
KINDS = {"walk": "a person walks", "run": "a person runs", "turn": "turn left", "stand": "stand still"}


def write_heldout_corpus(folder: Path) -> Path:
    """Two held-out clips of each of four kinds, one more of each to train on."""
    clips = []
    for number, (kind, text) in enumerate(sorted(KINDS.items()) * 3):
        speed, rate = {"walk": (1.0, 0.0), "run": (2.5, 0.0), "turn": (0.1, 1.0), "stand": (0.0, 0.0)}[kind]
        motion = moving_body(120 + 30 * (number % 2), 30.0, speed, rate, number / 12)
        heldout = number < 8
        info = ClipInfo(
            name=f"clip{number}", take=f"take{number}", source="made", behaviour=kind, action=kind, texts=(text,),
            split="heldout" if heldout else "train", made=True, mirrored=False, start=0, frames=len(motion),
            weight=0.0 if heldout else 0.25,
        )  # fmt: skip
        clips.append((info, motion.astype(np.float32)))
    write_corpus(folder, clips, {"format": 1})
    return folder


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A corpus, weights of a planner that was never trained, and an evaluator that was not either."""
    folder = tmp_path_factory.mktemp("eval")
    torch.manual_seed(0)
    plain = Normalizer(torch.zeros(263), torch.full((263,), 0.1))
    save_weights(folder / "dip.safetensors", DipNetwork(preset("tiny")), plain, {})
    config = EvaluatorConfig(width=16, heads=2, ff=32, motion_layers=1, text_layers=1, embedding=8)
    save_evaluator(folder / "judge.safetensors", EvaluatorNetwork(config), plain, {})
    corpus = write_heldout_corpus(folder / "corpus")
    return {"corpus": corpus, "weights": folder / "dip.safetensors", "evaluator": folder / "judge.safetensors"}


@pytest.fixture
def plain_words(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(command, "minilm", HashEncoder)
    monkeypatch.setattr(dip_planner, "minilm", HashEncoder)


@pytest.fixture
def judge(files: dict[str, Path]) -> Evaluator:
    return command.load_evaluator(HashEncoder(), files["evaluator"])


@pytest.fixture
def heldout(files: dict[str, Path], judge: Evaluator) -> Heldout:
    return Heldout.of(load_material(Corpus.load(files["corpus"]), "heldout", 60), judge, 20, 1)


SMALL: dict[str, Any] = {"windows": 7, "reaches": 1, "repeats": 1, "pairs": 8, "threads": 1, "seed": 1}


def run(files: dict[str, Path], out: Path, **options: Any) -> dict[str, Any]:
    command.evaluate(**{**files, **SMALL, "json_file": out, **options})
    return dict(json.loads(out.read_text()))


@pytest.mark.usefixtures("plain_words")
def test_the_suite_quality_has_every_field_and_repeats(files: dict[str, Path], tmp_path: Path) -> None:
    first = run(files, tmp_path / "a.json", report=tmp_path / "r.html")
    for name in ("fid", "diversity", "multimodal_distance", "target_error_m", "heading_error_deg", "penetration_mm",
                 "floating_mm", "skating_mm", "jerk", "seconds", "weights_sha256"):  # fmt: skip
        assert first[name] is not None
    assert first["pool"] == 4 and first["motions"] == 8
    assert first["chance"]["r_precision"] == [0.25, 0.5, 0.75]
    for name in ("r_precision", "paraphrase_r_precision", "paraphrase_training_r_precision"):
        assert len(first[name]) == 3 and first[name] == sorted(first[name])
    assert set(first["ground_truth"]) >= {
        "r_precision",
        "fid",
        "diversity",
        "multimodal_distance",
        "skating_mm",
        "jerk",
    }
    page = (tmp_path / "r.html").read_text()
    assert page.count("data:image/png;base64,") >= 3 and "ground truth" in page
    again = run(files, tmp_path / "b.json")
    varying = ("seconds", "command")
    assert {k: v for k, v in again.items() if k not in varying} == {k: v for k, v in first.items() if k not in varying}


@pytest.mark.usefixtures("plain_words")
def test_suites_run_from_the_command_line(files: dict[str, Path], tmp_path: Path) -> None:
    result = run(
        files, tmp_path / "s.json", suite="rollouts,switches", seconds=6, changes=6, report=tmp_path / "s.html"
    )
    assert result["rollouts"]["rollouts"] == len(PROMPTS) == len(result["rollouts"]["rows"]) == 20
    assert result["switches"]["switches"] == 6 == len(result["switches"]["rows"])
    assert "r_precision" not in result
    assert "Switches" in (tmp_path / "s.html").read_text()
    with pytest.raises(InvalidInputError) as caught:
        run(files, tmp_path / "s.json", suite="nothing")
    assert caught.value.field == "suite"


@pytest.mark.usefixtures("plain_words")
def test_switches_can_be_looked_at(files: dict[str, Path], tmp_path: Path) -> None:
    options = {"suite": "switches", "changes": 2, "sheet": tmp_path / "s.png"}
    rows = [run(files, tmp_path / f"{seed}.json", **options, seed=seed)["switches"]["rows"] for seed in (1, 2)]
    assert rows[0] != rows[1], "another seed draws other switches"
    assert (tmp_path / "s.png").stat().st_size > 1000


@pytest.mark.usefixtures("plain_words")
def test_held_out_texts_can_be_written_down(files: dict[str, Path], tmp_path: Path) -> None:
    run(files, tmp_path / "w.json", write_texts=tmp_path / "texts.tsv")
    lines = (tmp_path / "texts.tsv").read_text().splitlines()
    assert len(lines) == 8
    assert all(line.startswith("other\t") and line[6:] in KINDS.values() for line in lines)


def test_who_goes_on_as_recorded_scores_as_recorded(heldout: Heldout) -> None:
    assert retrieval(heldout, heldout.motion)["fid"] < 1e-9
    rows = [0, 3]
    whole, part = retrieval(heldout, heldout.motion), retrieval(heldout, heldout.motion[rows], rows)
    assert part["multimodal_distance"] != whole["multimodal_distance"]


def test_continuations_begin_with_their_prefix_and_are_as_long_as_the_recording(heldout: Heldout) -> None:
    motions = continued(StandPlanner(), heldout, [0, 5], ["stand still"] * 2, 0)
    for row, motion in zip((0, 5), motions, strict=True):
        np.testing.assert_array_equal(motion[:20], heldout.truth[row][:20])
        assert len(motion) == len(heldout.truth[row])


@pytest.mark.usefixtures("plain_words")
def test_a_sweep_begins_with_what_is_shipped(files: dict[str, Path], judge: Evaluator, heldout: Heldout) -> None:
    moved: list[int] = []
    rows = sweep(files["weights"], "steps", judge, heldout, 1, lambda label, total: moved.append)
    wanted = [*VARIANTS["shipped"], *VARIANTS["steps"]]
    assert [row["variant"] for row in rows] == wanted
    assert sum(moved) == len(wanted) * len(heldout.texts)
    found = {json.dumps([row["fid"], row["jerk"]]) for row in rows}
    assert len(found) == len(rows) - 1, "every setting changes something, but the steps that are taken anyway"
    with pytest.raises(InvalidInputError):
        sweep(files["weights"], "colour", judge, heldout, 1, lambda label, total: moved.append)


def still(seconds: float) -> np.ndarray:
    return np.repeat(STANDING, round(seconds * 20), 0)


def alive(seconds: float) -> np.ndarray:
    """Standing, a hand swinging by 10 cm."""
    motion = still(seconds)
    motion[:, CANONICAL.index("left_wrist"), 0] += 0.1 * np.sin(np.arange(len(motion)) / 3)
    return motion


def test_troubles_of_rollouts() -> None:
    prompt = Prompt("dance")
    assert troubles(alive(12), prompt) == {}
    assert troubles(still(12), prompt) == {"froze": 0.0}
    assert troubles(still(12), Prompt("stand", moving=False)) == {}
    late = np.concatenate([alive(6), still(6)])
    assert 5.0 <= troubles(late, prompt)["froze"] <= 6.0
    sinking = alive(12) - np.linspace(0, 0.2, 240)[:, None, None] * [0, 0, 1.0]
    assert 2.0 < troubles(sinking, prompt)["drifted"] < 4.0
    assert "drifted" in troubles(alive(12) + [0, 0, 0.3], prompt)
    low = alive(12)
    low[120:, CANONICAL.index("head"), 2] = 0.9
    assert troubles(low, prompt)["drifted"] == 6.0
    assert troubles(low, Prompt("squat", upright=False)) == {}
    jumping = alive(12)
    jumping[100:] += [1.0, 0, 0]
    assert troubles(jumping, prompt) == {"exploded": 99 / 20}
    broken = alive(12)
    broken[40, 3, 1] = np.nan
    assert troubles(broken, prompt) == {"exploded": 2.0}


def test_switches_go_to_every_kind_and_only_what_moves_is_stopped() -> None:
    pairs = switch_pairs(100, 3)
    assert len(pairs) == 100 and pairs == switch_pairs(100, 3) != switch_pairs(100, 4)
    assert {to for _, to in pairs} == set(SWITCHES)
    assert all(one != other for one, other in pairs)
    assert {one for one, other in pairs if other == "stand"} <= {"walk", "run"}


def test_bounds_are_the_larger_of_five_millimetres_and_a_third_more() -> None:
    truth = {"penetration_mm": 0.1, "floating_mm": 10.0, "skating_mm": 10.0}
    made = {"penetration_mm": 4.9, "floating_mm": 12.9, "skating_mm": 13.1}
    assert within_bounds(made, truth) == {"penetration_mm": True, "floating_mm": True, "skating_mm": False}


def test_recorded_episodes_are_read_by_sentence(tmp_path: Path) -> None:
    motion = moving_body(240, 30.0)
    np.savez(tmp_path / "b.npz", body_pos_w_m=motion, fps=30.0)
    (tmp_path / "b.txt").write_text("0\ta person walks\n3.0\tstand still\n7.5\ttoo short\n")
    np.savez(tmp_path / "a.npz", body_pos_w_m=motion[:90], fps=30.0, text="turn left")
    told = read_recorded(tmp_path)
    assert [(one.text, len(one.positions_w_m)) for one in told] == [
        ("turn left", 60), ("a person walks", 60), ("stand still", 90)
    ]  # fmt: skip
    np.testing.assert_allclose(told[1].positions_w_m[::2], motion[:90:3], atol=1e-9)
    (tmp_path / "b.txt").write_text("no number\n")
    with pytest.raises(InvalidInputError):
        read_recorded(tmp_path)
    with pytest.raises(InvalidInputError):
        read_recorded(tmp_path / "nothing")


def test_the_table_judges_recordings_beside_the_planner_alone(
    heldout: Heldout, judge: Evaluator, tmp_path: Path
) -> None:
    for number, text in enumerate(KINDS.values()):
        np.savez(tmp_path / f"{number}.npz", body_pos_w_m=moving_body(150, 30.0, 1.0 - number / 4), fps=30.0, text=text)
    table = judged_recorded(judge, heldout, read_recorded(tmp_path), StandPlanner(), 1)
    assert table["stretches"] == 4
    columns = [table[name] for name in ("ground_truth", "dip_alone", "closed_loop")]
    assert set(columns[0]) == set(columns[1]) == set(columns[2])
    assert columns[1]["jerk"] < columns[2]["jerk"], "who stands jerks less than who sways"
