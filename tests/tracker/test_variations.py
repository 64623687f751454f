"""Runs are played backwards and bent into curves; what is too fast, too short or no run is left alone."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from shared.motion.ik import standing_clip
from tracker_service.training.variations import LEAST_FRAMES, backwards, speed_mps, variations

FPS = 30.0


def going(frames: int, mps: float) -> np.ndarray:
    """(T, 22, 3) of who glides ahead."""
    positions = standing_clip(frames, FPS).positions_w_m.copy()
    positions[..., 0] += (np.arange(frames) * mps / FPS)[:, None]
    return positions


def corpus_of(**clips: tuple[str, np.ndarray]) -> Any:
    """As far as `variations` looks: name -> action and positions."""
    names = list(clips)
    return SimpleNamespace(
        clips=[SimpleNamespace(name=name, action=clips[name][0], frames=len(clips[name][1])) for name in names],
        select=lambda split: range(len(names)) if split == "train" else [],
        positions=lambda i: clips[names[i]][1],
    )


@pytest.mark.parametrize("pace", [1.0, 0.8])
def test_played_backwards_it_ends_where_it_began_at_its_pace(pace: float) -> None:
    forwards = going(90, 2.0)
    found = backwards(forwards, pace)
    assert len(found) == pytest.approx(90 / pace, abs=2)
    np.testing.assert_allclose(found[0], forwards[-1], atol=1e-9)
    np.testing.assert_allclose(found[-1, 0], forwards[0, 0], atol=0.05)
    assert speed_mps(found) == pytest.approx(2.0 * pace, rel=0.02)


def test_what_is_made_of_which_clips() -> None:
    made = {
        name: (behaviour, positions)
        for name, behaviour, positions in variations(
            corpus_of(
                slow=("run", going(120, 2.5)), fast=("run", going(120, 3.3)), sprint=("run", going(120, 5.0)),
                strides=("walk_fast", going(120, 2.0)), wave=("wave", going(120, 0.0)),
                short=("run", going(LEAST_FRAMES - 1, 2.5)),
            ),
            seed=0,
        )
    }  # fmt: skip
    assert {name: behaviour for name, (behaviour, _) in made.items()} == {
        "slow_backwards": "step_back", "slow_curved": "run", "fast_curved": "run", "strides_backwards": "step_back"
    }  # fmt: skip
    path = made["slow_curved"][1][:, 0, :2]
    heading = np.unwrap(np.arctan2(*np.diff(path, axis=0).T[::-1]))
    assert 0.8 * 4.0 < abs(heading[-1] - heading[0]) / (len(path) / FPS) * speed_mps(made["slow_curved"][1]) < 1.2 * 9.0
