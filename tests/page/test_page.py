"""The live page in headless Chromium against the three real services."""

from __future__ import annotations

import io
from math import dist
from pathlib import Path

import httpx
import numpy as np
import pytest
from playwright.sync_api import BrowserContext, Page

from orchestrator.core.supervise import Stack
from shared.motion.io.bvh import read_bvh
from shared.motion.skeleton import CANONICAL
from tests.orchestrator.support import play
from tests.page.support import (
    click,
    hold_clock,
    hold_view,
    look,
    note,
    noted,
    open_tab,
    page_stack,
    press,
    ready,
    say,
    until,
)

pytestmark = [pytest.mark.page, pytest.mark.timeout(900)]

TARGET_DRAWN = (
    "m.drawn_target_m && m.target && m.drawn_target_m"
    ".every((v, i) => i === (m.target.joint === 'traj' ? 2 : 3) || Math.abs(v - m.target.position_m[i]) < 1e-3)"
    " && m.drawn_target_m"
)
"""Where the marker was drawn, once that is where the target is (the height of a ring is 0)."""


def test_a_typed_command_moves_the_pelvis_that_the_page_shows(page: Page) -> None:
    before = look(page, "m.pelvis_m")
    say(page, "walk forward")
    until(page, "Math.hypot(m.pelvis_m[0] - a[0], m.pelvis_m[1] - a[1]) > 1.0", before)
    until(page, "Math.hypot(m.drawn_pelvis_m[0] - a[0], m.drawn_pelvis_m[1] - a[1]) > 1.0", before)
    assert look(page, "m.view.command.text") == "walk forward"
    assert page.locator("#doing").text_content() == "walk forward"
    until(page, "m.view.plan !== null && m.view.plan.count === 40")
    box = page.get_by_label("Command", exact=True)
    box.focus()
    page.keyboard.press("ArrowUp")
    assert box.input_value() == "walk forward"


def test_a_click_on_the_floor_is_a_target_and_it_is_reached(page: Page) -> None:
    """Tracker `kinematic`: it performs the plan as it is, so that a fall cannot keep the page from being tested."""
    hold_view(page)
    click(page, "[0.6, 0.9, 0.0]", "view")
    target = until(page, "m.target")
    assert target["joint"] == "traj"
    assert dist(target["position_m"], (0.6, 0.9, 0.0)) < 0.05
    until(page, "Math.hypot(m.pelvis_m[0] - a[0], m.pelvis_m[1] - a[1]) <= 0.3", target["position_m"])
    page.locator("#fact-target").get_by_text("reached").wait_for()


def test_a_clicked_hand_gets_the_next_target(page: Page) -> None:
    hold_clock(page)
    hold_view(page)
    click(page, "m.drawn_m('right_wrist')", "body", "right_wrist")
    until(page, "m.view.picked === 'right_wrist'")
    click(page, "[0.5, 0.8, 0.0]", "view")
    target = until(page, "m.target && m.target.joint === 'right_wrist' && m.target")
    assert dist(target["position_m"][:2], (0.5, 0.8)) < 0.05
    assert look(page, "m.view.picked") is None
    # The ball of a joint's target is dragged in the plane that faces the viewer, once it is drawn where it is.
    x, y = press(page, TARGET_DRAWN, "target", "right_wrist")
    page.mouse.move(x, y - 30, steps=2)
    # It steers while it is dragged, and not only where it is let go.
    steered = until(page, "m.target.position_m[2] > a + 0.02 && m.target", target["position_m"][2])
    page.mouse.move(x, y - 60, steps=2)
    page.mouse.up()
    moved = until(page, "m.target.position_m[2] > a + 0.03 && m.target", steered["position_m"][2])
    assert moved["joint"] == "right_wrist"


def test_a_press_beside_a_distant_hand_takes_it(page: Page) -> None:
    hold_clock(page)
    for _ in range(12):
        page.locator("#view").press("-")
    hold_view(page)
    press(page, "m.drawn_m('right_wrist')", "body", "right_wrist", beside_px=(-9.0, 0.0))
    page.mouse.up()
    until(page, "m.view.picked === 'right_wrist'")
    press(page, "m.drawn_m('right_wrist')", "view", beside_px=(-60.0, 0.0))
    page.keyboard.press("Escape")
    page.mouse.up()


def test_the_view_holds_still_while_a_target_is_held(page: Page, http: httpx.Client) -> None:
    """The character walks and the camera would go with it; the ring stays under the hand that holds it."""
    path = f"/v1/characters/{look(page, 'm.view.watching.id')}"
    hold_clock(page)
    command = {"target": {"joint": "traj", "position_m": [1.1, 0.5, 0.0]}}
    http.post(f"{path}/commands", json=command).raise_for_status()
    press(page, TARGET_DRAWN, "target", "traj")
    until(page, "m.still")
    before, corner = look(page, "m.pelvis_m"), look(page, "m.screenOf([0, 0, 0])")
    http.post(f"{path}/resume").raise_for_status()
    until(page, "Math.hypot(m.drawn_pelvis_m[0] - a[0], m.drawn_pelvis_m[1] - a[1]) > 0.5", before)
    assert look(page, "m.screenOf([0, 0, 0])") == pytest.approx(corner, abs=0.1)
    page.mouse.up()
    until(page, "Math.hypot(m.screenOf([0, 0, 0]).x - a.x, m.screenOf([0, 0, 0]).y - a.y) > 10", corner)


def test_dragging_the_body_pushes_it_in_that_direction(
    context: BrowserContext, stack: Stack, http: httpx.Client
) -> None:
    """Tracker `learned`: a push needs physics, and a body that stands until it is pushed."""
    spec = {"pacing": "realtime", "tracker": "learned", "planner": "stand"}
    character = http.post("/v1/characters", json=spec).json()["id"]
    page = context.new_page()
    page.goto(f"{stack.url}/#character={character}")
    ready(page)
    assert look(page, "m.view.watching.id") == character
    # The clock is held and then stepped, so that it does not matter how long this machine takes for the drag.
    held = hold_clock(page)
    hold_view(page)
    still = look(page, "m.joint_m('spine3')")
    x, y = press(page, "m.drawn_m('spine3')", "body")
    page.mouse.move(x + 200, y, steps=5)
    page.mouse.up()
    push = np.array(until(page, "m.view.events.find((event) => event.type === 'impulse')")["data"]["impulse_ns"])
    assert 20.0 < np.linalg.norm(push) < 200.0
    to_the_right = np.array([0.66, 0.75, 0.0])  # as the camera stands at first
    assert push @ to_the_right > 0.9 * np.linalg.norm(push)
    for step in range(1, 7):
        page.get_by_role("button", name="Step").click()
        until(page, "m.tick >= a", held + 3 * step)
    moved = np.array(look(page, "m.joint_m('spine3')")) - still
    assert moved @ push / np.linalg.norm(push) > 0.15


def test_pause_step_and_resume(page: Page) -> None:
    held = hold_clock(page)
    page.get_by_role("button", name="Step").click()
    # A step may pass through a plan's boundary (a frame of its own); all of it is shown as paused.
    until(page, "m.view.events.some((event) => event.type === 'stepped') && m.tick >= a", held + 3)
    assert look(page, "[m.tick, m.view.frame.paused]") == [held + 3, True]
    page.get_by_role("button", name="Resume").click()
    until(page, "!m.view.frame.paused && m.tick > a + 10", held)


def test_the_planner_is_swapped_from_the_page(page: Page, http: httpx.Client) -> None:
    say(page, "walk forward")
    until(page, "m.view.plan?.planner === 'clip' && m.pelvis_m[0] > 0.3")
    open_tab(page, "Services")
    picker = page.get_by_label("Plug-in of the planner")
    assert picker.locator("option").all_text_contents() == ["clip", "stand"] or picker.input_value() == "clip"
    picker.select_option("stand")
    try:
        until(page, "m.view.plan.planner === 'stand'")
        until(page, "m.health.planner.plugin === 'stand' && m.view.events.some((event) => event.type === 'swap')")
        assert http.get("/v1/services").json()["planner"]["plugin"] == "stand"
    finally:
        http.put("/v1/services/planner", json={"plugin": "clip"})


def test_a_reload_finds_the_same_character_again(page: Page, context: BrowserContext, stack: Stack) -> None:
    say(page, "walk forward")
    until(page, "m.pelvis_m[0] > 0.5")
    watched = look(page, "m.view.watching")
    tick = look(page, "m.tick")
    page.reload()
    ready(page)
    assert look(page, "m.view.watching") == watched
    assert look(page, "m.tick") >= tick
    assert look(page, "m.pelvis_m[0]") > 0.5
    assert look(page, "m.view.command.text") == "walk forward"
    # Without its address too: the page remembers; and a second viewer is shown the same.
    for fresh in (page, context.new_page()):
        fresh.goto(stack.url)
        ready(fresh)
        assert look(fresh, "m.view.watching") == watched


def test_a_finished_episode_is_replayed_and_its_bvh_parses(page: Page, http: httpx.Client, tmp_path: Path) -> None:
    tasks = [{"type": "halt", "settle_s": 0.3, "duration_s": 0.5}, {"type": "reach", "position_m": [0.8, 0.0]}]
    episode, _ = play(http, {"tasks": tasks, "seed": 4, "name": "tour"})
    with np.load(io.BytesIO(http.get(f"/v1/episodes/{episode['id']}/motion.npz").content)) as data:
        recorded = data["body_pos_w_m"].astype(float)
    open_tab(page, "Episodes")
    item = page.locator(f"#episodes li[data-id='{episode['id']}']")
    item.get_by_role("button", name="Replay").click()
    until(page, "m.view.mode === 'replay' && m.tick > 5")
    page.get_by_label("Position in the recording").fill(str(len(recorded) - 1))
    assert until(page, "m.tick === a && m.tick", len(recorded) - 1) == len(recorded) - 1
    assert dist(look(page, "m.pelvis_m"), recorded[-1, 0]) < 1e-3
    until(page, "Math.hypot(...m.drawn_pelvis_m.map((v, i) => v - a[i])) < 1e-3", recorded[-1, 0].tolist())
    page.get_by_label("Position in the recording").fill("0")
    until(page, "m.tick === 0")
    assert dist(look(page, "m.pelvis_m"), recorded[0, 0]) < 1e-3

    with page.expect_download() as waiting:
        item.get_by_role("button", name="BVH").click()
    file = tmp_path / "episode.bvh"
    waiting.value.save_as(file)
    motion = read_bvh(file)
    assert len(motion.positions_w_m) == len(recorded)

    page.get_by_role("button", name="Back to live").click()
    until(page, "m.view.mode === 'live' && m.tick !== a", 0)


def test_an_episode_is_built_run_and_watched(page: Page, http: httpx.Client) -> None:
    open_tab(page, "Tasks")
    page.get_by_role("button", name="Add Stand still").click()
    page.get_by_role("button", name="Add Walk to a point").click()
    page.get_by_role("button", name="Move Walk to a point up").click()
    page.get_by_label("Ahead, m").fill("0.8")
    page.get_by_label("For, s").fill("8")  # time to watch it, however slow this machine is
    note(page, "watching", "m.view.watching.kind")
    note(page, "frame", "m.view.frame?.status")
    note(page, "command", "m.view.task?.task ?? null")
    page.get_by_role("button", name="Run the episode").click()
    until(page, "window.noted.watching.length === 2")
    assert noted(page, "watching") == ["episode", "character"]
    assert [task for task in noted(page, "command") if task is not None] == ["reach", "halt"]
    assert "acting" in noted(page, "frame")
    newest = http.get("/v1/episodes").json()["items"][0]
    assert [task["type"] for task in newest["spec"]["tasks"]] == ["reach", "halt"]
    assert newest["status"] == "finished"
    page.locator(f"#episodes li[data-id='{newest['id']}']").wait_for()


def test_what_was_recorded_of_a_character_is_downloaded(page: Page, tmp_path: Path) -> None:
    page.get_by_role("button", name="Record").click()
    start = until(page, "m.view.recording")["startTick"]
    say(page, "walk forward")
    until(page, "m.tick > a + 45", start)
    page.locator("#record").click()
    stop = until(page, "m.view.recording.stopTick")
    with page.expect_download() as waiting:
        page.get_by_role("button", name="Download as BVH").click()
    file = tmp_path / "character.bvh"
    waiting.value.save_as(file)
    assert len(read_bvh(file).positions_w_m) == stop - start + 1
    with page.expect_download() as waiting:
        page.get_by_role("button", name="Download as npz").click()
    with np.load(io.BytesIO(Path(waiting.value.path()).read_bytes())) as data:
        assert int(data["start_tick"]) == start
        assert data["body_pos_w_m"].shape == (stop - start + 1, len(CANONICAL), 3)


def test_a_phone_shows_everything_within_its_width(context: BrowserContext, stack: Stack, http: httpx.Client) -> None:
    page = context.new_page()
    page.set_viewport_size({"width": 390, "height": 844})
    page.goto(stack.url)
    ready(page)
    for name in ("Tasks", "Episodes", "Services", "Now"):
        open_tab(page, name)
        assert page.evaluate("() => document.documentElement.scrollWidth") <= 390
    for name in ("Pause", "Reset", "Follow", "Plan", "Record", "Send the command"):
        box = page.get_by_role("button", name=name, exact=True).bounding_box()
        assert box is not None
        assert box["x"] >= 0
        assert box["x"] + box["width"] <= 390
        assert box["y"] + box["height"] <= 844
    # What one can do with the things of the first scene is beside the toolbar, not under it.
    page.get_by_role("button", name="Hit the bag").wait_for()
    tools, deeds = page.locator(".toolbar").bounding_box(), page.locator("#deeds").bounding_box()
    assert tools is not None
    assert deeds is not None
    assert deeds["x"] >= tools["x"] + tools["width"]
    assert deeds["x"] + deeds["width"] <= 390


def test_the_death_of_the_planner_shows(context: BrowserContext, tmp_path: Path) -> None:
    """Its own stack, since one of the three processes is killed."""
    with page_stack(tmp_path) as own:
        page = context.new_page()
        page.goto(own.url)
        ready(page)
        assert page.locator("#card-planner [role=status]").text_content() != "away"
        own.planner.stop()
        until(page, "m.health.planner.status === 'away' && m.health.tracker.status === 'ok'")
        open_tab(page, "Services")
        page.locator("#card-planner").get_by_text("away", exact=True).wait_for()
        until(page, "m.view.frame.status === 'degraded'")
        tick = look(page, "m.tick")
        until(page, "m.tick > a + 10", tick)  # the physics goes on
        page.close()  # or it would, rightly, complain that the server is gone


def test_the_objects_of_the_scene_are_drawn_where_they_are(
    context: BrowserContext, http: httpx.Client, stack: Stack
) -> None:
    spec = {"pacing": "realtime", "scene": "room", "seed": 4, "character": "child"}
    character = http.post("/v1/characters", json=spec).json()["id"]
    page = context.new_page()
    page.goto(stack.url)
    ready(page)
    until(page, "Object.keys(m.drawn_objects).length === 2")
    hold_clock(page)
    there = {item["name"]: item for item in http.get(f"/v1/characters/{character}/objects").json()["items"]}
    until(page, "m.view.frame.paused")
    drawn = look(page, "m.drawn_objects")
    assert {name: row[3] for name, row in drawn.items()} == {"bag": 2, "sofa": 4}
    for name, row in drawn.items():
        assert row[:3] == pytest.approx(there[name]["position_m"], abs=1e-3)
    page.get_by_role("button", name="Resume").click()
    http.put(f"/v1/characters/{character}/objects/sofa", json={"position_m": [0.0, 3.0, 0.0]})
    until(page, "m.drawn_objects.sofa[1] > 2.9")
