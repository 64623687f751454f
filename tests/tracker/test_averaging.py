"""Actors of one training as one: the mean of the weights, and only of networks that see alike."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import load_file, save_file

from shared.errors import InvalidInputError
from tracker_service.training.averaging import averaged


def actor(path: Path, weight: float, mean: float = 0.5, hidden: int = 3) -> Path:
    tensors = {"mean": np.full(2, mean, np.float32), "std": np.ones(2, np.float32)}
    tensors |= {"w0": np.full((hidden, 2), weight, np.float16), "b0": np.zeros(hidden, np.float16)}
    save_file(tensors, str(path))
    path.with_suffix(".json").write_text(json.dumps({"version": path.stem, "layers": 1}))
    path.with_name(f"{path.stem}_training.safetensors").write_bytes(path.stem.encode())
    return path


def test_the_mean_keeps_the_newest_card_and_what_training_goes_on_from(tmp_path: Path) -> None:
    old, new = actor(tmp_path / "old.safetensors", 1.0), actor(tmp_path / "new.safetensors", 3.0)
    out = averaged({old: 0.25, new: 0.75}, tmp_path / "out" / "learned.safetensors", {"samples": 7})
    made = load_file(out)
    np.testing.assert_array_equal(made["w0"], np.full((3, 2), 2.5, np.float16))
    np.testing.assert_array_equal(made["mean"], [0.5, 0.5])
    assert {t.dtype for t in made.values()} == {np.dtype(np.float16), np.dtype(np.float32)}
    card = json.loads(out.with_suffix(".json").read_text())
    assert (card["layers"], card["samples"]) == (1, 7) and card["version"] not in ("old", "new")
    assert (out.parent / "learned_training.safetensors").read_bytes() == b"new"


def test_what_is_not_of_one_training_is_refused(tmp_path: Path) -> None:
    old = actor(tmp_path / "old.safetensors", 1.0)
    other = {
        "wide": actor(tmp_path / "wide.safetensors", 1.0, hidden=4),
        "blind": actor(tmp_path / "b.safetensors", 1.0, 0.6),
    }
    for path in other.values():
        with pytest.raises(InvalidInputError):
            averaged({old: 0.5, path: 0.5}, tmp_path / "out.safetensors", {})
    with pytest.raises(InvalidInputError, match="shares"):
        averaged({old: 0.5}, tmp_path / "out.safetensors", {})
