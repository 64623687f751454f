"""The result of `eval planner` as one HTML page: tables, and plots as pictures inside it (needs matplotlib)."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from shared.errors import InvalidInputError

HEADLINE = ("r_precision", "fid", "multimodal_distance", "diversity", "penetration_mm", "floating_mm", "skating_mm",
            "skating_contact_mm", "jerk", "limb_speed_mps")  # fmt: skip
SINGLE = ("target_error_m", "heading_error_deg", "keyframe_error_m", "velocity_error_mps", "paraphrase_r_precision",
          "paraphrase_training_r_precision")  # fmt: skip
STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; margin: 2rem auto; max-width: 60rem; padding: 0 1rem; color: #222; }
table { border-collapse: collapse; margin: 1rem 0; } th, td { padding: .2rem .7rem; border-bottom: 1px solid #ccc; }
td { text-align: right; } td:first-child, th { text-align: left; } img { max-width: 100%; } .bad { color: #b00; }
"""


def write_report(result: Mapping[str, Any], path: Path) -> None:
    """Write the page.

    Raises:
        InvalidInputError: matplotlib is not installed.
    """
    parts = [f"<h1>DiP, {html.escape(str(result['weights_sha256'])[:12])}</h1>", _made(result)]
    if "r_precision" in result:
        parts += _quality(result)
    if "table" in result:
        columns = {name: result["table"][name] for name in ("ground_truth", "dip_alone", "closed_loop")}
        stretches = result["table"]["stretches"]
        parts += [f"<h2>Closed loop, {stretches} stretches of one text</h2>", _side_by_side(columns, HEADLINE)]
    if "sweep" in result:
        parts += ["<h2>Settings</h2>", _rows(result["sweep"])]
    if "rollouts" in result:
        found = result["rollouts"]
        parts += [f"<h2>Rollouts of {found['seconds']} s: {found['good']} of {found['rollouts']} good</h2>",
                  _rows(found["rows"])]  # fmt: skip
    if "switches" in result:
        found = result["switches"]
        parts += [f"<h2>Switches: {found['shown']:.0%} of {found['switches']} shown within a second</h2>",
                  _bars({kind: row["shown"] for kind, row in found["by_kind"].items()}, "shown within 1 s"),
                  _rows([row for row in found["rows"] if not row["shown"]])]  # fmt: skip
    page = f"<!doctype html><html lang=en><meta charset=utf-8><title>eval planner</title><style>{STYLE}</style>"
    path.write_text(page + "\n".join(parts) + "</html>\n", encoding="utf-8")


def _quality(result: Mapping[str, Any]) -> list[str]:
    columns = {"DiP": result, "ground truth": result["ground_truth"], "chance": result["chance"]}
    meanings = result["by_meaning"]
    parts = [
        f"<h2>Held-out texts, {result['motions']} motions, pools of {result['pool']}</h2>",
        _side_by_side(columns, HEADLINE),
        _side_by_side({"DiP": result}, SINGLE),
        "<h2>By meaning</h2>",
        _pairs({name: (row["r_precision_top3"], row["ground_truth"]) for name, row in meanings.items()},
               ("DiP", "ground truth"), "R-precision, top 3"),
        _pairs({name: (row["limb_speed_mps"], row["ground_truth_limb_speed_mps"]) for name, row in meanings.items()},
               ("DiP", "ground truth"), "speed of limbs (m/s)"),
        "<h2>Places</h2>",
        _bars(result["target_error_by_joint_m"], "median target error (m)"),
    ]  # fmt: skip
    if "keyframe_error_by_joint_m" in result:
        parts.append(_bars(result["keyframe_error_by_joint_m"], "median keyframe error (m)"))
    reach = result["reach"]
    parts += ["<h2>Commands without physics</h2>", _bars(result["text"]["by_kind"], "obeyed"),
              "<ul>" + "".join(f"<li>{html.escape(miss)}</li>" for miss in result["text"]["missed"]) + "</ul>",
              f"<p>Reached and held: {reach['reached_and_held']:.2f} of {reach['episodes']}.</p>"]  # fmt: skip
    return parts


def _made(result: Mapping[str, Any]) -> str:
    machine = result["machine"]
    cells = (result["command"], f"commit {result['commit']}", f"seed {result['seed']}", machine["cpu"])
    line = " · ".join(map(str, (*cells, f"{machine['threads']} threads")))
    return f"<p>{html.escape(line)}</p>"


def _shown(value: object) -> str:
    if isinstance(value, list):
        return " / ".join(_shown(each) for each in value)
    if isinstance(value, bool) or value is None:
        return {True: "yes", False: "no", None: "-"}[value]
    return f"{value:.3g}" if isinstance(value, float) else html.escape(str(value))


def _side_by_side(columns: Mapping[str, Mapping[str, Any]], fields: Sequence[str]) -> str:
    rows = [{"": name, **{label: column.get(name) for label, column in columns.items()}} for name in fields]
    return _rows([row for row in rows if any(value is not None for key, value in row.items() if key)])


def _rows(rows: Sequence[Mapping[str, Any]]) -> str:
    names = list(dict.fromkeys(name for row in rows for name in row))
    head = "".join(f"<th>{html.escape(name)}</th>" for name in names)
    body = "".join("<tr>" + "".join(f"<td>{_shown(row.get(name))}</td>" for name in names) + "</tr>" for row in rows)
    return f"<table><tr>{head}</tr>{body}</table>"


def _bars(values: Mapping[str, float], what: str) -> str:
    return _pairs({name: (value,) for name, value in values.items()}, (what,), what)


def _pairs(values: Mapping[str, Sequence[float]], labels: Sequence[str], what: str) -> str:
    """Horizontal bars, one group a name, one colour a label."""
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise InvalidInputError("reports need matplotlib (extra: train)", field="report") from error
    names = list(values)
    figure = Figure(figsize=(8, 0.9 + 0.22 * len(names) * len(labels)), dpi=90)
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    width = 0.8 / len(labels)
    for number, (label, colour) in enumerate(zip(labels, ("#2460a7", "#bbbbbb"), strict=False)):
        places = [place + number * width for place in range(len(names))]
        axes.barh(places, [values[name][number] for name in names], height=width, color=colour, label=label)
    axes.set_yticks([place + 0.4 - width / 2 for place in range(len(names))], names, fontsize=8)
    axes.invert_yaxis()
    axes.set_xlabel(what)
    if len(labels) > 1:
        axes.legend(fontsize=8)
    out = io.BytesIO()
    figure.tight_layout()
    figure.savefig(out, format="png")
    return f'<img alt="{html.escape(what)}" src="data:image/png;base64,{base64.b64encode(out.getvalue()).decode()}">'
