"""The scenes of the package in physics: what stands stays, what is struck topples, what hinges turns."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from benchmarks.bag_impulse import final_tilt_deg
from shared.scenes.files import load_scene, parse_scene, scene_names
from shared.scenes.placing import sampled
from tracker_service.simulation.character_spec import HUMAN
from tracker_service.simulation.humanoid import humanoid
from tracker_service.simulation.scene import SceneModel, build_scene

HUMANOID = humanoid(HUMAN)


def settled(world: SceneModel, seconds: float) -> mujoco.MjData:
    """After some seconds with the humanoid far away."""
    data = mujoco.MjData(world.model)
    data.qpos[0] = 50.0
    for _ in range(round(seconds / world.model.opt.timestep)):
        mujoco.mj_step(world.model, data)
    return data


@pytest.mark.parametrize("name", scene_names())
@pytest.mark.parametrize("seed", [0, 1])
def test_objects_stay_where_the_scene_puts_them(name: str, seed: int) -> None:
    world = build_scene(HUMANOID, sampled(load_scene(name), seed))
    data = settled(world, 2.0)
    start = mujoco.MjData(world.model)
    mujoco.mj_kinematics(world.model, start)
    moved = np.linalg.norm(data.xpos[world.object_ids] - start.xpos[world.object_ids], axis=-1)
    assert moved.max(initial=0.0) < 0.003
    upright = data.xmat[world.object_ids][:, 8]
    assert upright.min(initial=1.0) > 0.9999


def test_a_human_blow_topples_the_bag_and_a_light_one_does_not() -> None:
    world = build_scene(HUMANOID, load_scene("bag"))
    weight = float(world.model.body_mass[world.object_ids[0]])
    assert weight == pytest.approx(63)
    for height, light, enough in ((1.5, 30.0, 40.0), (0.9, 50.0, 66.0)):
        assert final_tilt_deg(world, "bag", height, light) < 1.0
        assert final_tilt_deg(world, "bag", height, enough) > 80.0


def test_a_door_turns_about_its_hinge_and_stops_at_its_range() -> None:
    world = build_scene(HUMANOID, load_scene("walls"))
    door = int(world.object_ids[world.object_names.index("door")])
    data = mujoco.MjData(world.model)
    data.qpos[0] = 50.0
    mujoco.mj_kinematics(world.model, data)
    hinge = data.xpos[door].copy()
    for _ in range(360):
        data.xfrc_applied[door, :3] = [60.0, 0.0, 0.0]
        mujoco.mj_step(world.model, data)
    np.testing.assert_allclose(data.xpos[door], hinge, atol=1e-6)
    angle = np.degrees(np.arctan2(data.xmat[door, 3], data.xmat[door, 0]))
    assert 45 < angle < 112


def test_an_objects_own_friction_counts() -> None:
    """On a floor of friction 1 a block of friction 0.2 slides as far as v^2 / (2 mu g) says."""
    scene = parse_scene(
        "name: ice\nbodies: [{name: b, shape: box, size_m: [0.3, 0.3, 0.1], mass_kg: 4, position_w_m: [0, 3, 0.1],"
        " friction: 0.2}]"
    )
    world = build_scene(HUMANOID, scene)
    data = settled(world, 0.2)
    data.qvel[-6] = 2.0
    for _ in range(240):
        mujoco.mj_step(world.model, data)
    assert data.xpos[world.object_ids[0], 0] == pytest.approx(2.0**2 / (2 * 0.2 * 9.81), rel=0.05)


def test_a_can_rolls_and_does_not_leave_the_floor() -> None:
    """Its sides are a capsule on the floor, its ends rims of spheres: no step of its way may throw it up."""
    scene = parse_scene(
        "name: can\nbodies: [{name: can, mass_kg: 3, position_w_m: [0, 3, 0.1],"
        " parts: [{shape: cylinder, size_m: [0.1, 0.25], rotation_deg: [90, 0, 0]}]}]"
    )
    world = build_scene(HUMANOID, scene)
    data = settled(world, 0.2)
    data.qvel[-6], data.qvel[-1] = 1.0, 0.0
    heights = []
    for _ in range(240):
        mujoco.mj_step(world.model, data)
        heights.append(float(data.xpos[world.object_ids[0], 2]))
    assert data.xpos[world.object_ids[0], 0] > 1.0
    assert 0.09 < min(heights) <= max(heights) < 0.11
