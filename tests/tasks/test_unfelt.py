"""Tasks that are told a plan, in which nothing is felt: what they take for true, and what they are judged by."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from shared.motion.ik import standing_clip
from shared.motion.skeleton import CANONICAL
from shared.scenes.files import load_scene
from shared.scenes.placing import pose_of
from shared.tasks.factory import make_task
from shared.tasks.interface import BodyView, Trace, joined
from shared.tasks.object_specs import GetUpSpec, StrikeSpec
from shared.tasks.world import unfelt
from shared.text.wording import STAND_TEXT

STAND = standing_clip(1, 30).positions_w_m[0]
STAND_TO_SEAT_M = 0.344 + 0.12 - float(STAND[0, 2])


def view(scene: str, x: float = 0.0, tick: int = 0, lift: float = 0.0) -> BodyView:
    """Standing at x, facing along it."""
    made = load_scene(scene)
    objects = {body.name: np.asarray(pose_of(body), dtype=np.float64) for body in made.bodies}
    return BodyView(tick, STAND + [x, 0.0, lift], objects=objects, scene=made)


@pytest.mark.parametrize("limb", ["left_foot", "right_hand"])
def test_where_nothing_is_felt_what_the_plan_goes_through_was_hit_and_goes_down(limb: str) -> None:
    task = make_task(StrikeSpec.model_validate({"limb": limb}), 0)
    task.start(view("bag", 1.15))
    task.goal(view("bag", 1.15), 0)
    joint = CANONICAL.index("left_foot" if limb == "left_foot" else "right_wrist")

    def planned(start: int, x: float, reach_m: float, ticks: int = 15) -> Trace:
        """Standing at x, the limb's end that far ahead of there."""
        positions = np.repeat(view("bag", x).pos_w_m[None], ticks, axis=0)
        positions[:, joint] = [x + reach_m, 0.0, 0.9]
        return Trace(start, positions, np.zeros(ticks, dtype=bool), unfelt(view("bag").objects, ticks))

    assert task.status(planned(1, 1.15, 0.55)) == "running"  # 0.3 m from the axis of a bag of 0.17 m
    assert "walking forward" not in str(task.goal(view("bag", 1.15, tick=15), 15).text), "still the blow"
    assert task.status(planned(16, 1.15, 0.65)) == "running"
    assert "walking forward" in str(task.goal(view("bag", 1.15, tick=30), 30).text)
    assert task.status(planned(31, 1.6, 0.4)) == "running"
    assert "walking forward" in str(task.goal(view("bag", 1.6, tick=45), 45).text), "the pelvis is not there yet"
    within, through = planned(46, 2.0, 0.4), planned(61, 2.35, 0.4)
    assert task.status(within) == "running"
    assert "walking forward" in str(task.goal(view("bag", 2.0, tick=60), 60).text), "nor through"
    assert task.status(joined([within, through])) == "running"
    back = task.goal(view("bag", 2.35, tick=75), 75)
    assert back.text == STAND_TEXT
    assert back.targets[0].position_w_m[0] == pytest.approx(2.35 - 0.35, abs=0.01)
    assert task.status(joined([within, through, planned(76, 2.0, 0.2, ticks=59)])) == "running"
    assert task.status(joined([within, through, planned(76, 2.0, 0.2, ticks=60)])) == "done", "it had time to fall"
    assert not task.judge(planned(1, 1.75, 0.4)).strict, "no bag went down"


def test_who_only_thinks_that_it_sat_has_not_got_up() -> None:
    """An open loop is told the plan; the body of the trace stood all the time."""
    task = make_task(GetUpSpec(), 0)
    task.start(view("sofa", -1.3, lift=STAND_TO_SEAT_M))
    seats = unfelt(view("sofa").objects, 90)
    stood = Trace(1, np.repeat(view("sofa", -0.7).pos_w_m[None], 90, axis=0), np.zeros(90, dtype=bool), seats)
    assert task.judge(stood).measures["was_low"] == 0.0
    sat = replace(stood, pos_w_m=stood.pos_w_m.copy())
    sat.pos_w_m[0] = view("sofa", -1.3, lift=STAND_TO_SEAT_M).pos_w_m
    assert task.judge(sat).measures["was_low"] == 1.0
