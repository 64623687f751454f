"""Real physics: standing, being pushed, snapshot and restore bit for bit, errors that change nothing."""

from __future__ import annotations

import numpy as np
import pytest

from shared.errors import InvalidInputError
from shared.motion.ik import standing_clip
from shared.scenes.files import load_scene, parse_scene
from tracker_service.policy.registry import make_tracker
from tracker_service.simulation.character import SimulatedCharacter
from tracker_service.simulation.character_spec import HUMAN
from tracker_service.simulation.humanoid import humanoid, humanoid_model
from tracker_service.simulation.scene import build_scene

HUMANOID = humanoid(HUMAN)
FLAT = build_scene(HUMANOID, load_scene("flat"))


def make(tracker: str = "pd", **kwargs: object) -> SimulatedCharacter:
    return SimulatedCharacter(FLAT, make_tracker(tracker, HUMANOID), **kwargs)  # type: ignore[arg-type]


def test_the_model_weighs_what_it_should() -> None:
    model = humanoid_model(HUMANOID)
    assert model.body_mass.sum() == pytest.approx(72.0)
    assert (model.nq, model.nv, model.nu) == (47, 46, 40)
    np.testing.assert_allclose(model.jnt_range[1:, 0], HUMANOID.hinges.lower, atol=1e-9)


def test_standing_stays_standing_on_both_feet() -> None:
    character = make(heading_rad=1.0, xy_w_m=(2.0, -1.0))
    samples = character.step(45)
    assert samples["body_pos_w_m"].shape == (180, 22, 3)
    assert samples["tracking_error_m"].max() < 0.06
    assert samples["contacts"][-1].sum() >= 2
    assert not samples["fallen"].any()
    np.testing.assert_allclose(samples["body_pos_w_m"][-1, 0, :2], [2.0, -1.0], atol=0.1)


def test_a_hard_push_makes_it_fall_and_reset_stands_it_up() -> None:
    character = make()
    character.impulse("spine3", (150.0, 0.0, 0.0))
    samples = character.step(60)
    assert samples["fallen"][-1] == 1
    assert character.fallen
    character.reset((0.0, 0.0), 0.0)
    assert not character.step(6)["fallen"].any()


def test_restore_continues_bit_for_bit() -> None:
    character = make()
    plan = standing_clip(40, 20).positions_w_m.copy()
    plan[:, :, 0] += np.linspace(0, 0.3, 40)[:, None]
    character.step(6)
    character.set_reference(6, plan)
    character.impulse("pelvis", (20.0, 5.0, 0.0))
    snapshot = character.snapshot()
    first = character.step(30)
    character.restore(*snapshot)
    again = character.step(30)
    other = make()
    other.restore(*snapshot)
    third = other.step(30)
    for name, value in first.items():
        np.testing.assert_array_equal(value, again[name])
        np.testing.assert_array_equal(value, third[name])


def test_kinematic_shows_the_plan_itself() -> None:
    character = make("kinematic")
    plan = standing_clip(40, 20).positions_w_m.copy()
    plan[:, :, 0] += np.linspace(0, 1.0, 40)[:, None] ** 2
    character.set_reference(0, plan)
    samples = character.step(57)
    # Tick 3 k is frame 2 k: sample index 6 k - 1 of what step returned is plan frame 2 k - 1.
    for k in (1, 5, 18):
        np.testing.assert_allclose(samples["body_pos_w_m"][12 * k - 1], plan[2 * k - 1], atol=1e-3)
    assert samples["tracking_error_m"].max() < 0.01


def test_a_plan_ends_in_a_stand() -> None:
    character = make("kinematic")
    plan = standing_clip(20, 20).positions_w_m.copy()
    plan[:, :, 0] += np.linspace(0, 1.0, 20)[:, None]
    character.set_reference(0, plan)
    assert character.reference.plan_end_tick == 30
    end = character.reference.at(200)
    assert np.abs(end.linvel_w_mps).max() < 1e-12
    assert 1.0 <= end.pos_w_m[0, 0, 0] < 1.6
    jump = np.abs(np.diff(character.reference.at(0, 80).pos_w_m, axis=0)).max()
    assert jump < 0.12


def test_action_chunks_drive_the_servos() -> None:
    character = make()
    elbow = HUMANOID.hinges.names.index("left_elbow_0")
    chunk = np.tile(character.reference.at(0).hinges_rad[0], (20, 1))
    chunk[:, elbow] = 1.8
    character.driver.set_actions(0, chunk)
    character.step(20)
    assert character.observe().hinge_pos_rad[elbow] == pytest.approx(1.8, abs=0.2)


@pytest.mark.parametrize(
    ("call", "field"),
    [
        (lambda c: c.set_reference(1, np.zeros((5, 22, 3))), "start_tick"),
        (lambda c: c.set_reference(0, np.zeros((5, 21, 3))), "positions_w_m"),
        (lambda c: c.set_reference(0, np.full((5, 22, 3), np.nan)), "positions_w_m"),
        (lambda c: c.driver.set_actions(0, np.zeros((5, 7))), "actions"),
        (lambda c: c.impulse("tail", (1.0, 0.0, 0.0)), "joint"),
        (lambda c: c.impulse("head", (np.inf, 0.0, 0.0)), "impulse_w_ns"),
    ],
)
def test_bad_input_names_the_field_and_changes_nothing(call: object, field: str) -> None:
    character, untouched = make(), make()
    with pytest.raises(InvalidInputError) as caught:
        call(character)  # type: ignore[operator]
    assert caught.value.field == field
    np.testing.assert_array_equal(character.step(3)["body_pos_w_m"], untouched.step(3)["body_pos_w_m"])


def test_scene_objects_take_part() -> None:
    scene = parse_scene(
        """
        name: box
        bodies:
          - {name: crate, shape: box, size_m: [0.2, 0.2, 0.2], mass_kg: 5, position_w_m: [2, 0, 0.5]}
          - {name: wall, shape: box, size_m: [0.1, 1, 1], position_w_m: [4, 0, 1], heading_deg: 90}
        """
    )
    character = SimulatedCharacter(build_scene(HUMANOID, scene), make_tracker("pd", HUMANOID))
    samples = character.step(45)
    assert samples["object_pose_w"].shape == (180, 2, 7)
    assert samples["object_pose_w"][-1, 0, 2] == pytest.approx(0.2, abs=0.01)
    np.testing.assert_allclose(samples["object_pose_w"][-1, 1, :3], [4, 0, 1])


def test_a_wrong_scene_names_the_field() -> None:
    with pytest.raises(InvalidInputError) as caught:
        parse_scene("name: x\nbodies: [{name: a, shape: box, size_m: [1], position_w_m: [0, 0, 0]}]")
    assert str(caught.value.field).startswith("scene.bodies")
