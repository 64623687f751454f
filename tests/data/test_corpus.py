"""The corpus: texts, split, weights, files; and, where there are recordings, what a build gives."""

from __future__ import annotations

import shutil
import tarfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shared.data.build import BEHAVIOUR_SHARES, build, heldout_pieces, mirrored, weights, with_split
from shared.data.corpus import Corpus
from shared.data.label import Label, rotation_steps_rad
from shared.data.pieces import MAX_ROTATION_STEP_RAD, SHORTEST, Piece, same_recording
from shared.data.splice import local_rotations
from shared.data.texts import BEHAVIOURS, PARAPHRASES, SENTENCES, clean, sentences, swap_sides
from shared.errors import InvalidInputError
from shared.motion.body import J, sole_height
from shared.motion.ik import clip_from_positions
from shared.motion.io.bvh import write_bvh
from tests.data.samples import stepping


def _pieces(count: int) -> list[Piece]:
    p = stepping(100)
    return [
        Piece(f"s/t{i}@{k}", f"s/t{i}", "s", Label("walk" if i % 3 else "kick", "walk"), ("a",), p)
        for i in range(count)
        for k in range(2)
    ]


def test_every_action_has_several_sentences_with_its_side() -> None:
    for action in SENTENCES:
        texts = sentences(action, "left")
        assert len(texts) >= 3
        assert not any("{" in t for t in texts)
        assert not any("left" in t for t in sentences(action, "right"))
    assert set(BEHAVIOUR_SHARES) == set(BEHAVIOURS)
    assert sum(BEHAVIOUR_SHARES.values()) == pytest.approx(1.0, abs=0.03)


@given(st.text(max_size=60))
def test_swapping_sides_twice_is_the_identity(text: str) -> None:
    once = swap_sides(text.lower())
    assert swap_sides(once) == text.lower()


def test_swapping_sides() -> None:
    assert swap_sides("Turn left, then wave the right hand") == "Turn right, then wave the left hand"
    assert swap_sides("leftover bright") == "leftover bright"
    assert clean(["A person walks. ", "a person walks", ""]) == ["a person walks"]


def test_split_is_by_take_and_stratified() -> None:
    pieces = _pieces(60)
    heldout = heldout_pieces(pieces)
    assert heldout == heldout_pieces(list(reversed(pieces)))
    kinds = {p.take: p.label.behaviour for p in pieces if p.name in heldout}
    assert list(kinds.values()).count("walk") == 4
    assert list(kinds.values()).count("kick") == 2
    split = with_split(pieces, heldout)
    assert not {p.take for p in split if p.split == "heldout"} & {p.take for p in split if p.split == "train"}


def test_rare_behaviours_are_split_by_piece_so_that_each_has_heldout_clips() -> None:
    rare = [Piece(f"s/r@{k}", "s/r", "s", Label("punch", "box"), ("a",), stepping(100)) for k in range(5)]
    heldout = heldout_pieces([*_pieces(60), *rare])
    assert len(heldout & {p.name for p in rare}) == 1
    split = with_split(rare, heldout)
    assert {p.split for p in split} == {"train", "heldout"}
    assert len({p.take for p in split}) == 5  # no take is on both sides


def test_paraphrases_are_of_known_actions_and_never_trained_on() -> None:
    trained = {t for action in SENTENCES for side in ("left", "right") for t in sentences(action, side)}
    assert len(trained) > 500
    heldout = [t for action in PARAPHRASES for side in ("left", "right") for t in sentences(action, side, PARAPHRASES)]
    assert set(PARAPHRASES) <= set(SENTENCES)
    assert len(set(heldout)) > 150
    assert not trained & set(clean(heldout))
    for action in PARAPHRASES:
        assert not any("right" in t.split() for t in sentences(action, "left", PARAPHRASES))


def test_sentences_of_a_mirrored_clip_are_those_of_the_other_side() -> None:
    for action in SENTENCES:
        assert {swap_sides(t) for t in sentences(action, "left")} == set(sentences(action, "right"))
        assert {swap_sides(t) for t in sentences(action)} == set(sentences(action))


def test_advertisements_in_the_sources_are_dropped() -> None:
    assert clean(["walk", "visit <a href=http://x.com>us</a>", "see www.tickets.org"]) == ["walk"]


def test_weights_are_by_behaviour_and_not_by_minutes() -> None:
    pieces = _pieces(30)
    share = weights(pieces)
    assert sum(share) == pytest.approx(1.0)
    walk = sum(w for w, p in zip(share, pieces, strict=True) if p.label.behaviour == "walk")
    expected = BEHAVIOUR_SHARES["walk"] / (BEHAVIOUR_SHARES["walk"] + BEHAVIOUR_SHARES["kick"])
    assert walk == pytest.approx(expected)


def test_a_mirrored_piece_swaps_its_words_and_sides() -> None:
    piece = Piece("n", "t", "s", Label("kick", "kick", "left"), ("kick with the left leg",), stepping(100))
    other = mirrored(piece)
    assert other.texts == ("kick with the right leg",)
    assert other.label.side == "right"
    np.testing.assert_allclose(
        other.positions[:, J["right_ankle"], 2], piece.positions[:, J["left_ankle"], 2], atol=1e-12
    )


def test_copies_of_a_recording_are_recognised() -> None:
    rng = np.random.default_rng(0)
    f = np.cumsum(rng.normal(0, 0.1, (90, 4)), axis=0)
    assert same_recording(f, f[1:] + rng.normal(0, 0.005, (89, 4)))
    assert not same_recording(f, np.cumsum(rng.normal(0, 0.1, (90, 4)), axis=0))
    assert not same_recording(f, np.concatenate([f, f]))


def test_build_from_own_recordings(tmp_path: Path) -> None:
    """Walks of several speeds and sides, as BVH: a whole build, its split, its manifest."""
    source = tmp_path / "mocap" / "deepmimic"
    source.mkdir(parents=True)
    for i in range(5):
        p = stepping(150 + i, 0.9 + 0.1 * i)
        write_bvh(source / f"walk{i}.bvh", clip_from_positions(p, 30.0, rebuild=True))
    manifest = build(tmp_path / "mocap", tmp_path / "corpus", seed=1)
    corpus = Corpus.load(tmp_path / "corpus")
    assert manifest["clips"] == len(corpus)
    _check_corpus(corpus)
    assert {c.behaviour for c in corpus.clips} >= {"walk", "turn"}
    assert len({c.take for c in corpus.clips if c.split == "heldout" and not c.made}) == 1
    with pytest.raises(InvalidInputError, match="not a folder"):
        build(tmp_path / "nowhere", tmp_path / "c2")
    with pytest.raises(InvalidInputError, match="no corpus"):
        Corpus.load(tmp_path / "mocap")


def _check_corpus(corpus: Corpus) -> None:
    train_takes = {t for c in corpus.clips if c.split == "train" for t in c.take.split("+")}
    heldout_takes = {t for c in corpus.clips if c.split == "heldout" for t in c.take.split("+")}
    assert not train_takes & heldout_takes
    assert not any(c.mirrored and c.split == "heldout" for c in corpus.clips)
    assert sum(c.weight for c in corpus.clips) == pytest.approx(1.0)
    assert len({c.name for c in corpus.clips}) == len(corpus)
    for clip, p in corpus:
        q = np.asarray(p, dtype=np.float64)
        assert clip.frames == len(q) >= SHORTEST
        assert len(clip.texts) >= 2
        assert clip.behaviour in BEHAVIOURS
        assert np.isfinite(q).all()
        assert sole_height(q).min() > -0.03
        np.testing.assert_allclose(q[0, 0, :2], 0.0, atol=1e-6)
        # The bound on reference motion per tick that the tracker's training relies on.
        assert rotation_steps_rad(local_rotations(q)).max() <= MAX_ROTATION_STEP_RAD + 1e-3
        assert np.linalg.norm(np.diff(q, axis=0), axis=-1).max() <= 0.55


def test_build_from_recorded_motion(mocap_dir: Path, tmp_path: Path) -> None:
    """A part of the real recordings, from archives, through the whole build."""
    folder = tmp_path / "mocap"
    folder.mkdir()
    for name in ("deepmimic", "cmu_start_stop"):
        archive = mocap_dir / f"{name}.tar.xz"
        if archive.exists():
            shutil.copy(archive, folder)
        else:
            with tarfile.open(folder / f"{name}.tar.xz", "w:xz") as tar:
                tar.add(mocap_dir / name, arcname=name)
    _keep(folder / "deepmimic.tar.xz", ("walk", "long_walk3", "long_walk2", "run", "getup_faceup", "kick", "jump"))
    manifest = build(folder, tmp_path / "corpus", amount=0.1)
    corpus = Corpus.load(tmp_path / "corpus")
    _check_corpus(corpus)
    assert manifest["quality"]["recorded"]["skating_mm"] < 1.0
    assert manifest["quality"]["rotation_step_rad"]["p99"] < 0.7
    assert {"walk", "turn", "stand", "wave", "get_up", "dance"} <= {c.behaviour for c in corpus.clips}


def _keep(archive: Path, stems: tuple[str, ...]) -> None:
    """Rewrite an archive with some of its members only, to keep the test short."""
    kept = archive.with_suffix(".kept")
    with tarfile.open(archive) as source, tarfile.open(kept, "w:xz", preset=0) as target:
        for member in source.getmembers():
            if member.isfile() and Path(member.name).stem in stems:
                target.addfile(member, source.extractfile(member))
    kept.replace(archive)
