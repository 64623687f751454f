"""Reading the page's own data and pointing at things in its 3D view."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from playwright.sync_api import Page

from orchestrator.core.supervise import Stack
from tests.orchestrator.support import light
from tests.planner_service.motion import write_library

WAIT_MS = 150_000
"""How long anything may take before the test gives up; nothing is measured by it."""
TRIES = 20


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


def note(page: Page, topic: str, expression: str) -> None:
    """From now on keep every value of an expression over `m` when the page tells its parts of `topic`; see `noted`.

    What is true for a moment only is missed by `until`, which looks as often as the page is drawn.
    """
    page.evaluate(
        f"""async () => {{
            const {{ on }} = await import("/web/js/store.js");
            const m = window.motionloop;
            const kept = ((window.noted ??= {{}})["{topic}"] = []);
            on("{topic}", () => {{
                const value = {expression};
                if (kept.length === 0 || kept.at(-1) !== value) kept.push(value);
            }});
        }}"""
    )


def noted(page: Page, topic: str) -> list[Any]:
    """The values kept since `note`, without repetitions in a row."""
    return list(page.evaluate("(topic) => window.noted[topic]", topic))


def hold_clock(page: Page) -> int:
    """Pause, and wait until the body is drawn where it has stopped; returns the tick."""
    page.get_by_role("button", name="Pause").click()
    held = until(page, "m.view.frame.paused && { tick: m.tick }")["tick"]
    until(page, "Math.hypot(...m.drawn_pelvis_m.map((v, i) => v - m.pelvis_m[i])) < 1e-3")
    return int(held)


def hold_view(page: Page) -> None:
    """Stop the camera from following: from then on a point of the world stays at its pixel."""
    follow = page.get_by_role("button", name="Follow")
    if follow.get_attribute("aria-pressed") == "true":
        follow.click()
    until(page, "m.still")


def point_at(page: Page, position_m: list[float]) -> tuple[float, float]:
    """Pixels of a point of the world, as last drawn; it must be in view."""
    place = look(page, "m.screenOf(a)", position_m)
    covering = "(place) => document.elementFromPoint(place.x, place.y)?.id"
    assert page.evaluate(covering, place) == "view", "something covers this point of the view"
    return place["x"], place["y"]


def press(
    page: Page, where: str, kind: str, joint: str | None = None, beside_px: tuple[float, float] = (0.0, 0.0)
) -> tuple[float, float]:
    """Press the mouse on a point of the world, an expression over `m`, and see that the page holds what was meant.

    `joint` is the limb's, the target's, or the name of an object.

    The page draws when it can, and what is aimed at may have moved by the time of the press: one that took something
    else is given up (Escape, so that it means nothing) and tried again. Returns the pixel.
    """
    held = None
    for _ in range(TRIES):
        x, y = point_at(page, until(page, where))
        x, y = x + beside_px[0], y + beside_px[1]
        page.mouse.move(x, y)
        page.mouse.down()
        held = look(page, "m.held")
        if held is not None and held["kind"] == kind and joint in (None, held["joint"], held["name"]):
            return x, y
        page.keyboard.press("Escape")
        page.mouse.up()
        until(page, "m.held === null")
    raise AssertionError(f"the press on {where} took {held}, not {kind} {joint or ''}")


def click(page: Page, where: str, kind: str, joint: str | None = None) -> None:
    """Press as above, and let go."""
    press(page, where, kind, joint)
    page.mouse.up()


def open_tab(page: Page, name: str) -> None:
    """Show a panel."""
    page.get_by_role("tab", name=name).click()
