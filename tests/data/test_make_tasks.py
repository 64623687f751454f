"""Made sits, rises, steps, strikes and get-ups: seats carry, feet stay, limbs hit, nothing jumps."""

from __future__ import annotations

import numpy as np
import pytest

from shared.data.balance import ahead_of_feet, centre_of_mass, on_feet
from shared.data.grounding import measure
from shared.data.label import Label, rotation_steps_rad
from shared.data.make_floor import lie_still, lying_ends
from shared.data.make_paths import Source
from shared.data.make_seats import Descent, back_up_and_sit, descents, sit_down, stand_up, stay_seated
from shared.data.make_steps import flat_footed, moved, step_to
from shared.data.make_strikes import HIT_M, Blow, blows, kick_at, punch_at, strikes
from shared.data.make_tasks import rises, sits, steps, ways
from shared.data.maker import Maker
from shared.data.pieces import Piece, Report
from shared.data.props import PELVIS_OVER_SEAT_M, Seat
from shared.data.splice import local_rotations
from shared.motion.body import SIDES, Array, J, forward_of, heading_rad, sole_height, velocity
from shared.motion.limbs import solve_arm, solve_leg
from shared.motion.rotations import matrix_from_rotvec
from tests.data.samples import stand

HEIGHTS = [0.2, 0.33, 0.45, 0.6]


def _ramp(t: Array, start: float, stop: float) -> Array:
    x = np.clip((t - start) / (stop - start), 0.0, 1.0)
    return np.asarray(x * x * (3 - 2 * x))


def _recorded_sit() -> Array:
    """(180, 22, 3) a plain sit on a seat of 0.42 m: a second of standing, one and a half of descent, then still."""
    p = stand(180)
    w = _ramp(np.arange(180.0), 30, 75)
    local = local_rotations(p)
    lean = np.stack([0 * w, 0.9 * np.sin(np.pi * w) + 0.05 * w, 0 * w], axis=-1)
    local[:, 0] = local[:, 0] @ matrix_from_rotvec(lean)
    root = p[:, 0] - w[:, None] * [0.42, 0.0, p[0, 0, 2] - 0.54]
    ankles = {s: p[:, J[f"{s}_ankle"]] for s in SIDES}
    return on_feet(local, root, ankles, {s: p[:, J[f"{s}_foot"]] - ankles[s] for s in SIDES})


@pytest.fixture(scope="module")
def way() -> Descent:
    (how,) = descents(_recorded_sit(), rising=False)
    assert how.drop_m == pytest.approx(stand(1)[0, 0, 2] - 0.54, abs=0.03)
    return how


def _sound(p: Array, rotation_rad: float = 0.5) -> None:
    """Moves as bodies do: no jump of a joint or rotation, feet on the floor and not sliding, bones of their length."""
    quality = measure(p, 30.0)
    assert quality.bone_error_mm < 0.01
    assert quality.skating_mm < 1.0
    assert quality.max_penetration_mm < 12
    assert rotation_steps_rad(local_rotations(p)).max() < rotation_rad
    assert np.linalg.norm(velocity(velocity(p, 30.0), 30.0), axis=-1).max() < 150


def _carried(p: Array, seat: Seat, frame: int) -> None:
    pelvis = p[frame, J["pelvis"]]
    assert pelvis[2] - seat.top_m[2] == pytest.approx(PELVIS_OVER_SEAT_M, abs=0.012)
    c, s = np.cos(seat.heading_rad), np.sin(seat.heading_rad)
    offset = pelvis[:2] - seat.top_m[:2]
    assert abs(c * offset[0] + s * offset[1]) < seat.size_m[0] / 2
    assert abs(c * offset[1] - s * offset[0]) < seat.size_m[1] / 2
    for side in SIDES:  # the feet stand before the seat, the knees are beyond its edge
        for joint in ("ankle", "knee"):
            to = p[frame, J[f"{side}_{joint}"], :2] - np.array(seat.top_m[:2])
            assert c * to[0] + s * to[1] > seat.size_m[0] / 2 - 0.03


@pytest.mark.parametrize("height", HEIGHTS)
def test_a_sit_ends_on_its_seat_with_feet_planted_and_weight_over_them_on_the_way(way: Descent, height: float) -> None:
    pose = stand(1)[0]
    p, seat = sit_down(pose, height, way, np.random.default_rng(1), 0.6, 1.0)
    _sound(p)
    _carried(p, seat, -1)
    assert seat.top_m[2] == height
    for side in SIDES:
        assert np.ptp(p[:, J[f"{side}_ankle"]], axis=0).max() < 0.01
    down = (p[0, 0, 2] - p[:, 0, 2]) / (p[0, 0, 2] - p[-1, 0, 2])
    at = ahead_of_feet(p, centre_of_mass(p))
    assert at[down < 0.7].min() > -0.13
    assert np.diff(p[:, 0, 2]).min() * 30 > -1.4


@pytest.mark.parametrize("height", HEIGHTS)
def test_a_rise_begins_on_its_seat_and_ends_in_the_stand(way: Descent, height: float) -> None:
    pose = stand(1)[0]
    p, seat = stand_up(pose, height, way, np.random.default_rng(2), 0.8, 0.8)
    _sound(p)
    _carried(p, seat, 0)
    assert p[-1, 0, 2] > 0.85
    assert p[-1, J["head"], 2] > 1.4


def test_backing_up_comes_before_sitting_and_the_seat_is_where_the_steps_lead(way: Descent) -> None:
    pose = stand(1)[0]
    p, seat = back_up_and_sit(pose, 0.42, way, np.random.default_rng(3), 0.4, 1.0)
    _sound(p)
    _carried(p, seat, -1)
    assert p[-1, J["left_ankle"], 0] - pose[J["left_ankle"], 0] == pytest.approx(-0.4, abs=0.05)
    longer = stay_seated(p, 120, np.random.default_rng(4))
    _carried(longer, seat, 60)
    assert np.ptp(longer[:, J["head"]], axis=0).max() > 0.003


@pytest.mark.parametrize(
    ("ahead", "left"), [(-0.35, 0.0), (0.0, 0.3), (0.0, -0.3), (0.35, 0.0), (-1.5, 0.0), (0.0, 1.2)]
)
def test_steps_lead_there_on_feet_that_do_not_slide(ahead: float, left: float) -> None:
    pose = flat_footed(stand(1)[0])
    there = flat_footed(moved(pose, ahead, left))
    p = step_to(pose, there, np.random.default_rng(5))
    _sound(p)
    assert sole_height(p).min(axis=-1).max() < 0.012  # one foot is always down
    assert sole_height(p).max() > 0.035  # and the other is lifted
    np.testing.assert_allclose(p[-1, 0, :2] - p[0, 0, :2], [ahead, left], atol=0.03)
    assert np.abs(heading_rad(p) - heading_rad(p)[0]).max() < 0.15


def _punch(height: float = 1.3) -> tuple[Array, int]:
    """A right punch from a stand with the fist at the chest, and its farthest frame."""
    p = stand(120)
    t = np.arange(120.0)
    out = _ramp(t, 53, 57.5) - _ramp(t, 62, 78)
    near, far = np.array([0.15, -0.15, 1.2]), np.array([0.54, -0.15, height])
    return solve_arm(p, "right", near + out[:, None] * (far - near)), 60


def _kick() -> Array:
    p = stand(120)
    t = np.arange(120.0)
    up, out = _ramp(t, 35, 50) - _ramp(t, 66, 82), _ramp(t, 44, 56) - _ramp(t, 60, 72)
    foot = p[0, J["right_ankle"]] + up[:, None] * [0.25, 0.0, 0.5] + out[:, None] * [0.5, 0.0, 0.15]
    q = solve_leg(p, "right", foot)
    toes = matrix_from_rotvec(np.stack([0 * up, -0.9 * up, 0 * up], axis=-1)) @ (
        p[0, J["right_foot"]] - p[0, J["right_ankle"]]
    )
    q[:, J["right_foot"]] = q[:, J["right_ankle"]] + toes
    return q


def _piece(p: Array, behaviour: str, action: str, name: str = "s/t", **more: object) -> Piece:
    return Piece(name, name, "s", Label(behaviour, action), ("a", "b"), p, **more)  # type: ignore[arg-type]


def test_punches_and_kicks_are_found_with_their_limb_on_both_sides_of_the_mirror() -> None:
    found = blows([_piece(_punch()[0], "punch", "punch"), _piece(_kick(), "kick", "kick")])
    assert sorted(b.joint for b in found) == ["left_foot", "left_wrist", "right_foot", "right_wrist"]
    for blow in found:
        assert 8 <= blow.contact < blow.farthest < len(blow.positions) - 8


@pytest.mark.parametrize("height", [0.65, 1.0, 1.3, 1.55])
@pytest.mark.parametrize("aside", [-0.3, 0.0, 0.3])
def test_a_fist_hits_its_point_and_goes_on(height: float, aside: float) -> None:
    p, _ = _punch()
    blow = Blow(Source("s/t", "s", p), p, "right_wrist", 56, 60)
    q, point = punch_at(blow, height, aside, 0.88)
    assert point[2] == pytest.approx(height, abs=0.12)
    assert np.linalg.norm(q[56, J["right_wrist"]] - point) < HIT_M
    assert np.linalg.norm(q[56, J["right_wrist"]] - q[46, J["right_wrist"]]) > 0.2  # it comes at speed
    ways_out = [x[:2] - p[56, J["right_shoulder"], :2] for x in (p[56, J["right_wrist"]], point)]
    old, new = (float(np.arctan2(x[1], x[0])) for x in ways_out)
    angle = new - old
    assert angle == pytest.approx(aside, abs=0.25)
    assert sole_height(q).min() > -0.005


@pytest.mark.parametrize("height", [0.65, 0.9, 1.2])
def test_a_foot_hits_its_point_while_the_other_stands(height: float) -> None:
    p = _kick()
    (blow,) = (b for b in blows([_piece(p, "kick", "kick")]) if b.joint == "right_foot" and b.source.positions is p)
    q, point = kick_at(blow, height, 0.1, 0.88)
    assert point[2] == pytest.approx(height, abs=0.05)
    assert np.linalg.norm(q[blow.contact, J["right_foot"]] - point) < HIT_M
    assert np.ptp(q[:, J["left_ankle"]], axis=0).max() < 0.01
    assert sole_height(q).min() > -0.01


def _maker(seed: int) -> Maker:
    stands = [Source("s/stand", "s", stand(1))]
    return Maker("train", np.random.default_rng(seed), Report(), [], [], [], [], [], stands)


def _made(seed: int) -> Maker:
    sat = _recorded_sit()
    seat = Seat.under(sat[120:])
    known = [_piece(sat, "sit", "sit_down", seat=seat), _piece(sat[::-1], "rise", "rise", seat=seat)]
    hits = blows([_piece(_punch()[0], "punch", "punch"), _piece(_kick(), "kick", "kick")])
    maker = _maker(seed)
    sits(maker, ways(known, "sit"), 8)
    rises(maker, ways(known, "rise"), 6)
    steps(maker, 14)
    strikes(maker, hits, 12)
    return maker


def test_what_is_made_says_what_it_is_is_sound_and_comes_again_with_its_seed() -> None:
    first, again = _made(7), _made(7)
    assert [p.name for p in first.out] == [p.name for p in again.out]
    for p, q in zip(first.out, again.out, strict=True):
        np.testing.assert_array_equal(p.positions, q.positions)
    assert len(first.report.left_out) <= 4
    kinds = {p.label.behaviour for p in first.out}
    assert {"sit", "rise", "step_back", "step_side", "punch", "kick"} <= kinds
    for piece in first.out:
        p = piece.positions
        _sound(p, 1.2)
        other = "right" if piece.label.side == "left" else "left"
        assert not any(other in text.split() for text in piece.texts if piece.label.side)
        if piece.label.behaviour in ("sit", "rise"):
            assert piece.seat is not None
            _carried(p, piece.seat, -1 if piece.label.behaviour == "sit" else 0)
        if piece.label.behaviour == "step_side":
            leftward = float((p[-1, 0] - p[0, 0]) @ np.cross([0.0, 0.0, 1.0], forward_of(p[:1])[0]))
            assert leftward > 0.1 if piece.label.side == "left" else leftward < -0.1
        if piece.label.action == "step_back":
            assert (p[-1, 0] - p[0, 0]) @ forward_of(p[:1])[0] < -0.1
        if piece.strike is not None:
            strike = piece.strike
            assert strike.joint.startswith(piece.label.side)
            assert np.linalg.norm(p[strike.frame, J[strike.joint]] - strike.target_m) < HIT_M


def test_lying_down_is_told_backwards_and_lying_still_lives() -> None:
    p = stand(120)
    w = _ramp(np.arange(120.0), 10, 100)
    local = local_rotations(p)
    local[:, 0] = local[:, 0] @ matrix_from_rotvec(np.stack([0 * w, -0.5 * np.pi * w, 0 * w], axis=-1))
    down = on_feet(local, p[:, 0] - w[:, None] * [0.6, 0.0, 0.75], {s: p[:, J[f"{s}_ankle"]] for s in SIDES},
                   {s: p[:, J[f"{s}_foot"]] - p[:, J[f"{s}_ankle"]] for s in SIDES}, lower=False)  # fmt: skip
    known = lying_ends([_piece(down, "lie_down", "lie_down"), _piece(stand(50), "lie_down", "lie_down")])
    assert len(known) == 2  # and its mirror image; what never lies teaches nothing
    np.testing.assert_array_equal(known[0].positions, down[::-1])
    still = lie_still(down[-1], 100, np.random.default_rng(0))
    assert 0.001 < np.ptp(still[:, J["head"]], axis=0).max() < 0.05
