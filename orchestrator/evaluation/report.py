"""The table of `eval tasks` as Markdown, with its plots beside it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from orchestrator.evaluation.plots import directions_svg, success_svg
from orchestrator.evaluation.statistics import two_proportions_p

FULL = 24


def write_report(path: Path, result: dict[str, Any], against: dict[str, Any] | None = None) -> None:
    """The report, and `NAME_success.svg` and `NAME_directions.svg`, which it shows."""
    path.parent.mkdir(parents=True, exist_ok=True)
    plots = {f"{path.stem}_success.svg": success_svg(result), f"{path.stem}_directions.svg": directions_svg(result)}
    for name, plot in plots.items():
        path.with_name(name).write_text(plot, encoding="utf-8")
    shown = "".join(f"\n![{name}]({name})\n" for name in plots)
    path.write_text(report(result) + ("" if against is None else compared(result, against)) + shown, encoding="utf-8")


def compared(result: dict[str, Any], against: dict[str, Any]) -> str:
    """Strict success of two results, task by task, with p that they differ by chance alone."""
    lines = ["", f"## Against variant `{against['variant']}`, seed {against.get('seed')}", ""]
    lines += ["| task | strict | n | there | n | p |", "|---|---|---|---|---|---|"]
    for name in (name for name in result["tasks"] if name in against["tasks"]):
        here, there = result["tasks"][name], against["tasks"][name]
        counts = [(round(row["success_strict"] * row["n"]), row["n"]) for row in (here, there)]
        p = two_proportions_p(*counts[0], *counts[1])
        lines.append(
            f"| {name} | {here['success_strict']:.3f} | {here['n']} | {there['success_strict']:.3f} | {there['n']} | "
            f"{p:.2g} |"
        )
    return "\n".join(lines) + "\n"


def report(result: dict[str, Any]) -> str:
    """Success by the three rules, by the direction at the start, and why the failures failed.

    Args:
        result: as `evaluate_tasks` gives it, with what the command adds.
    """
    varied = ", objects varied" if result.get("varied") else ""
    pushed = f", a push of {result['push_ns']:g} N s in each task" if result.get("push_ns") else ""
    lines = [f"# Tasks, variant `{result['variant']}`{varied}{pushed}", ""]
    made = [f"{key} {result[key]}" for key in ("seed", "commit", "weights", "machine") if key in result]
    lines += [f"{', '.join(made)}", ""] if made else []
    lines += [
        "| task | n | strict | 95 % | | paper | code | falls | median s |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for name, row in result["tasks"].items():
        low, high = row["ci95"]
        bar = "#" * round(FULL * row["success_strict"])
        code = "-" if row["success_code"] is None else f"{row['success_code']:.3f}"
        seconds = "-" if row["median_time_s"] is None else f"{row['median_time_s']:.1f}"
        lines.append(
            f"| {name} | {row['n']} | {row['success_strict']:.3f} | {low:.3f}-{high:.3f} | `{bar:.<{FULL}}` | "
            f"{row['success_paper']:.3f} | {code} | {row['falls']} | {seconds} |"
        )
    for name, row in result["tasks"].items():
        if row["by_octant"]:
            lines += ["", f"## {name}: by direction at the start (0 ahead, anticlockwise)", ""]
            lines += ["| octant | n | strict | 95 % |", "|---|---|---|---|"]
            for which, part in row["by_octant"].items():
                low, high = part["ci95"]
                lines.append(f"| {which} | {part['n']} | {part['success_strict']:.3f} | {low:.3f}-{high:.3f} |")
        reasons = [str(failure["reason"]) for failure in row["failures"]]
        if reasons:
            lines += ["", f"{name} failed: " + ", ".join(f"{r} {reasons.count(r)}" for r in sorted(set(reasons)))]
    return "\n".join(lines) + "\n"
