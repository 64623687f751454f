"""Makes docs/images/demo.gif, the README's moving picture, from a video of the demo.

make demo && .venv/bin/python docs/make_picture.py out/demo/video.mp4
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path

import imageio_ffmpeg

DEFAULT_OUT = Path(__file__).resolve().parent / "images" / "demo.gif"
MAX_BYTES = 2_000_000


QUALITIES = ((12, 96), (12, 48), (10, 40), (8, 32))
"""(frames a second, colours), best first: the first that fits is taken."""


def make_picture(video: Path, out: Path, start_s: float, seconds: float, width: int, fps: int, colours: int) -> int:
    """Cut a piece of a video and write it as a GIF with a palette of its own; returns the size in bytes."""
    out.parent.mkdir(parents=True, exist_ok=True)
    filters = (
        f"fps={fps},scale={width}:-2:flags=lanczos,split[a][b];"
        f"[a]palettegen=max_colors={colours}:stats_mode=diff[p];[b][p]paletteuse=dither=none:diff_mode=rectangle"
    )
    command = [
        imageio_ffmpeg.get_ffmpeg_exe(), "-y", "-loglevel", "error", "-ss", f"{start_s}", "-t", f"{seconds}",
        "-i", str(video), "-filter_complex", filters, "-loop", "0", str(out),
    ]  # fmt: skip
    subprocess.run(command, check=True)
    return out.stat().st_size


def main() -> int:
    """Exit code 1 when even the lowest quality is larger than 2 MB."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("video", type=Path, help="video.mp4 of a demo")
    parser.add_argument("--out", type=Path, default=DEFAULT_OUT)
    parser.add_argument("--start", type=float, default=3.0, help="seconds into the video")
    parser.add_argument("--seconds", type=float, default=6.0)
    parser.add_argument("--width", type=int, default=480)
    given = parser.parse_args()
    for fps, colours in QUALITIES:
        size = make_picture(given.video, given.out, given.start, given.seconds, given.width, fps, colours)
        sys.stdout.write(f"{given.out}: {size / 1000:.0f} kB with {fps} frames a second and {colours} colours\n")
        if size <= MAX_BYTES:
            return 0
    return 1


if __name__ == "__main__":
    sys.exit(main())
