"""Keyframes in the live page: a pose is keyed, dragged, put some seconds ahead and sent."""

from __future__ import annotations

from math import dist

import httpx
import numpy as np
import pytest
from playwright.sync_api import Page

from tests.page.support import hold_clock, hold_view, look, press, until

pytestmark = [pytest.mark.page, pytest.mark.timeout(900)]

BONES = (("right_shoulder", "right_elbow"), ("right_elbow", "right_wrist"))


def keyed(page: Page, joint: str) -> list[float]:
    """Where the first key has a joint."""
    found = look(
        page, "[0, 1, 2].map((k) => m.view.keys[0].positions[3 * m.view.skeleton.joints.indexOf(a) + k])", joint
    )
    return list(found)


def test_a_pose_is_keyed_dragged_put_ahead_and_sent(page: Page, http: httpx.Client) -> None:
    """Planner `clip` takes no keyframes, and the page says so."""
    hold_clock(page)
    hold_view(page)
    page.locator("#keys-card summary").click()
    page.get_by_role("button", name="Key this pose").click()
    until(page, "m.view.keys.length === 1")
    pose = np.array(look(page, "Array.from(m.view.frame.positions)"))
    assert np.array(look(page, "Array.from(m.view.keys[0].positions)")) == pytest.approx(pose)
    before = {joint: keyed(page, joint) for pair in BONES for joint in pair}

    x, y = press(page, "m.drawn_key_m('right_wrist')", "key", "right_wrist")
    page.mouse.move(x - 10, y - 40, steps=3)
    page.mouse.up()
    after = {joint: keyed(page, joint) for pair in BONES for joint in pair}
    assert after["right_wrist"][2] > before["right_wrist"][2] + 0.1
    for a, b in BONES:  # the arm is as long as it was, and its shoulder where it was
        assert dist(after[a], after[b]) == pytest.approx(dist(before[a], before[b]), abs=1e-4)
    assert after["right_shoulder"] == before["right_shoulder"]

    page.get_by_label("Joints of key 1").select_option("dragged")
    for _ in range(5):
        page.get_by_role("slider", name="Key 1 on the timeline").press("ArrowRight")
    assert page.get_by_label("Key 1, seconds ahead").input_value() == "2.0"
    page.get_by_role("button", name="Send the keys").click()
    until(page, "m.view.keys[0].status === 'ignored'")
    assert "this planner takes no keyframes" in str(page.locator("#keys li").text_content())
    (character,) = http.get("/v1/characters").json()["items"]
    (frame,) = character["command"]["keyframes"]
    assert frame["in_s"] == 2.0
    assert set(frame["positions_m"]) == {"right_elbow", "right_wrist"}
    assert frame["positions_m"]["right_wrist"] == pytest.approx(after["right_wrist"], abs=1e-3)
    assert character["command"]["text"] == "a person is standing still."


def test_a_key_is_drawn_along_the_timeline_and_how_far_off_it_was_is_told(page: Page) -> None:
    page.locator("#keys-card summary").click()
    page.get_by_role("button", name="Key this pose").click()
    marker = page.get_by_role("slider", name="Key 1 on the timeline")
    marker.scroll_into_view_if_needed()
    strip, place = page.locator("#key-strip").bounding_box(), marker.bounding_box()
    assert strip is not None
    assert place is not None
    page.mouse.move(place["x"] + place["width"] / 2, place["y"] + place["height"] / 2)
    page.mouse.down()
    page.mouse.move(strip["x"] + strip["width"] * 0.5, place["y"] + 4, steps=3)
    page.mouse.up()
    assert page.get_by_label("Key 1, seconds ahead").input_value() == "3.0"
    page.get_by_role("button", name="Send the keys").click()
    until(page, "m.view.keys[0].offM !== null")
    assert look(page, "m.view.keys[0].offM") < 0.1  # it stands as it stood
    assert "off when it was due" in str(page.locator("#keys li").text_content())
    page.get_by_role("button", name="Remove key 1").click()
    assert look(page, "m.view.keys.length") == 0


def test_what_plans_say_of_a_key(page: Page) -> None:
    said = page.evaluate(
        """async () => {
            const { saidByPlan } = await import("/web/js/keys.js");
            const plan = { accepted: true, start_tick: 100, ignored: [] };
            return [
                saidByPlan(plan, 120), saidByPlan(plan, 100), saidByPlan({ ...plan, accepted: false }, 120),
                saidByPlan({ ...plan, ignored: ["keyframes:300"] }, 300),
                saidByPlan({ ...plan, ignored: ["keyframes:300"] }, 120),
                saidByPlan({ ...plan, ignored: ["keyframes"] }, 120),
            ];
        }"""
    )
    assert said == ["honoured", None, None, "waiting", "honoured", "ignored"]
