"""Walk a square: `motionloop serve` in one terminal, `python examples/steer.py` in another."""

from __future__ import annotations

import sys

import numpy as np

from motionloop import Client, MotionLoopError, State

CORNERS_M = ((2.0, 0.0), (2.0, 2.0), (0.0, 2.0), (0.0, 0.0))
NEAR_M = 0.3


def main(url: str | None, give_up_s: float = 20.0) -> None:
    """Go from corner to corner, each when the one before is reached (or after `give_up_s`)."""
    with Client(url) as client, client.character() as character:
        for corner in CORNERS_M:
            character.say("a person is walking.", target=corner)

            def there(state: State, corner: tuple[float, float] = corner) -> bool:
                return float(np.linalg.norm(state.pelvis_w_m[:2] - corner)) < NEAR_M

            try:
                character.wait_for(there, give_up_s)
                sys.stdout.write(f"corner {corner}: reached\n")
            except MotionLoopError as error:
                sys.stdout.write(f"corner {corner}: {error}\n")


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else None)
