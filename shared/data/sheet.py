"""Contact sheets: rows of stick figures, one row a clip, seen from the side and from the front (needs matplotlib)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from shared.errors import InvalidInputError
from shared.motion.body import Array, J, heading_rad, place
from shared.motion.skeleton import CANONICAL

_COLOURS = {"left": "#c0392b", "right": "#2460a7", "": "#444444"}


def _side_of(name: str) -> str:
    return "left" if name.startswith("left_") else "right" if name.startswith("right_") else ""


def draw_sheet(rows: Sequence[tuple[str, Array]], out: str | Path, frames: int = 8) -> None:
    """Draw clips as a PNG.

    Args:
        rows: (title, joint positions (T, 22, 3)) of each clip.
        out: PNG to write.
        frames: figures per row and view, evenly spread over the clip.

    Raises:
        InvalidInputError: matplotlib is not installed.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.collections import LineCollection
        from matplotlib.figure import Figure
    except ImportError as error:
        raise InvalidInputError("contact sheets need matplotlib (extra: train)", field="sheet") from error
    figure = Figure(figsize=(1.25 * frames * 2, 2.4 * len(rows)), dpi=60)
    FigureCanvasAgg(figure)
    colours = [_COLOURS[_side_of(n)] for n in CANONICAL.names[1:]]
    parents = np.array(CANONICAL.parents[1:])
    for r, (title, p) in enumerate(rows):
        axes = figure.add_subplot(len(rows), 1, r + 1)
        picks = np.linspace(0, len(p) - 1, frames).round().astype(int)
        for k, frame in enumerate(picks):
            # Each figure is turned by its own heading, so that side and front really are side and front.
            pose = place(p[frame : frame + 1], -float(heading_rad(p[frame : frame + 1])[0]))[0]
            pose = pose - np.array([pose[J["pelvis"], 0], pose[J["pelvis"], 1], 0.0])
            for view, (axis, sign) in enumerate(((0, 1.0), (1, -1.0))):
                x = sign * pose[:, axis] + 1.3 * (k + view * (frames + 0.5))
                points = np.stack([x, pose[:, 2]], axis=-1)
                segments = np.stack([points[parents], points[1:]], axis=1)
                axes.add_collection(LineCollection(list(segments), colors=colours, linewidths=1.6))
                axes.plot(points[J["head"], 0], points[J["head"], 1] + 0.08, "o", color="#444444", ms=7)
        axes.axhline(0.0, color="#999999", lw=0.8)
        axes.set_xlim(-0.9, 1.3 * (2 * frames + 0.5) - 0.4)
        axes.set_ylim(-0.15, 2.15)
        axes.set_aspect("equal")
        axes.set_title(title, fontsize=9, loc="left", pad=2)
        axes.axis("off")
    figure.tight_layout(pad=0.3)
    figure.savefig(str(out))
