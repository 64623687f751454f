"""Measure DiP without physics: `python -m planner_service.training.evaluate --corpus DIR [--weights FILE]`.

Reaching and text commands run in the closed loop of `rollout`, judged by the rules of `shared.tasks`; errors of
targets, keyframes and velocities (as far as the weights take them), skating and jerk are those of single plans on
held-out windows.
"""

from __future__ import annotations

import json
import os
import platform
import time
from pathlib import Path
from typing import Annotated

import numpy as np
import numpy.typing as npt
import torch
import typer

from planner_service.dip.conditions import JOINT_SLOTS
from planner_service.dip.planner import DipPlanner
from planner_service.dip.weights import SHIPPED
from planner_service.training.dataset import Material, WindowSampler, load_material
from planner_service.training.evaluate_conditions import conditions
from planner_service.training.rollout import Rollout
from planner_service.training.windows import window_positions
from shared.console import errors_for_people
from shared.data.corpus import Corpus
from shared.motion.heading import body_heading
from shared.motion.ik import standing_clip
from shared.motion.metrics import (
    floating_mm,
    foot_contacts,
    jerk_mps3,
    penetration_mm,
    skating_mm_per_frame,
    sole_points,
)
from shared.motion.rotations import wrap_angle
from shared.motion.skeleton import CANONICAL
from shared.plugins.interfaces import Planner
from shared.protocol.messages import HeadingTarget, JointTarget, PlanRequest
from shared.protocol.rates import PLANNER_FPS as FPS
from shared.tasks.builtin import ReachTask
from shared.tasks.interface import BodyView, PlanGoal
from shared.tasks.obey import kind_of, obeyed
from shared.tasks.specs import ReachSpec

Array = npt.NDArray[np.float64]

COMMANDS = (
    "a person walks forward.",
    "walk",
    "a person is running.",
    "run forward",
    "turn left",
    "a person turns around to the right.",
    "a person waves with the right hand.",
    "wave with the left hand",
    "a person jumps.",
    "jump",
    "a person is standing still.",
    "stand still",
)


def reach(planner: Planner, episodes: int, seed: int, seconds: int = 12) -> dict[str, object]:
    """Walk from standing to random points 1-3 m away in any direction, replanning every second."""
    start = np.repeat(standing_clip(20, FPS).positions_w_m[None], episodes, 0)
    rollout = Rollout(planner, start, seed)
    tasks = [ReachTask(ReachSpec(), seed + i) for i in range(episodes)]
    for body, task in enumerate(tasks):
        task.start(BodyView(0, start[body, -1]))
    for _ in range(seconds):
        rollout.step(lambda body, view: tasks[body].goal(view, rollout.tick))
    verdicts = [task.judge(rollout.trace(i, 19)) for i, task in enumerate(tasks)]
    met = [v.seconds for v in verdicts if v.code]
    missed = [{k: round(x, 2) for k, x in v.measures.items()} for v in verdicts if not v.strict]
    return {
        "episodes": episodes,
        "reached": sum(v.code for v in verdicts) / episodes,
        "reached_and_held": sum(v.strict for v in verdicts) / episodes,
        "median_time_s": float(np.median(met)) if met else None,
        "missed": missed,
        "skating_contact_mm": float(np.mean([contact_slide_mm(rollout.frames(i)) for i in range(episodes)])),
    }


def text(planner: Planner, repeats: int, seed: int, seconds: int = 5) -> tuple[dict[str, object], dict[str, Array]]:
    """Every command `repeats` times, each after another one, five seconds each; also motions to look at, by command."""
    rng = np.random.default_rng(seed)
    order = [list(rng.permutation(len(COMMANDS))) for _ in range(repeats)]
    rollout = Rollout(planner, np.repeat(standing_clip(20, FPS).positions_w_m[None], repeats, 0), seed)
    tally: dict[str, list[bool]] = {}
    misses: list[str] = []
    shown: dict[str, Array] = {}
    for k in range(len(COMMANDS)):
        since = rollout.lengths()[0] - 1
        for _ in range(seconds):
            rollout.step(lambda body, view: PlanGoal(text=COMMANDS[order[body][k]]))  # noqa: B023 - used at once
        for body in range(repeats):
            command = COMMANDS[order[body][k]]
            result = obeyed(command, rollout.trace(body, since))
            tally.setdefault(kind_of(command), []).append(result.obeyed)
            shown.setdefault(command, rollout.frames(body)[since:])
            if not result.obeyed:
                before = COMMANDS[order[body][k - 1]] if k else "start"
                measures = {name: round(v, 2) for name, v in result.measures.items()}
                misses.append(f"{command} (after {before}): {measures}")
    by_kind = {kind: sum(found) / len(found) for kind, found in sorted(tally.items())}
    total = sum(sum(found) for found in tally.values()) / (repeats * len(COMMANDS))
    every = [rollout.frames(i) for i in range(repeats)]
    return {
        "commands": repeats * len(COMMANDS),
        "obeyed": total,
        "by_kind": by_kind,
        "missed": misses,
        "skating_contact_mm": float(np.mean([contact_slide_mm(f) for f in every])),
        "jerk": float(np.mean([jerk_mps3(f, FPS) for f in every])),
    }, shown


def contact_slide_mm(positions_w_m: Array) -> float:
    """Mean horizontal way a frame of sole points in contact (low and slower than 0.4 m/s) in both frames."""
    touching = foot_contacts(positions_w_m, FPS)
    both = touching[1:] & touching[:-1]
    way = np.linalg.norm(np.diff(sole_points(positions_w_m)[..., :2], axis=0), axis=-1)
    return float(way[both].mean() * 1e3) if both.any() else 0.0


def heldout(planner: Planner, material: Material, windows: int, seed: int) -> dict[str, object]:
    """Single plans that continue held-out windows, asked for the places and heading of the true continuation."""
    prefix, plan = planner.spec.prefix_frames, planner.spec.plan_frames
    sampler = WindowSampler(material, prefix, plan, seed, augment=False)
    batch = sampler.draw(windows)
    truth = window_positions(batch.features.numpy())
    rng = np.random.default_rng(seed)
    requests, asked = [], []
    for i in range(windows):
        slot = JOINT_SLOTS[i % len(JOINT_SLOTS)]
        joint = CANONICAL.index("pelvis" if slot == "traj" else slot)
        frame = plan if rng.random() < 0.5 else int(rng.integers(4, plan // 2 + 1)) * 2
        place = truth[i, prefix + frame - 1, joint] * (1, 1, 0 if slot == "traj" else 1)
        tick = frame * 3 // 2
        asked.append((slot, joint, frame, place))
        requests.append(
            PlanRequest(
                start_tick=0,
                prefix_positions_w_m=truth[i, :prefix],
                prefix_rotations_6d=np.zeros((prefix, 22, 6)),
                prefix_velocities_w_mps=np.zeros((prefix, 22, 3)),
                text=material.sentences[batch.sentence[i]],
                targets=[JointTarget(joint=slot, position_w_m=tuple(place), arrival_tick=tick)],
                heading=HeadingTarget(heading_rad=float(body_heading(truth[i, -1])), arrival_tick=60),
                seed=seed + i,
            )
        )
    plans = [made for at in range(0, windows, 16) for made in planner.plan(requests[at : at + 16])]
    error: dict[str, list[float]] = {}
    turn = []
    for i, ((slot, joint, frame, place), made) in enumerate(zip(asked, plans, strict=True)):
        axes = 2 if slot == "traj" else 3
        gap = made.positions_w_m[frame - 1, joint, :axes] - place[:axes]
        error.setdefault(slot, []).append(float(np.linalg.norm(gap)))
        turn.append(abs(wrap_angle(body_heading(made.positions_w_m[-1]) - body_heading(truth[i, -1]))))
    made_all = [np.concatenate([truth[i, :prefix], p.positions_w_m]) for i, p in enumerate(plans)]

    def quality(clips: list[Array]) -> dict[str, float]:
        return {
            "skating_mm": float(np.mean([skating_mm_per_frame(c) for c in clips])),
            "skating_contact_mm": float(np.mean([contact_slide_mm(c) for c in clips])),
            "floating_mm": float(np.mean([floating_mm(c) for c in clips])),
            "penetration_mm": float(np.mean([penetration_mm(c) for c in clips])),
            "jerk": float(np.mean([jerk_mps3(c, FPS) for c in clips])),
        }

    every = [e for found in error.values() for e in found]
    return {
        "windows": windows,
        "target_error_m": float(np.median(every)),
        "target_error_by_joint_m": {slot: float(np.median(found)) for slot, found in error.items()},
        "heading_error_deg": float(np.degrees(np.median(turn))),
        **quality([c[prefix - 1 :] for c in made_all]),
        "ground_truth": quality([t[prefix - 1 :] for t in truth]),
    }


def evaluate(
    corpus: Annotated[Path, typer.Option(help="folder of the corpus; its held-out split is used")],
    weights: Annotated[Path, typer.Option(help="safetensors")] = SHIPPED,
    episodes: Annotated[int, typer.Option(help="reaches", min=1)] = 48,
    repeats: Annotated[int, typer.Option(help="rounds through all text commands", min=1)] = 6,
    windows: Annotated[int, typer.Option(help="held-out windows", min=7)] = 112,
    seed: Annotated[int, typer.Option(min=0)] = 1,
    threads: Annotated[int, typer.Option(min=1)] = 1,
    cache: Annotated[Path | None, typer.Option(help="folder to keep the held-out features in")] = None,
    json_file: Annotated[Path | None, typer.Option("--json", help="where to write the result")] = None,
    sheet: Annotated[Path | None, typer.Option(help="PNG of stick figures, a row a command")] = None,
) -> None:
    """Measure DiP without physics."""
    torch.set_num_threads(threads)
    planner = DipPlanner.load(weights)
    frames = planner.spec.prefix_frames + planner.spec.plan_frames
    material = load_material(Corpus.load(corpus), "heldout", frames, cache)
    began = time.monotonic()
    result: dict[str, object] = {
        "weights_sha256": planner.spec.weights_sha256,
        "seed": seed,
        "machine": {"cpu": platform.processor() or platform.machine(), "cores": os.cpu_count(), "threads": threads},
    }
    obeyed_result, shown = text(planner, repeats, seed)
    result["text"] = obeyed_result
    print(json.dumps(obeyed_result, indent=1), flush=True)
    result["reach"] = reach(planner, episodes, seed)
    print(json.dumps(result["reach"], indent=1), flush=True)
    plans = {**heldout(planner, material, windows, seed), **conditions(planner, material, windows, seed)}
    result.update(plans)
    print(json.dumps(plans, indent=1), flush=True)
    result["seconds"] = round(time.monotonic() - began, 1)
    if json_file is not None:
        json_file.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    if sheet is not None:
        from shared.data.sheet import draw_sheet

        draw_sheet([(name, motion) for name, motion in shown.items()], sheet, frames=12)


if __name__ == "__main__":
    with errors_for_people():
        typer.run(evaluate)
