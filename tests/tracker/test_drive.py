"""Action chunks, latents decoded each tick, and trackers that raise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import pytest

from shared.errors import InvalidInputError, SimulationError
from shared.plugins.interfaces import TrackerObservation, TrackerSpec
from shared.scenes.files import load_scene
from tracker_service.policy.registry import make_tracker
from tracker_service.simulation.character import SimulatedCharacter
from tracker_service.simulation.character_spec import HUMAN
from tracker_service.simulation.humanoid import humanoid
from tracker_service.simulation.scene import build_scene

HUMANOID = humanoid(HUMAN)
FLAT = build_scene(HUMANOID, load_scene("flat"))
ELBOW = HUMANOID.hinges.names.index("left_elbow_0")
Array = npt.NDArray[np.floating]


class Latent:
    """Latent actions of width 2: what the left elbow's target lies above its present angle."""

    def __init__(self, breaks_in: str = "", error: BaseException | None = None):
        self.spec = TrackerSpec(
            name="latent", version="1", skeleton="human22", fps=30, action_spaces=("servo_targets", "elbow")
        )
        self.breaks_in, self.error = breaks_in, error or RuntimeError("no idea")
        self.calls: list[str] = []

    def _call(self, name: str) -> None:
        self.calls.append(name)
        if name == self.breaks_in:
            raise self.error

    def reset(self, character_ids: Sequence[str]) -> None:
        self._call("reset")

    def act(self, character_ids: Sequence[str], observations: Sequence[TrackerObservation]) -> Array:
        self._call("act")
        return np.stack([o.ref_hinge_rad[0] for o in observations])

    def decode(self, latents: Array, observations: Sequence[TrackerObservation]) -> Array:
        self._call("decode")
        targets = np.stack([o.ref_hinge_rad[0] for o in observations])
        targets[:, ELBOW] = [o.hinge_pos_rad[ELBOW] + lead for o, (lead, _) in zip(observations, latents, strict=True)]
        return targets


def make(tracker: object) -> SimulatedCharacter:
    return SimulatedCharacter(FLAT, tracker)  # type: ignore[arg-type]


def test_latents_are_decoded_with_the_state_of_their_tick() -> None:
    character = make(Latent())
    character.driver.set_actions(0, np.tile([0.2, 0.0], (10, 1)), "elbow")
    samples = character.step(12)
    angle, target = samples["hinge_pos_rad"][:, ELBOW], samples["servo_target_rad"][::4, ELBOW]
    assert target[0] == pytest.approx(character.reference.at(0).hinges_rad[0, ELBOW] + 0.2, abs=1e-6)
    np.testing.assert_allclose(target[1:10], angle[3:39:4] + 0.2, atol=1e-6)
    assert target[10] == pytest.approx(character.reference.at(11).hinges_rad[0, ELBOW]), "then the tracker acts again"
    assert character.driver.tracker.calls.count("decode") == 10  # type: ignore[attr-defined]


def test_a_plan_without_actions_ends_the_old_chunk_at_its_start() -> None:
    character = make(make_tracker("pd", HUMANOID))
    chunk = np.tile(character.reference.at(0).hinges_rad[0], (60, 1))
    chunk[:, ELBOW] = 1.5
    character.driver.set_actions(0, chunk)
    character.driver.end_actions(12)
    targets = character.step(15)["servo_target_rad"][::4, ELBOW]
    np.testing.assert_allclose(targets[:12], 1.5)
    assert (np.abs(targets[12:] - 1.5) > 0.5).all()


@pytest.mark.parametrize(
    ("tracker", "actions", "space", "field"),
    [
        ("pd", np.zeros((3, 2)), "elbow", "action_space"),
        ("kinematic", np.zeros((3, 40)), "servo_targets", "action_space"),
        ("pd", np.zeros((3, 7)), "servo_targets", "actions"),
        ("pd", np.full((3, 40), np.nan), "servo_targets", "actions"),
        ("pd", np.zeros((3, 40)), None, "action_space"),
    ],
)
def test_actions_that_do_not_fit_the_tracker_are_refused(
    tracker: str, actions: Array, space: str | None, field: str
) -> None:
    character = make(make_tracker(tracker, HUMANOID))
    with pytest.raises(InvalidInputError) as caught:
        character.driver.check_actions(actions, space)
    assert caught.value.field == field


def test_a_chunk_in_a_space_that_the_next_tracker_does_not_take_is_dropped() -> None:
    character = make(Latent())
    character.driver.set_actions(0, np.tile([0.2, 0.0], (30, 1)), "elbow")
    character.step(3)
    character.set_tracker(make_tracker("pd", HUMANOID))
    character.step(3)
    assert character.driver.failure is None


def test_pushes_given_to_what_is_only_shown_do_not_wait_for_physics() -> None:
    pushed, quiet = (make(make_tracker("kinematic", HUMANOID)) for _ in range(2))
    for _ in range(5):
        pushed.impulse("spine3", (100.0, 0.0, 0.0))
        pushed.step(1)
        quiet.step(1)
    for character in (pushed, quiet):
        character.set_tracker(make_tracker("pd", HUMANOID))
    np.testing.assert_array_equal(pushed.step(10)["body_pos_w_m"], quiet.step(10)["body_pos_w_m"])


@pytest.mark.parametrize("error", [RuntimeError("no idea"), KeyError("joint"), SystemExit(3), RecursionError("deep")])
@pytest.mark.parametrize("call", ["act", "decode"])
def test_whatever_a_tracker_raises_the_clock_goes_on_and_says_why(call: str, error: BaseException) -> None:
    tracker = Latent(breaks_in=call, error=error)
    character = make(tracker)
    if call == "decode":
        character.driver.set_actions(0, np.zeros((5, 2)), "elbow")
    samples = character.step(30)
    assert character.tick == 30
    assert f"tracker 'latent' failed in {call} at tick 0: {type(error).__name__}" in str(character.driver.failure)
    assert tracker.calls.count(call) == 1, "it is not asked again until it is resumed"
    assert samples["body_pos_w_m"][-1, 0, 2] > 0.8, "the servos hold the reference meanwhile"
    tracker.breaks_in = ""
    character.driver.resume()
    assert character.driver.failure is None
    character.step(1)
    assert tracker.calls[-2:] == ["reset", "act"]


def test_a_tracker_that_cannot_be_reset_says_so_and_does_not_replace_another() -> None:
    character = make(Latent(breaks_in="reset"))
    assert "failed in reset: RuntimeError: no idea" in str(character.driver.failure)
    character.step(3)
    good = make(make_tracker("pd", HUMANOID))
    with pytest.raises(SimulationError, match="failed in reset"):
        good.set_tracker(Latent(breaks_in="reset"))
    assert good.tracker.spec.name == "pd"


def test_targets_of_the_wrong_shape_are_a_failure_of_the_tracker() -> None:
    tracker = Latent()
    tracker.act = lambda ids, observations: np.zeros(3)  # type: ignore[method-assign]
    character = make(tracker)
    character.step(2)
    assert "ValueError: it gave targets of shape (3,)" in str(character.driver.failure)
