"""Takes of several things are cut where what is done changes; seats are found under whoever sits."""

from __future__ import annotations

import numpy as np

from shared.data.build import mirrored
from shared.data.corpus import ClipInfo, Corpus, write_corpus
from shared.data.label import Label, locomotion_label, segment_locomotion
from shared.data.phases import phases_of, seated_runs, waves
from shared.data.pieces import Piece, at_origin
from shared.data.props import PELVIS_OVER_SEAT_M, Seat, Strike
from shared.data.texts import SENTENCES
from shared.motion.body import J, place
from shared.motion.limbs import solve_arm
from tests.data.samples import stand, stepping


def _lowered(p: np.ndarray, drop_m: np.ndarray) -> np.ndarray:
    """Whole poses moved down and back, as a sitting body is; the feet do not matter here."""
    return np.asarray(p - np.stack([drop_m, 0 * drop_m, drop_m], axis=-1)[:, None])


def test_sitting_is_cut_into_down_still_and_up_with_the_seat_under_the_pelvis() -> None:
    t = np.arange(420)
    drop = 0.4 * (np.clip((t - 80) / 40, 0, 1) - np.clip((t - 320) / 40, 0, 1))
    p = _lowered(stand(420), drop)
    ((a, b),) = seated_runs(p)
    assert 110 <= a <= 125
    assert 315 <= b <= 330
    phases = phases_of("sit_any", p)
    assert phases is not None
    assert [f.label.action for f in phases] == ["sit_down", "seated", "rise"]
    assert phases[0].start == 0
    assert phases[-1].stop == 420
    assert all(x.stop == y.start for x, y in zip(phases, phases[1:], strict=False))
    for phase in phases:
        assert phase.seat is not None
        np.testing.assert_allclose(phase.seat.top_m[:2], p[200, 0, :2], atol=1e-6)
        np.testing.assert_allclose(phase.seat.top_m[2], p[200, 0, 2] - PELVIS_OVER_SEAT_M, atol=1e-6)
        assert phase.label.action in SENTENCES


def test_squats_are_found_among_exercises() -> None:
    t = np.arange(300)
    p = _lowered(stand(300), 0.3 * np.exp(-(((t - 200) / 30) ** 2)))
    phases = phases_of("exercise", p)
    assert phases is not None
    (squat,) = (f for f in phases if f.label.action == "squat")
    assert squat.start < 200 < squat.stop
    assert (phases[0].start, phases[-1].stop) == (0, 300)


def test_a_hand_that_goes_to_and_fro_above_the_shoulder_waves() -> None:
    p = stand(150)
    t = np.arange(150) / 30
    raised = p[:, J["left_shoulder"]] + np.stack([0.15 + 0 * t, 0.15 + 0.15 * np.sin(9 * t), 0.35 + 0 * t], axis=-1)
    q = solve_arm(p, "left", raised)
    assert waves(q, "left")
    assert not waves(q, "right")
    assert not waves(solve_arm(p, "left", p[:, J["left_shoulder"]] + [0.15, 0.15, 0.35]), "left")


def test_a_walk_forward_and_back_is_cut_where_it_turns_back() -> None:
    forth = stepping(150)
    p = np.concatenate([forth, forth[::-1]])
    cuts = segment_locomotion(p)
    labels = [locomotion_label(p[a:b]).behaviour for a, b in cuts]
    assert labels[0] == "walk"
    assert labels[-1] == "step_back"


def test_props_move_with_their_clip_and_into_the_mirror(tmp_path) -> None:  # type: ignore[no-untyped-def]
    p = place(stand(100), 0.7, np.array([2.0, -1.0]))
    pelvis = p[50, J["pelvis"]]
    seat = Seat.under(p)
    strike = Strike("left_wrist", tuple(p[50, J["left_wrist"]].tolist()), 50)
    piece = at_origin(Piece("n", "t", "s", Label("sit", "seated", "left"), ("a", "b"), p, seat=seat, strike=strike))
    for q in (piece, mirrored(piece)):
        assert q.seat is not None
        assert q.strike is not None
        np.testing.assert_allclose(q.seat.top_m[:2], q.positions[50, J["pelvis"], :2], atol=1e-9)
        np.testing.assert_allclose(q.seat.top_m[2], pelvis[2] - PELVIS_OVER_SEAT_M, atol=1e-9)
        np.testing.assert_allclose(q.strike.target_m, q.positions[50, J[q.strike.joint]], atol=1e-9)
        np.testing.assert_allclose(q.seat.heading_rad, 0.0, atol=1e-9)
    info = ClipInfo("n", "t", "s", "sit", "seated", ("a",), "train", True, False, 0, 0, 1.0, piece.seat, piece.strike)
    plain = ClipInfo("m", "t", "s", "sit", "seated", ("a",), "train", True, False, 0, 0, 0.0)
    write_corpus(tmp_path / "c", [(info, piece.positions), (plain, piece.positions)], {"format": 1})
    first, second = Corpus.load(tmp_path / "c").clips
    assert (first.seat, first.strike) == (piece.seat, piece.strike)
    assert (second.seat, second.strike) == (None, None)
