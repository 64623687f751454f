"""The tables of docs/results.md from results of `motionloop eval tasks --json`, one row a file.

python benchmarks/results_table.py out/results/*.json
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

TASKS = ("reach", "strike", "sit", "get_up")
PAPER = {
    "closed loop": (1.0, 0.90, 0.88, 0.98),
    "no fine-tuning": (1.0, 0.81, 0.66, 0.53),
    "open loop": (1.0, 0.80, 0.19, 0.23),
    "plans of 10": (0.86, 0.71, 0.61, 0.95),
    "plans of 80": (0.99, 0.86, 0.56, 0.92),
}
"""Success of CLoSD by its own rules (REFERENCE 3: Table 1)."""


def rates(row: dict[str, Any]) -> str:
    """Strict with its interval, then by the paper's and the release's rule, and falls of n."""
    low, high = row["ci95"]
    code = "-" if row["success_code"] is None else f"{row['success_code']:.2f}"
    return (
        f"**{row['success_strict']:.2f}** ({low:.2f}-{high:.2f}), {row['success_paper']:.2f}, {code}; "
        f"{row['falls']} of {row['n']} fell"
    )


def table(results: list[dict[str, Any]]) -> str:
    """Ours beside the paper's, as Markdown."""
    lines = [f"| | {' | '.join(TASKS)} |", "|---|" + "---|" * len(TASKS)]
    lines += [f"| paper, {name} | {' | '.join(f'{v:.2f}' for v in values)} |" for name, values in PAPER.items()]
    for result in results:
        varied = ", objects varied" if result.get("varied") else ""
        cells = [rates(result["tasks"][task]) if task in result["tasks"] else "" for task in TASKS]
        lines.append(f"| ours, {result['variant']}{varied}, seed {result['seed']} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def commands(results: list[dict[str, Any]]) -> str:
    """What was run, where."""
    lines = [f"- `{result['command']}` (commit {result['commit']}; {result['weights']})" for result in results]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Print the table and the commands."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("files", type=Path, nargs="+")
    results = [json.loads(path.read_text()) for path in parser.parse_args().files]
    print(table([result for result in results if set(result["tasks"]) & set(TASKS)]))
    for result in results:
        for name in sorted(set(result["tasks"]) - set(TASKS)):
            print(f"{name}, seed {result['seed']}: {rates(result['tasks'][name])}\n")
    print(commands(results))


if __name__ == "__main__":
    main()
