"""Walk a square by HTTP: `motionloop serve` in one terminal, `python examples/steer.py` in another."""

from __future__ import annotations

import sys
import time

from motionloop import MotionLoopClient

CORNERS_M = ((2.0, 0.0), (2.0, 2.0), (0.0, 2.0), (0.0, 0.0))
NEAR_M = 0.3


def main(url: str) -> None:
    """Go from corner to corner, each when the one before is reached (or after 20 s)."""
    with MotionLoopClient(url) as client:
        character = client.create_character(pacing="realtime").id
        for x, y in CORNERS_M:
            client.command(character, "a person is walking.", target_m=(x, y, 0.0))
            give_up = time.monotonic() + 20.0
            while time.monotonic() < give_up:
                px, py, _ = client.character(character).state.pelvis_m
                if (px - x) ** 2 + (py - y) ** 2 < NEAR_M**2:
                    break
                time.sleep(0.1)
            sys.stdout.write(f"corner ({x}, {y}): the pelvis is at ({px:.2f}, {py:.2f})\n")
        client.delete_character(character)


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "http://127.0.0.1:8080")
