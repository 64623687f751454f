"""Plots of `eval tasks` as SVG, written without a plotting package."""

from __future__ import annotations

from html import escape
from math import cos, pi, sin
from typing import Any

RULES = (
    ("success_strict", "strict", "#2b6cb0"),
    ("success_paper", "paper", "#9cb8d6"),
    ("success_code", "code", "#d4dfec"),
)
LEFT, TOP, HEIGHT, BAR, GAP = 46, 34, 180, 18, 26
ROSE_R, ROSE_STEP = 62, 190


def success_svg(result: dict[str, Any]) -> str:
    """Bars of the three rules for every task; the whisker on the strict one is the Wilson interval."""
    tasks = result["tasks"]
    wide = LEFT + len(tasks) * (3 * BAR + GAP) + GAP
    parts = [_text(LEFT, 16, f"success, variant {result['variant']}", size=13)]
    for share in (0.0, 0.25, 0.5, 0.75, 1.0):
        y = _y(share)
        parts.append(f'<line x1="{LEFT}" x2="{wide}" y1="{y:.1f}" y2="{y:.1f}" stroke="#ddd"/>')
        parts.append(_text(LEFT - 6, y + 4, f"{share:.2f}", anchor="end"))
    for place, (name, row) in enumerate(tasks.items()):
        x = LEFT + GAP / 2 + place * (3 * BAR + GAP)
        for number, (field, _, colour) in enumerate(RULES):
            value = row[field] or 0.0
            parts.append(
                f'<rect x="{x + number * BAR:.1f}" y="{_y(value):.1f}" width="{BAR - 2}" '
                f'height="{HEIGHT * value:.1f}" fill="{colour}"/>'
            )
        low, high = row["ci95"]
        middle = x + BAR / 2 - 1
        parts.append(f'<line x1="{middle}" x2="{middle}" y1="{_y(low):.1f}" y2="{_y(high):.1f}" stroke="#111"/>')
        parts.append(_text(x + 1.5 * BAR, TOP + HEIGHT + 16, f"{name} ({row['n']})", anchor="middle"))
    for number, (_, rule, colour) in enumerate(RULES):
        y = TOP + HEIGHT + 34
        parts.append(f'<rect x="{LEFT + 70 * number}" y="{y}" width="10" height="10" fill="{colour}"/>')
        parts.append(_text(LEFT + 70 * number + 14, y + 9, rule))
    return _svg(wide, TOP + HEIGHT + 54, parts)


def directions_svg(result: dict[str, Any]) -> str:
    """Strict success by direction at the start, a rose for every task: ahead is up, left is left."""
    roses = {name: row["by_octant"] for name, row in result["tasks"].items() if row["by_octant"]}
    parts: list[str] = []
    for place, (name, octants) in enumerate(roses.items()):
        cx, cy = ROSE_STEP * (place + 0.5), 30 + ROSE_R + 20
        parts.append(_text(cx, 16, f"{name}: by direction at the start", anchor="middle"))
        parts.append(f'<circle cx="{cx}" cy="{cy}" r="{ROSE_R}" fill="none" stroke="#ddd"/>')
        for octant, part in octants.items():
            parts.append(_wedge(cx, cy, int(octant), part["success_strict"]))
            angle = -pi / 2 - int(octant) * pi / 4
            parts.append(
                _text(cx + (ROSE_R + 12) * cos(angle), cy + (ROSE_R + 12) * sin(angle) + 4, str(part["n"]), "middle")
            )
    return _svg(ROSE_STEP * max(len(roses), 1), 2 * ROSE_R + 80, parts)


def _y(share: float) -> float:
    return TOP + HEIGHT * (1.0 - share)


def _wedge(cx: float, cy: float, octant: int, share: float) -> str:
    """A slice of 45 deg whose area is the share; anticlockwise from the top, as headings go."""
    radius = ROSE_R * share**0.5
    edges = [-pi / 2 - (octant + side) * pi / 4 for side in (-0.5, 0.5)]
    (x0, y0), (x1, y1) = ((cx + radius * cos(a), cy + radius * sin(a)) for a in edges)
    path = f"M{cx:.1f},{cy:.1f} L{x0:.1f},{y0:.1f} A{radius:.1f},{radius:.1f} 0 0 0 {x1:.1f},{y1:.1f} Z"
    return f'<path d="{path}" fill="#2b6cb0" fill-opacity="0.75" stroke="#fff"/>'


def _text(x: float, y: float, words: str, anchor: str = "start", size: int = 11) -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" font-size="{size}">{escape(words)}</text>'


def _svg(width: float, height: float, parts: list[str]) -> str:
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.0f}" height="{height:.0f}" '
        f'viewBox="0 0 {width:.0f} {height:.0f}" font-family="sans-serif">'
    )
    return "\n".join([head, '<rect width="100%" height="100%" fill="#fff"/>', *parts, "</svg>"]) + "\n"
