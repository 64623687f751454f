"""Which horizontal blow topples the bag of a scene: the least impulse by height of the blow, by bisection in physics.

    python benchmarks/bag_impulse.py [--scene bag] [--json FILE]

Beside it stands the reckoning for a rigid body that tips about the edge of its base without sliding: the blow's angular
momentum about the edge must lift the centre of mass over it, J z >= sqrt(2 I m g (sqrt(h^2 + r^2) - h)).
"""

from __future__ import annotations

import argparse
import json
import platform
from pathlib import Path

import mujoco
import numpy as np

from shared.scenes.files import load_scene
from shared.scenes.schema import Scene
from tracker_service.simulation.character_spec import HUMAN
from tracker_service.simulation.humanoid import humanoid
from tracker_service.simulation.scene import SceneModel, build_scene

HEIGHTS_M = (1.5, 1.3, 1.1, 0.9, 0.7)
TOPPLED_DEG = 75.5
SECONDS = 4.0
BLOW_STEPS = 2


def final_tilt_deg(world: SceneModel, body: str, height_m: float, impulse_ns: float) -> float:
    """Angle of the body's axis with the vertical, four seconds after a blow along X at a height."""
    model, data = world.model, mujoco.MjData(world.model)
    number = int(world.object_ids[world.object_names.index(body)])
    data.qpos[:3] = [50.0, 0.0, 1.0]  # the humanoid is out of the way
    for _ in range(30):
        mujoco.mj_step(model, data)
    force = np.array([impulse_ns / (BLOW_STEPS * model.opt.timestep), 0.0, 0.0])
    for step in range(round(SECONDS / model.opt.timestep)):
        data.xfrc_applied[:] = 0.0
        if step < BLOW_STEPS:
            arm = np.array([0.0, 0.0, height_m - data.xipos[number, 2]])
            data.xfrc_applied[number] = [*force, *np.cross(arm, force)]
        mujoco.mj_step(model, data)
    return float(np.degrees(np.arccos(np.clip(data.xmat[number, 8], -1.0, 1.0))))


def least_impulse_ns(world: SceneModel, body: str, height_m: float) -> float:
    """The least impulse after which the body lies, to 0.5 N s."""
    low, high = 0.0, 400.0
    while high - low > 0.5:
        middle = (low + high) / 2
        if final_tilt_deg(world, body, height_m, middle) >= TOPPLED_DEG:
            high = middle
        else:
            low = middle
    return high


def reckoned_ns(world: SceneModel, scene: Scene, body: str, height_m: float) -> float:
    """The same by the formula above."""
    model = world.model
    number = int(world.object_ids[world.object_names.index(body)])
    mass, centre = float(model.body_mass[number]), float(model.body_ipos[number, 2])
    item = scene.body(body)
    assert item is not None
    radius = max(part.size_m[0] for part in item.parts)
    about_centre = float(sorted(model.body_inertia[number])[1])
    about_edge = about_centre + mass * (centre**2 + radius**2)
    lift_j = mass * 9.81 * (np.hypot(centre, radius) - centre)
    return float(np.sqrt(2 * about_edge * lift_j) / height_m)


def main() -> None:
    """Print the table; `--json` writes it too."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scene", default="bag")
    parser.add_argument("--body", default="bag")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    scene = load_scene(options.scene)
    world = build_scene(humanoid(HUMAN), scene)
    rows = []
    for height in HEIGHTS_M:
        row = {
            "height_m": height,
            "least_impulse_ns": least_impulse_ns(world, options.body, height),
            "reckoned_ns": reckoned_ns(world, scene, options.body, height),
        }
        rows.append(row)
        print(f"{height:4.1f} m: {row['least_impulse_ns']:6.1f} N s (reckoned {row['reckoned_ns']:.1f})", flush=True)
    if options.json:
        about = {"scene": options.scene, "toppled_deg": TOPPLED_DEG, "machine": platform.platform(), "rows": rows}
        options.json.write_text(json.dumps(about, indent=2) + "\n")


if __name__ == "__main__":
    main()
