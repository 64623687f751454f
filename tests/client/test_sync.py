"""The blocking client over three real processes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from motionloop import Client, Event, Motion, MotionLoopError, PlanGhost, ServerProblem, State
from orchestrator.core.supervise import Stack
from shared.errors import ConflictError, DeadlineError, InvalidInputError, UnavailableError
from shared.tasks.specs import HaltSpec

SHORT_HALT = {"type": "halt", "settle_s": 0.5, "duration_s": 0.5}


def test_a_lockstep_character_is_told_stepped_pushed_and_recorded(client: Client, tmp_path: Path) -> None:
    with client.character(pacing="lockstep", seed=3, tracker="pd") as character:
        assert character.say("a person is standing still.") == 0
        state = character.step(30)
        assert (state.tick, state.time_s, state.tracker) == (30, 1.0, "pd")
        assert state.positions_w_m.shape == (22, 3)
        assert np.allclose(np.linalg.norm(state.quats_w, axis=-1), 1.0, atol=1e-4)
        assert state.contacts.any()
        assert state.joint("head")[2] > 1.4
        assert np.array_equal(state.pelvis_w_m, state.joint("pelvis"))
        with pytest.raises(InvalidInputError, match="tail"):
            state.joint("tail")
        character.push("spine3", (0.0, 60.0, 0.0))
        pushed = character.step(6)
        assert pushed.joint("spine3")[1] > state.joint("spine3")[1] + 0.02
        info = character.info()
        assert (info.command["text"], info.pacing, info.seed) == ("a person is standing still.", "lockstep", 3)
        motion = character.motion(seconds=10)
        assert len(motion) == 37
        assert np.allclose(motion.joint("spine3")[-1], pushed.joint("spine3"), atol=1e-4)
        assert character.motion(seconds=0.5).start_tick == 36 + 1 - 15
        assert character.save(tmp_path / "new" / "motion.bvh").read_text().startswith("HIERARCHY")
        assert character.save(tmp_path / "motion.glb").read_bytes().startswith(b"glTF")
        upright = character.reset()
        assert not upright.fallen
    assert character.id not in [info.id for info in client.characters.all()]
    character.close()
    for act in (character.info, character.pause, lambda: next(character.stream())):
        with pytest.raises(ServerProblem) as problem:
            act()
        assert problem.value.code == "not_found"


def test_characters_are_found_again(client: Client) -> None:
    one, two = client.character(pacing="lockstep"), client.character(pacing="lockstep")
    assert [character.id for character in client.characters] == [one.id, two.id]
    assert len(client.characters) == 2
    assert client.characters[two.id].state().tick == 0
    assert repr(client.characters.get(one.id)) == f"Character('{one.id}')"


def test_a_realtime_character_is_watched(client: Client) -> None:
    character = client.character(planner="clip")
    character.say("a person walks forward", target=(1.0, 0.0))
    ticks = [state.tick for state, _ in zip(character.stream(timeout_s=30), range(10), strict=False)]
    assert ticks == sorted(set(ticks))
    kinds = {type(message) for message, _ in zip(character.watch(timeout_s=30), range(40), strict=False)}
    assert {State, Event} <= kinds
    ghost = next(message for message in character.watch(timeout_s=30) if isinstance(message, PlanGhost))
    assert ghost.positions_w_m.shape[1:] == (22, 3)
    told = next(event for event in character.events(timeout_s=30) if event.type == "command")
    assert told.data["target"] == {"joint": "traj", "position_m": [1.0, 0.0, 0.0]}
    moved = character.wait_for(lambda state: state.pelvis_w_m[0] > 0.3, timeout_s=60)
    assert moved.pelvis_w_m[0] > 0.3
    with pytest.raises(DeadlineError, match="did not hold"):
        character.wait_for(lambda state: False, timeout_s=0.2)
    paused = character.pause().tick
    assert character.info().status == "paused"
    assert character.step(3).tick == paused + 3
    character.resume()
    events = character.events(timeout_s=30)
    assert next(events).type == "created"
    character.close()
    assert [event.type for event in events][-1] == "closed"


def test_an_episode_is_followed_saved_and_found_again(client: Client, tmp_path: Path) -> None:
    episode = client.episode([SHORT_HALT, HaltSpec(settle_s=0.5, duration_s=0.5)], seed=5, name="two halts")
    with pytest.raises(ConflictError, match="wait"):
        _ = episode.result
    seen: list[Event] = []
    result = episode.wait(timeout_s=120, on_event=seen.append)
    assert [event.seq for event in seen] == list(range(1, len(seen) + 1))
    assert (result.status, result.success, len(result.results)) == ("finished", True, 2)
    assert result.spec["name"] == "two halts"
    assert episode.result == result == episode.wait()
    motion = episode.motion()
    assert len(motion) == (result.tick or 0) + 1
    assert motion.duration_s == pytest.approx((result.tick or 0) / 30)
    assert motion.times_s[-1] == pytest.approx(motion.duration_s)
    assert (motion.skeleton, motion.objects, motion.object_poses_w.shape) == ("human22", (), (len(motion), 0, 7))
    assert np.abs(motion.clip().positions_w_m - motion.positions_w_m).max() == 0
    for suffix in ("npz", "csv", "bvh", "glb"):
        assert episode.save(tmp_path / f"e.{suffix}").stat().st_size > 1000
    again = Motion.from_npz(tmp_path / "e.npz")
    assert np.array_equal(again.positions_w_m, motion.positions_w_m)
    with pytest.raises(InvalidInputError, match="no recorded motion"):
        Motion.from_npz(tmp_path / "e.csv")
    with pytest.raises(InvalidInputError) as wrong:
        episode.save(tmp_path / "e.fbx")
    assert ".glb" in str(wrong.value.allowed)
    assert client.episodes[episode.id].wait().id == episode.id
    assert episode.id in [info.id for info in client.episodes.all(status="finished")]
    episode.cancel()
    episode.delete()
    with pytest.raises(ServerProblem, match="no episode"):
        client.episodes.get(episode.id)


def test_a_running_episode_can_be_waited_for_in_pieces_and_cancelled(client: Client) -> None:
    episode = client.episode([{"type": "halt", "duration_s": 100}], pacing="realtime")
    with pytest.raises(DeadlineError, match="cancel"):
        episode.wait(timeout_s=0.3)
    for refused in (episode.delete, episode.motion):
        with pytest.raises(MotionLoopError, match="still run"):
            refused()
    episode.cancel()
    assert episode.wait(timeout_s=60).status == "cancelled"


def test_services_are_shown_and_swapped(client: Client) -> None:
    assert client.ready()
    before = client.services()
    assert (before.planner.plugin, before.tracker.plugin) == ("stand", "kinematic")
    assert "clip" in before.planner.plugins
    try:
        assert client.swap("planner", "clip").plugin == "clip"
        assert client.services().planner.plugin == "clip"
    finally:
        client.swap("planner", "stand")
    with pytest.raises(ServerProblem) as refused:
        client.swap("planner", "oracle")
    assert "clip" in str(refused.value.allowed)
    assert client.services() == before


def test_what_the_server_refuses_names_the_field(client: Client) -> None:
    character = client.character(pacing="lockstep")
    with pytest.raises(ServerProblem) as problem:
        character.say("reach out", target=(0.5, 0.0, 1.0), joint="nose")
    assert (problem.value.status, problem.value.code, problem.value.field) == (422, "invalid_input", "target.joint")
    assert "left_wrist" in str(problem.value.allowed)
    assert not problem.value.retryable
    assert problem.value.errors[0]["field"] == "target.joint"
    with pytest.raises(InvalidInputError, match="target"):
        character.say("walk", target=(1.0, 2.0), joint="left_wrist")
    with pytest.raises(InvalidInputError, match="target"):
        character.say("walk", target=(1.0,))
    with pytest.raises(ServerProblem) as unknown:
        client.character(tracker="puppet")
    assert unknown.value.field == "tracker"


def test_without_a_server_the_error_says_what_to_do(free_port: Callable[[], int]) -> None:
    url = f"http://127.0.0.1:{free_port()}"
    with Client(url) as nobody:
        assert not nobody.ready()
        for ask in (nobody.services, nobody.character, lambda: nobody.characters.all()):
            with pytest.raises(UnavailableError, match="motionloop serve all") as error:
                ask()
            assert url in str(error.value)
            assert error.value.retryable


def test_the_token_is_sent_everywhere(stack: Stack, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MOTIONLOOP_URL", stack.url)
    monkeypatch.setenv("MOTIONLOOP_TOKEN", "a-token-of-the-environment")
    with Client() as found:
        assert found.address.url == stack.url
        assert found.address.headers == {"Authorization": "Bearer a-token-of-the-environment"}
        assert found.ready()
    with pytest.raises(InvalidInputError, match="address"):
        Client("localhost:8080")


def test_a_scene_of_ones_own_and_an_object_that_is_thrown(client: Client) -> None:
    ball = {"name": "ball", "shape": "sphere", "size_m": [0.1], "mass_kg": 0.5, "position_w_m": [2, 0, 0.1]}
    with client.character(pacing="lockstep", tracker="pd", scene={"bodies": [ball]}) as character:
        assert character.objects()["ball"].position_m == (2.0, 0.0, 0.1)
        thrown = character.move_object("ball", position_m=(2, 1, 1), velocity_mps=(0, 3, 0))
        assert (thrown.position_m, thrown.velocity_mps) == ((2.0, 1.0, 1.0), (0.0, 3.0, 0.0))
        character.step(6)
        assert character.objects()["ball"].position_m[1] == pytest.approx(1.6, abs=0.02)
        with pytest.raises(ServerProblem, match="unknown object 'cube'"):
            character.move_object("cube", position_m=(0, 0, 0))
