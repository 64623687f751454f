"""Reading the page's own data and pointing at things in its 3D view."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from playwright.sync_api import Page

from orchestrator.core.supervise import Stack
from tests.orchestrator.support import light
from tests.planner_service.motion import write_library

WAIT_MS = 60_000
"""How long anything may take before the test gives up; nothing is measured by it."""


def page_stack(folder: Path, token: str | None = None) -> Stack:
    """A stack with planner `clip` (`stand` is there too) and tracker `kinematic`, not started yet."""
    library = folder / "library"
    library.mkdir()
    options = replace(light(folder / "data", write_library(library)), planner_plugin="clip")
    return Stack(options if token is None else replace(options, orchestrator_args=("--token", token)))


def until(page: Page, condition: str, argument: Any = None) -> Any:
    """Wait until a JavaScript expression over the page's data `m` (and `a`) is truthy; returns its value."""
    script = f"(a) => {{ const m = window.motionloop; return m && ({condition}); }}"
    return page.wait_for_function(script, arg=argument).json_value()


def look(page: Page, expression: str, argument: Any = None) -> Any:
    """An expression over the page's data `m` (and `a`), now."""
    return page.evaluate(f"(a) => {{ const m = window.motionloop; return ({expression}); }}", argument)


def ready(page: Page) -> None:
    """Wait until a character is shown and planner and tracker are known to be well."""
    until(page, "m.view.link === 'live' && m.tick !== null && m.drawn_pelvis_m[2] > 0.3")
    until(page, "m.health !== null && m.health.planner.status === 'ok' && m.health.tracker.status === 'ok'")


def say(page: Page, words: str) -> None:
    """Type a command as a person would."""
    page.get_by_label("Command", exact=True).fill(words)
    page.keyboard.press("Enter")


def point_at(page: Page, position_m: list[float]) -> tuple[float, float]:
    """Pixels of a point of the world; it must be in view."""
    place = look(page, "m.screenOf(a)", position_m)
    covering = "(place) => document.elementFromPoint(place.x, place.y)?.id"
    assert page.evaluate(covering, place) == "view", "something covers this point of the view"
    return place["x"], place["y"]


def open_tab(page: Page, name: str) -> None:
    """Show a panel."""
    page.get_by_role("tab", name=name).click()
