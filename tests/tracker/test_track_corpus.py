"""Clips as the physics performs them: kept while the body is with the clip, and written beside the recorded ones."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from shared.data.corpus import ClipInfo, Corpus, write_corpus
from shared.errors import InvalidInputError
from shared.motion.ik import standing_clip
from tracker_service.simulation.character_spec import HUMAN
from tracker_service.simulation.humanoid import humanoid
from tracker_service.training.dataset import prepare
from tracker_service.training.main import motions
from tracker_service.training.track_corpus import LEAST_TICKS, LOST_M, perform, with_performances

HUMANOID = humanoid(HUMAN)
HINGES = len(HUMANOID.hinges)


def still(observation: np.ndarray) -> np.ndarray:
    """No action: the servos follow the reference."""
    return np.zeros((len(observation), HINGES), np.float32)


@pytest.fixture(scope="module")
def corpus(tmp_path_factory: pytest.TempPathFactory) -> Corpus:
    stand = standing_clip(100, 30.0).positions_w_m.astype(np.float32)
    thrown = stand.copy()
    thrown[50:, :, 0] += np.linspace(0.0, 40.0, 50)[:, None]  # leaves at 24 m/s
    infos = [
        ClipInfo(name, name, "made", "stand", "stand", ("stands",), "train", True, False, 0, 100, 0.5)
        for name in ("still", "thrown")
    ]
    folder = tmp_path_factory.mktemp("corpus") / "c"
    write_corpus(folder, list(zip(infos, (stand, thrown), strict=True)), {"format": 1})
    return Corpus.load(folder)


def test_a_performance_is_the_bodys_motion_and_ends_before_the_body_was_lost(corpus: Corpus) -> None:
    clips = prepare(HUMANOID, motions(corpus, "train"))
    whole, lost = perform(HUMANOID, clips, np.arange(2), still)
    assert whole.shape == (100, 22, 3)
    reference = clips.pos_w_m[clips.start[0] : clips.start[0] + 100]
    off = np.linalg.norm(whole - reference, axis=-1)
    assert 1e-4 < off[1:].max() < LOST_M  # near the clip, and not the clip itself
    # The other is lost within a second of leaving: what is left is too short.
    assert len(lost) == 0
    assert LEAST_TICKS > 60


def test_performed_clips_get_their_share(corpus: Corpus, tmp_path: Path) -> None:
    clips = prepare(HUMANOID, motions(corpus, "train"))
    result = with_performances(corpus, clips, HUMANOID, still, share=0.3, say=lambda line: None)
    assert [info.name for info, _ in result] == ["still", "thrown", "still~performed"]
    assert [info.weight for info, _ in result] == pytest.approx([0.35, 0.35, 0.3])
    assert result[2][0].texts == ("stands",)
    with pytest.raises(InvalidInputError):
        with_performances(corpus, clips, HUMANOID, still, 0.3, only_recorded=("stand",), say=lambda line: None)


def test_a_policy_that_can_follow_nothing_is_refused(corpus: Corpus) -> None:
    clips = prepare(HUMANOID, motions(corpus, "train"))
    with pytest.raises(InvalidInputError, match="follow no clip"):
        with_performances(
            corpus, clips, HUMANOID, lambda o: np.full((len(o), HINGES), 1.0, np.float32), 0.5, say=lambda line: None
        )
