"""What a character touches, sees and stands on, in real physics with scenes of a few primitives."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from shared.errors import InvalidInputError
from shared.motion.rotations import matrix_from_quat
from shared.motion.skeleton import CANONICAL
from shared.plugins.interfaces import NEAR_OBJECTS
from shared.scenes.files import load_scene, parse_scene
from tracker_service.policy.registry import make_tracker
from tracker_service.simulation.character import SimulatedCharacter
from tracker_service.simulation.character_spec import HUMAN
from tracker_service.simulation.humanoid import humanoid
from tracker_service.simulation.scene import build_scene
from tracker_service.training.seats import BACK_SIZE_M, EDGE_M, SEAT_SIZE_M, SOFA_SIZE_M, height_points, seat_heights

HUMANOID = humanoid(HUMAN)
THINGS = parse_scene(
    """
    name: things
    bodies:
      - name: bench
        position_w_m: [0, 1.0, 0]
        heading_deg: 90
        parts: [{shape: box, size_m: [0.2, 0.5, 0.2], position_b_m: [0, 0, 0.2]}]
      - {name: ball, shape: sphere, size_m: [0.15], mass_kg: 2, position_w_m: [0, 0, 3.0]}
      - {name: post, shape: cylinder, size_m: [0.1, 0.6], mass_kg: 30, position_w_m: [2.5, 0, 0.6]}
      - {name: far, shape: sphere, size_m: [0.2], mass_kg: 1, position_w_m: [20, 0, 0.2]}
      - name: gate
        position_w_m: [-2, 0, 0]
        mass_kg: 8
        hinge: {axis_b: [0, 0, 1], damping: 0}
        parts: [{shape: box, size_m: [0.02, 0.4, 0.5], position_b_m: [0, 0.4, 0.6]}]
    """
)


def make(text: str | None = None, tracker: str = "pd", **kwargs: object) -> SimulatedCharacter:
    scene = THINGS if text is None else load_scene(text)
    return SimulatedCharacter(build_scene(HUMANOID, scene), make_tracker(tracker, HUMANOID), **kwargs)  # type: ignore[arg-type]


def test_the_floor_carries_the_weight() -> None:
    """Over a second of standing the normal impulses of the floor are m g t, all of them through the feet."""
    character = make("flat")
    character.step(15)
    impulses = character.step(30)["contact_impulse_ns"]
    assert impulses.shape == (120, 22, 1)
    assert impulses.sum() == pytest.approx(72.0 * 9.81, rel=0.02)
    feet = CANONICAL.indices("left_ankle", "left_foot", "right_ankle", "right_foot")
    assert impulses[:, feet].sum() == pytest.approx(impulses.sum())


def test_a_falling_ball_gives_its_impulse_to_what_it_hits() -> None:
    character = make()
    samples = character.step(24)
    head, ball = CANONICAL.index("head"), 1 + character.scene.object_names.index("ball")
    hits = np.argwhere(samples["contact_impulse_ns"][:, :, ball] > 0)
    assert hits[0, 1] == head, "it falls on the head first"
    before = samples["object_vel_w"][hits[0, 0] - 1, ball - 1, 2]
    given = samples["contact_impulse_ns"][:, :, ball].sum()
    assert -before == pytest.approx(np.sqrt(2 * 9.81 * (3.0 - 0.15 - 1.75)), rel=0.15)
    assert given >= 2.0 * -before * 0.9, "it is stopped at least"
    assert not samples["contact_impulse_ns"][: hits[0, 0], :, 1:].any(), "nothing else was touched"


def test_what_is_only_shown_passes_no_impulse() -> None:
    samples = make(tracker="kinematic").step(6)
    assert not samples["contact_impulse_ns"].any()
    assert samples["contacts"].any()


def test_near_primitives_come_nearest_first_with_pose_size_and_velocity() -> None:
    character = make()
    character.set_object("ball", position_w_m=(0.5, 0.0, 1.0), linvel_w_mps=(0.0, 1.0, 0.0), angvel_w_radps=(0, 0, 2.0))
    character.set_object("gate", angvel_w_radps=(0.0, 0.0, 1.5))
    seen = character.observe()
    np.testing.assert_array_equal(seen.near_mask, [1, 1, 1, 1])
    # Distances of the surfaces to the pelvis: ball .35, bench .8, gate 2, post 2.4; the far one is not shown.
    np.testing.assert_allclose(seen.near_pos_w_m, [[0.5, 0, 1], [0, 1, 0.2], [-2, 0.4, 0.6], [2.5, 0, 0.6]], atol=1e-9)
    np.testing.assert_allclose(seen.near_half_size_m[1:3], [[0.2, 0.5, 0.2], [0.02, 0.4, 0.5]])
    np.testing.assert_allclose(seen.near_half_size_m[[0, 3]], [[0.15] * 3, [0.1, 0.1, 0.6]])
    np.testing.assert_allclose(np.abs(matrix_from_quat(seen.near_quat_w[1])[:, 0]), [0, 1, 0], atol=1e-9)
    np.testing.assert_allclose(seen.near_linvel_w_mps, [[0, 1, 0], [0, 0, 0], [-0.6, 0, 0], [0, 0, 0]], atol=1e-9)
    assert NEAR_OBJECTS == 4


def test_an_empty_floor_is_all_zeros() -> None:
    seen = make("flat").observe()
    for name in ("near_mask", "near_pos_w_m", "near_quat_w", "near_half_size_m", "near_linvel_w_mps"):
        assert not getattr(seen, name).any()
    for name, size in (("ground_height_w_m", 9), ("foot_height_w_m", 2), ("seat_height_w_m", 1)):
        np.testing.assert_array_equal(getattr(seen, name), np.zeros(size))


def test_heights_are_those_of_what_is_below_the_pelvis() -> None:
    """Facing -X beside the bench, whose top of 0.4 m spans y from .8 to 1.2 and x from -.5 to .5."""
    character = make(xy_w_m=(0.0, 0.7), heading_rad=np.pi)
    seen = character.observe()
    grid = seen.ground_height_w_m.reshape(3, 3)  # along the heading (-X), then to the left (-Y)
    np.testing.assert_allclose(grid, [[0.4, 0, 0], [0.4, 0, 0], [0.4, 0, 0]], atol=1e-6)
    assert seen.seat_height_w_m[0] == 0
    character = make(xy_w_m=(0.0, 1.0))
    assert character.observe().seat_height_w_m[0] == pytest.approx(0.4)
    character.set_object("bench", position_w_m=(0.0, 3.0, 0.0))
    assert character.observe().seat_height_w_m[0] == 0
    # What hangs above the pelvis is not below it.
    character.set_object("bench", position_w_m=(0.0, 1.0, 1.0))
    assert character.observe().seat_height_w_m[0] == 0


@pytest.mark.parametrize("sofa", [0.0, 1.0])
@pytest.mark.parametrize("top_m", [0.3, 0.55])
def test_heights_are_those_that_training_shows(top_m: float, sofa: float) -> None:
    """The policy is trained on the analytic heights of its blocks; in use it sees rays cast on the scene."""
    x, y, heading = 0.15, -0.1, 0.4
    boxes = [(SEAT_SIZE_M, 0.0, -SEAT_SIZE_M[2] / 2)]
    if sofa:
        rear = EDGE_M - SOFA_SIZE_M[0]
        boxes = [
            (SOFA_SIZE_M, EDGE_M - SOFA_SIZE_M[0] / 2, -SOFA_SIZE_M[2] / 2),
            (BACK_SIZE_M, rear + BACK_SIZE_M[0] / 2, BACK_SIZE_M[2] / 2),
        ]
    parts = [
        f"{{shape: box, size_m: {[s / 2 for s in size]}, position_b_m: [{ahead}, 0, {up}]}}"
        for size, ahead, up in boxes
    ]
    scene = parse_scene(
        f"name: seat\nbodies: [{{name: seat, parts: [{', '.join(parts)}], heading_deg: {np.degrees(heading)},"
        f" position_w_m: [{x}, {y}, {top_m}]}}]"
    )
    character = SimulatedCharacter(build_scene(HUMANOID, scene), make_tracker("pd", HUMANOID), heading_rad=-0.7)
    seen = character.observe()
    feet = (CANONICAL.index("left_foot"), CANONICAL.index("right_foot"))
    forward = matrix_from_quat(seen.body_quat_w[:1])[:, :, 0]
    points = height_points(seen.body_pos_w_m[None], forward, feet)
    wanted = seat_heights(points, seen.body_pos_w_m[None, 0, 2], np.array([[x, y, top_m, heading, sofa]]))[0]
    assert wanted.any() and not wanted.all() and (len(set(wanted)) == 3 if sofa else len(set(wanted)) == 2)
    np.testing.assert_allclose(
        np.concatenate([seen.ground_height_w_m, seen.foot_height_w_m, seen.seat_height_w_m]), wanted, atol=1e-6
    )


def test_a_chair_that_can_be_pushed_is_a_seat_all_the_same() -> None:
    scene = load_scene("chair")
    chair = scene.bodies[0]
    character = SimulatedCharacter(
        build_scene(HUMANOID, scene), make_tracker("pd", HUMANOID), xy_w_m=(chair.position_w_m[0], 0.0)
    )
    assert character.observe().seat_height_w_m[0] == pytest.approx(0.45, abs=0.005)


def test_moved_objects_are_there_in_the_log_and_survive_a_snapshot() -> None:
    character = make()
    half = np.sqrt(0.5)
    character.set_object("bench", position_w_m=(5.0, 5.0, 0.0), quat_w=(half, 0.0, 0.0, half))
    character.set_object("post", quat_w=(half, half, 0.0, 0.0), position_w_m=(4.0, 0.0, 0.3))
    character.set_object("gate", quat_w=(half, 0.0, 0.0, half))
    names = character.scene.object_names
    poses = dict(zip(names, character.sample()["object_pose_w"][0], strict=True))
    np.testing.assert_allclose(poses["bench"], [5, 5, 0, half, 0, 0, half], atol=1e-12)
    np.testing.assert_allclose(poses["post"], [4, 0, 0.3, half, half, 0, 0], atol=1e-12)
    np.testing.assert_allclose(poses["gate"], [-2, 0, 0, half, 0, 0, half], atol=1e-12)
    snapshot = character.snapshot()
    first = character.step(15)
    np.testing.assert_allclose(first["object_pose_w"][-1, 0, :3], [5, 5, 0])
    other = make()
    other.restore(*snapshot)
    second = other.step(15)
    for name, array in first.items():
        np.testing.assert_array_equal(array, second[name], err_msg=name)
    character.reset((0.0, 0.0), 0.0)
    np.testing.assert_allclose(character.sample()["object_pose_w"][0, 0, :3], [0, 1, 0])


def test_a_fixed_object_of_one_character_is_not_moved_for_another() -> None:
    world = build_scene(HUMANOID, THINGS)
    one, two = (SimulatedCharacter(world, make_tracker("pd", HUMANOID)) for _ in range(2))
    one.set_object("bench", position_w_m=(7.0, 0.0, 0.0))
    np.testing.assert_allclose(two.step(3)["object_pose_w"][-1, 0, :3], [0, 1, 0])
    np.testing.assert_allclose(one.step(3)["object_pose_w"][-1, 0, :3], [7, 0, 0])


@pytest.mark.parametrize(
    ("name", "change", "field"),
    [
        ("moon", {"position_w_m": (0, 0, 0)}, "name"),
        ("bench", {"linvel_w_mps": (1, 0, 0)}, "linvel_w_mps"),
        ("bench", {"angvel_w_radps": (1, 0, 0), "position_w_m": (9, 9, 9)}, "angvel_w_radps"),
        ("gate", {"position_w_m": (1, 0, 0)}, "position_w_m"),
        ("gate", {"linvel_w_mps": (1, 0, 0)}, "linvel_w_mps"),
    ],
)
def test_what_cannot_move_so_is_refused_and_stays(name: str, change: dict[str, object], field: str) -> None:
    character = make()
    before = character.sample()
    with pytest.raises(InvalidInputError) as caught:
        character.set_object(name, **change)  # type: ignore[arg-type]
    assert caught.value.field == field
    for key, array in character.sample().items():
        np.testing.assert_array_equal(array, before[key])


def test_a_seat_is_not_the_floor_but_a_platform_is() -> None:
    """Who lies on a high wide block has fallen if the block is ground, and rests on it if it is not."""
    fallen = {}
    for ground in (True, False):
        scene = parse_scene(
            "name: block\nbodies: [{name: block, shape: box, size_m: [3, 3, 0.5], position_w_m: [4, 0, 0.5],"
            f" ground: {str(ground).lower()}}}]"
        )
        character = SimulatedCharacter(build_scene(HUMANOID, scene), make_tracker("pd", HUMANOID))
        data = character._data
        data.qpos[:3] = [4.0, 0.0, 1.0 + 0.25]  # lying on its back on the block
        data.qpos[3:7] = [np.sqrt(0.5), 0.0, -np.sqrt(0.5), 0.0]
        mujoco.mj_forward(character.scene.model, data)
        fallen[ground] = bool(character.step(30)["fallen"][-1])
    assert fallen == {True: True, False: False}


@pytest.mark.parametrize("may_be_low", [False, True])
def test_lying_is_a_fall_unless_it_was_asked_for(may_be_low: bool) -> None:
    """A reference that lies down excuses nothing by itself (DESIGN 2)."""
    character = make("flat", tracker="kinematic")
    lying = np.repeat(character.reference.at(0).pos_w_m, 40, axis=0)
    tilt = np.minimum(np.arange(1, 41) / 20, 1.0) * (np.pi / 2 - 0.1)
    arm = lying[:, :, 2] - 0.1
    lying[:, :, 2] = 0.1 + arm * np.cos(tilt)[:, None]
    lying[:, :, 0] += arm * np.sin(tilt)[:, None]
    character.set_reference(0, lying, may_be_low=may_be_low)
    samples = character.step(60)
    assert samples["body_pos_w_m"][-1, CANONICAL.index("head"), 2] < 0.5
    assert bool(samples["fallen"][-1]) != may_be_low
    # The next plan does not ask for it any more.
    character.set_reference(60, lying[-20:])
    assert character.step(15)["fallen"][-1] == 1
