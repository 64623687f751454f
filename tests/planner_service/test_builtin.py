"""`stand` and `clip`: seams, floor, arrival, conformance."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planner_service.builtin.clip import ClipPlanner, bend
from planner_service.builtin.library import ClipLibrary, words_of
from planner_service.builtin.stand import StandPlanner, minimum_jerk, settle, standing_positions
from shared.errors import InvalidInputError
from shared.motion.heading import body_heading
from shared.motion.metrics import penetration_mm, sole_points
from shared.motion.resampling import finite_velocity, resample
from shared.motion.rotations import wrap_angle
from shared.motion.skeleton import CANONICAL
from shared.plugins.conformance import LocalProbe, check_planner, require, sample_request
from shared.plugins.interfaces import Planner
from shared.protocol.messages import HeadingTarget, JointTarget, PlanRequest
from tests.planner_service.motion import walk, write_library


@pytest.fixture(scope="session")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_library(tmp_path_factory.mktemp("clips"))


@pytest.fixture(scope="session")
def clip_planner(library: Path) -> ClipPlanner:
    return ClipPlanner(ClipLibrary.load(library))


def after(positions: np.ndarray, frame: int, **fields: object) -> PlanRequest:
    """A request whose prefix ends with a frame of a motion at 20 fps."""
    velocity = finite_velocity(positions, 20.0)
    return PlanRequest(
        start_tick=0,
        prefix_positions_w_m=positions[frame : frame + 1],
        prefix_rotations_6d=np.zeros((1, 22, 6)),
        prefix_velocities_w_mps=velocity[frame : frame + 1],
        **fields,
    )


def closed_loop(planner: Planner, seconds: float, **fields: object) -> np.ndarray:
    """Positions (T, 22, 3) when each half second's end is the next prefix; no physics."""
    request = sample_request(planner.spec, **fields)
    done = [np.asarray(request.prefix_positions_w_m, dtype=np.float64)]
    while sum(map(len, done)) < seconds * 20:
        plan = planner.plan([request])[0]
        done.append(np.asarray(plan.positions_w_m[:10], dtype=np.float64))
        velocity = finite_velocity(done[-1], 20.0)
        request = request.model_copy(
            update={"prefix_positions_w_m": done[-1][-1:], "prefix_velocities_w_mps": velocity[-1:]}
        )
    return np.concatenate(done)


def test_minimum_jerk_by_hand() -> None:
    np.testing.assert_allclose(minimum_jerk([-1, 0, 0.5, 1, 2]), [0, 0, 0.5, 1, 1])


def test_standing_is_on_the_floor_with_feet_below_the_hips() -> None:
    p = standing_positions([1.0, 2.0], 0.5)
    assert np.abs(sole_points(p[None])[..., 2]).max() < 1e-3
    assert float(body_heading(p)) == pytest.approx(0.5, abs=0.01)
    np.testing.assert_allclose(p[0, :2], [1.0, 2.0])


def test_who_stands_stays() -> None:
    p = standing_positions([1.0, 2.0], 0.5)
    out = settle(p, np.zeros((22, 3)), np.arange(1, 41) / 20)
    assert np.abs(out - p).max() < 1e-3


@settings(max_examples=12)
@given(frame=st.integers(5, 100), speed=st.floats(0.3, 1.5))
def test_a_walker_comes_to_a_stand(frame: int, speed: float) -> None:
    motion = resample(walk(6.0, speed), 30.0, 20.0)
    frame %= len(motion)
    plan = StandPlanner().plan([after(motion, frame, horizon_frames=60)])[0]
    whole = np.concatenate([motion[frame : frame + 1], plan.positions_w_m])
    steps = np.linalg.norm(np.diff(whole, axis=0), axis=-1)
    assert steps[0].max() < 0.25
    assert steps[-10:].max() < 1e-3
    assert penetration_mm(plan.positions_w_m) < 1.0
    assert np.abs(sole_points(plan.positions_w_m[-1:])[..., 2]).max() < 2e-3
    drift = plan.positions_w_m[-1, 0, :2] - motion[frame, 0, :2]
    assert np.linalg.norm(drift) < 0.61


@pytest.mark.parametrize("name", ["stand", "clip"])
def test_conformance(name: str, clip_planner: ClipPlanner) -> None:
    require(check_planner(LocalProbe(StandPlanner() if name == "stand" else clip_planner)))


def test_words_are_cut_to_their_stems() -> None:
    assert words_of("A person WALKS, walking.") == {"walk"}
    assert words_of("running, she runs") == {"run", "she"}
    assert words_of("waves waving wave") == {"wav"}


def test_the_text_chooses_the_clip(clip_planner: ClipPlanner) -> None:
    walked = closed_loop(clip_planner, 4.0, text="Walk on, please")
    assert np.linalg.norm(walked[-1, 0, :2] - walked[0, 0, :2]) > 2.0
    waved = closed_loop(clip_planner, 4.0, text="someone is waving")
    wrist, shoulder = CANONICAL.indices("right_wrist", "right_shoulder")
    assert (waved[:, wrist, 2] - waved[:, shoulder, 2]).max() > 0.2
    assert np.linalg.norm(waved[-1, 0, :2] - waved[0, 0, :2]) < 0.3
    still = closed_loop(clip_planner, 4.0, text="recite a poem")
    assert np.linalg.norm(still[-1, 0, :2] - still[0, 0, :2]) < 0.05


@pytest.mark.parametrize("angle", [0.0, 1.0, 2.0, 3.1, -2.5])
def test_it_walks_to_a_point_and_stops_there(clip_planner: ClipPlanner, angle: float) -> None:
    goal = 2.5 * np.array([np.cos(angle), np.sin(angle)])
    target = JointTarget(joint="traj", position_w_m=(float(goal[0]), float(goal[1]), 0.0), arrival_tick=60)
    motion = closed_loop(clip_planner, 12.0, text="a person walks", targets=[target])
    away = np.linalg.norm(motion[:, 0, :2] - goal, axis=-1)
    assert away[-40:].max() < 0.3
    assert np.linalg.norm(np.diff(motion, axis=0), axis=-1).max() < 0.5


def test_it_turns_to_a_heading(clip_planner: ClipPlanner) -> None:
    heading = HeadingTarget(heading_rad=1.5, arrival_tick=60)
    motion = closed_loop(clip_planner, 6.0, text="walk", heading=heading)
    assert abs(float(wrap_angle(float(body_heading(motion[-1])) - 1.5))) < 0.4


@settings(max_examples=15)
@given(turn=st.floats(-3.1, 3.1))
def test_bending_keeps_bones_and_pace(turn: float) -> None:
    motion = resample(walk(2.0), 30.0, 20.0)
    bent = bend(motion, turn)
    np.testing.assert_allclose(bent[0], motion[0], atol=1e-9)
    parents = np.maximum(CANONICAL.parents, 0)
    np.testing.assert_allclose(
        np.linalg.norm(bent - bent[:, parents], axis=-1),
        np.linalg.norm(motion - motion[:, parents], axis=-1),
        atol=1e-9,
    )
    np.testing.assert_allclose(
        np.linalg.norm(np.diff(bent[:, 0], axis=0), axis=-1), np.linalg.norm(np.diff(motion[:, 0], axis=0), axis=-1)
    )


def test_what_is_not_done_is_said(clip_planner: ClipPlanner) -> None:
    target = JointTarget(joint="left_wrist", position_w_m=(0.5, 0.0, 1.0), arrival_tick=60)
    plan = clip_planner.plan([sample_request(clip_planner.spec, targets=[target], desired_velocity_w_mps=(1, 0))])[0]
    assert plan.ignored_conditions == ["target:left_wrist"], "the service adds what `conditions` does not hold"


def test_an_empty_library_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(InvalidInputError) as caught:
        ClipLibrary.load(tmp_path)
    assert caught.value.field == "clip_library"


def test_a_damaged_file_is_left_out(library: Path, tmp_path: Path) -> None:
    write_library(tmp_path)
    (tmp_path / "broken.npz").write_bytes(b"PK no")
    (tmp_path / "broken.bvh").write_text("HIERARCHY nonsense")
    assert {clip.name for clip in ClipLibrary.load(tmp_path).clips} == {"walk", "wave"}
