"""The state machine as a Mermaid diagram and a table: `python -m orchestrator.core.diagram` writes docs/."""

from __future__ import annotations

import sys
from pathlib import Path

from orchestrator.core.machine import STATES, TERMINAL, TRANSITIONS, Action, Phase

PATH = Path("docs/state_machine.md")


def _label(signal: str, actions: tuple[Action, ...]) -> str:
    return signal if not actions else f"{signal} / {', '.join(actions)}"


def render() -> str:
    """The whole document, from the tables alone."""
    lines = [
        "# State machine of an episode",
        "",
        "Generated from `orchestrator/core/machine.py` by `python -m orchestrator.core.diagram`.",
        "",
        "```mermaid",
        "stateDiagram-v2",
        f"    [*] --> {Phase.CREATED}",
    ]
    for (phase, signal), (target, actions) in TRANSITIONS.items():
        lines.append(f"    {phase} --> {target}: {_label(signal, actions)}")
    for phase, spec in STATES.items():
        lines.append(f"    {phase} --> {spec.fallback}: {_label('timed_out', spec.fallback_actions)}")
        if spec.retries:
            lines.append(f"    {phase} --> {phase}: {_label('timed_out (retry)', spec.retry_actions)}")
    lines += [f"    {phase} --> [*]" for phase in Phase if phase in TERMINAL]
    lines += ["```", "", "| state | time-out (s, simulated) | retries | fallback |", "|---|---|---|---|"]
    for phase, spec in STATES.items():
        limit = "the task's own" if phase is Phase.ACTING else f"{spec.timeout_s:g}" if spec.timeout_s else "none"
        lines.append(f"| {phase} | {limit} | {spec.retries} | {spec.fallback} |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Write the document (or print it with `-`)."""
    if sys.argv[1:] == ["-"]:
        sys.stdout.write(render())
    else:
        PATH.write_text(render())


if __name__ == "__main__":
    main()
