"""The table of `eval tasks` as Markdown."""

from __future__ import annotations

from typing import Any

FULL = 24


def report(result: dict[str, Any]) -> str:
    """Success by the three rules, by the direction at the start, and why the failures failed.

    Args:
        result: as `evaluate_tasks` gives it, with what the command adds.
    """
    lines = [f"# Tasks, variant `{result['variant']}`", ""]
    made = [f"{key} {result[key]}" for key in ("seed", "commit", "machine") if key in result]
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
