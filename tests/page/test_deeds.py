"""The live page among things: seats and bags that are clicked, tasks with tries, episodes changed while they run."""

from __future__ import annotations

from typing import Any

import httpx
import pytest
from playwright.sync_api import BrowserContext, Page

from orchestrator.core.supervise import Stack
from tests.page.support import click, hold_view, look, note, noted, open_tab, ready, until

pytestmark = [pytest.mark.page, pytest.mark.timeout(900)]

BAG = "m.drawn_objects.bag && [m.drawn_objects.bag[0], m.drawn_objects.bag[1], 0.9]"
SOFA = "m.drawn_objects.sofa && [m.drawn_objects.sofa[0], m.drawn_objects.sofa[1], 0.34]"


@pytest.fixture
def room(context: BrowserContext, http: httpx.Client, stack: Stack) -> Page:
    """The page, showing a character in a room with a bag and a sofa."""
    spec = {"pacing": "realtime", "scene": "room", "seed": 4}
    http.post("/v1/characters", json=spec).raise_for_status()
    page = context.new_page()
    page.goto(stack.url)
    ready(page)
    until(page, "Object.keys(m.drawn_objects).length === 2")
    hold_view(page)
    return page


def seen(page: Page, place: str) -> dict[str, float]:
    """The pixel of a point of the world, an expression over `m`."""
    return dict(look(page, f"m.screenOf({place})"))


def tasks_of(http: httpx.Client, page: Page) -> list[dict[str, Any]]:
    """The tasks as the page lists them, once it watches an episode."""
    episode = until(page, "m.view.watching.kind === 'episode' && m.view.agenda.length > 0 && m.view.watching.id")
    spec = http.get(f"/v1/episodes/{episode}").json()["spec"]
    return list(spec["tasks"])


def test_who_comes_first_finds_a_bag_and_a_sofa(context: BrowserContext, http: httpx.Client, stack: Stack) -> None:
    page = context.new_page()
    page.goto(stack.url)
    ready(page)
    until(page, "Object.keys(m.drawn_objects).length === 2")
    hold_view(page)
    for place in (BAG, SOFA):
        assert page.evaluate("(place) => document.elementFromPoint(place.x, place.y)?.id", seen(page, place)) == "view"
    (character,) = http.get("/v1/characters").json()["items"]
    assert (character["scene"], character["pacing"]) == ("room", "realtime")
    for name in ("Hit the bag", "Sit on the sofa"):
        page.get_by_role("button", name=name).wait_for()


def test_a_clicked_bag_is_hit_and_a_clicked_sofa_sat_upon(room: Page, http: httpx.Client) -> None:
    bag = look(room, "m.drawn_objects.bag")
    room.get_by_label("Hit with").select_option("left_foot")
    click(room, BAG, "object", "bag")
    (strike,) = tasks_of(http, room)
    assert (strike["type"], strike["mark"], strike["limb"], strike["retries"]) == (
        "strike",
        "bag_centre",
        "left_foot",
        2,
    )
    # The same room: the bag stands where it stood.
    until(room, "Object.keys(m.drawn_objects).length === 2")
    assert look(room, "m.drawn_objects.bag")[:2] == pytest.approx(bag[:2], abs=0.02)
    until(room, "m.view.agenda[0].state === 'now' && m.view.agenda[0].limb === 'left_foot'")
    hold_view(room)
    click(room, SOFA, "object", "sofa")
    until(room, "m.view.agenda.length === 2 && m.view.agenda[1].type === 'sit'")
    room.get_by_role("button", name="Skip this task").click()
    until(room, "m.view.agenda[0].state === 'missed' && m.view.agenda[1].state === 'now'")
    assert "skipped" in str(room.locator("#agenda li").first.text_content())
    room.get_by_role("button", name="End", exact=True).click()
    until(room, "m.view.watching.kind === 'character' && m.view.agenda.length === 0")


def test_any_limb_is_the_hand_on_the_side_of_the_bag(room: Page, http: httpx.Client) -> None:
    left = look(room, "Math.hypot(...[0, 1].map((k) => m.joint_m('left_hip')[k] - m.drawn_objects.bag[k]))")
    right = look(room, "Math.hypot(...[0, 1].map((k) => m.joint_m('right_hip')[k] - m.drawn_objects.bag[k]))")
    room.get_by_role("button", name="Hit the bag").click()
    (strike,) = tasks_of(http, room)
    assert strike["limb"] == ("left_hand" if left < right else "right_hand")
    room.get_by_role("button", name="Get up").click()
    until(room, "m.view.agenda.length === 2 && m.view.agenda[1].type === 'get_up'")
    room.get_by_role("button", name="End", exact=True).click()
    until(room, "m.view.watching.kind === 'character'")


def test_strike_sit_and_get_up_are_built_in_the_form_and_their_tries_shown(page: Page, http: httpx.Client) -> None:
    """Tracker `kinematic` touches nothing: a strike is missed, and tried as often as the form says."""
    open_tab(page, "Tasks")
    page.get_by_role("button", name="Add Strike").click()
    fields = page.locator("#plan-list li").first
    fields.get_by_label("limb").select_option("right_foot")
    fields.get_by_label("retries").fill("1")
    fields.get_by_label("Time limit, s").fill("8")
    for title in ("Sit down", "Get up"):
        page.get_by_role("button", name=f"Add {title}").click()
        page.locator("#plan-list li").last.get_by_label("Time limit, s").fill("1.5")
    page.get_by_label("from").select_option("seat")
    page.locator("#episode").get_by_label("Scene").select_option("room")
    open_tab(page, "Now")
    note(page, "agenda", "m.view.agenda.map((item) => item.state + item.tries).join(' ')")
    note(page, "frame", "document.getElementById('fact-state').textContent")
    page.locator("#episode").evaluate("(form) => form.requestSubmit()")
    until(page, "window.noted.agenda.some((words) => words.startsWith('missed2'))")
    seen = noted(page, "agenda")
    ordered = [
        next(i for i, words in enumerate(seen) if words.startswith(start)) for start in ("now1", "again1", "now2")
    ]
    assert ordered == sorted(ordered)
    until(page, "m.view.watching.kind === 'character'")
    assert "acting, try 2 of 2" in noted(page, "frame")
    newest = http.get("/v1/episodes").json()["items"][0]
    assert [task["type"] for task in newest["spec"]["tasks"]] == ["strike", "sit", "get_up"]
    assert newest["spec"]["scene"] == "room"
    assert [task["retries"] for task in newest["spec"]["tasks"]] == [1, 0, 0]


def test_a_fallen_character_that_gets_up_says_so(context: BrowserContext, http: httpx.Client, stack: Stack) -> None:
    """Tracker `learned`: only physics lets it fall."""
    spec = {"pacing": "realtime", "tracker": "learned", "planner": "stand", "on_fall": "get_up"}
    character = http.post("/v1/characters", json=spec).json()["id"]
    page = context.new_page()
    page.goto(f"{stack.url}/#character={character}")
    ready(page)
    note(page, "frame", "document.getElementById('fact-state').textContent")
    note(page, "event", "document.getElementById('happened').textContent")
    push = {"body": "spine3", "impulse_ns": [400.0, 0.0, 0.0]}
    http.post(f"/v1/characters/{character}/impulses", json=push).raise_for_status()
    until(page, "window.noted.frame.includes('getting up')")
    until(page, "window.noted.event.some((words) => words.includes('gets up by itself'))")
