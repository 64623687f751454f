"""The characters of the registry: sizes, weights, and that `pd` and `kinematic` drive them all."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from shared.errors import InvalidInputError
from shared.motion.characters import BUILDS, build
from shared.motion.ik import standing_clip
from shared.motion.skeleton import CANONICAL
from shared.scenes.files import load_scene
from tracker_service.policy.learned import WEIGHTS, LearnedTracker
from tracker_service.policy.registry import make_tracker
from tracker_service.service.trackers import TrackerCatalogue
from tracker_service.simulation.character import SimulatedCharacter
from tracker_service.simulation.character_spec import CHARACTERS, HUMAN, character
from tracker_service.simulation.humanoid import humanoid, humanoid_model
from tracker_service.simulation.scene import build_scene
from tracker_service.training.dataset import MotionInput, prepare, sized
from tracker_service.training.seats import NO_SEAT

SIZES = [("human", 1.75, 72), ("child", 1.2, 25), ("heavy", 1.9, 130)]


@pytest.mark.parametrize(("name", "height_m", "mass_kg"), SIZES)
def test_sizes_and_weights(name: str, height_m: float, mass_kg: float) -> None:
    bones = build(name).skeleton
    assert bones.height_m == height_m
    np.testing.assert_allclose(bones.rest_positions_m, CANONICAL.rest_positions_m * build(name).world_scale, atol=1e-12)
    model = humanoid_model(humanoid(character(name)))
    assert model.body_mass.sum() == pytest.approx(mass_kg)
    assert CHARACTERS.keys() == BUILDS.keys()


def test_the_human_is_not_scaled() -> None:
    assert build("human").world_scale == 1.0
    assert build("human").skeleton is CANONICAL


def test_an_unknown_character_lists_the_known_ones() -> None:
    with pytest.raises(InvalidInputError) as caught:
        character("giant")
    assert (caught.value.field, caught.value.allowed) == ("character", "human, child, heavy")


@pytest.mark.parametrize("tracker", ["pd", "kinematic"])
@pytest.mark.parametrize("name", ["child", "heavy"])
def test_a_plan_in_its_own_size_is_followed(name: str, tracker: str) -> None:
    human = humanoid(character(name))
    simulated = SimulatedCharacter(build_scene(human, load_scene("flat")), make_tracker(tracker, human))
    plan = standing_clip(40, 20).positions_w_m * build(name).world_scale
    simulated.set_reference(0, plan)
    samples = simulated.step(60)
    assert samples["tracking_error_m"].max() < (0.002 if tracker == "kinematic" else 0.05)
    assert not samples["fallen"].any()
    head = samples["body_pos_w_m"][-1, CANONICAL.index("head"), 2]
    assert head == pytest.approx(human.skeleton.rest_positions_m[CANONICAL.index("head"), 2], rel=0.03)


def test_weights_drive_the_character_that_they_were_trained_with(tmp_path: Path) -> None:
    card = json.loads(WEIGHTS.with_suffix(".json").read_text())
    child = character("child")
    path = tmp_path / "child.safetensors"
    path.write_bytes(WEIGHTS.read_bytes())
    path.with_suffix(".json").write_text(json.dumps(card | {"character": "child", "skeleton": child.skeleton_id}))
    spec = LearnedTracker(humanoid(child).damping / humanoid(child).stiffness, path).spec
    assert (spec.characters, spec.skeleton) == (("child",), "child22")


def test_motion_that_is_trained_on_has_the_size_of_who_is_trained() -> None:
    stand = standing_clip(30, 30.0).positions_w_m
    motion = MotionInput("a", "sit_down", 1.0, stand, (0.5, 0.2, 0.45, 1.0, 0.0))
    assert sized(motion, humanoid(HUMAN)) is motion
    child = humanoid(character("child"))
    own = sized(motion, child)
    scale = build("child").world_scale
    np.testing.assert_allclose(own.seat, (0.5 * scale, 0.2 * scale, 0.45 * scale, 1.0, 0.0))
    assert sized(replace(motion, seat=NO_SEAT), child).seat == NO_SEAT
    references = prepare(child, [own])
    np.testing.assert_allclose(references.pos_w_m[0, 0, 2], child.character.skeleton.root_height_m, atol=0.02)
    np.testing.assert_allclose(references.pos_w_m[0], own.positions_w_m[0], atol=0.02)


def test_only_the_human_is_driven_by_the_learned_tracker() -> None:
    catalogue = TrackerCatalogue()
    if "learned" not in {spec["name"] for spec in catalogue.specs()}:
        pytest.skip("the package has no weights of the tracker")
    assert catalogue.get("learned").spec.name == "learned"
    with pytest.raises(InvalidInputError) as caught:
        catalogue.get("learned", "child")
    assert caught.value.message == "tracker 'learned' does not drive 'child'"
    assert str(caught.value.allowed).split(", ")[:2] == ["pd", "kinematic"]
    assert catalogue.get(None, "child").spec.name == "pd"
    assert catalogue.get("pd", "child") is catalogue.get("pd", "child")
    assert catalogue.get("pd", "child").spec.skeleton == "child22"
