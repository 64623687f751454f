"""Two characters side by side with asyncio, the second following the first: `python examples/follow.py`."""

from __future__ import annotations

import asyncio
import sys

from motionloop import AsyncCharacter, AsyncClient

FOLLOW_EVERY_S = 1.0


async def follow(leader: AsyncCharacter, follower: AsyncCharacter) -> None:
    """Send the follower to where the leader is, once a second, until cancelled."""
    while True:
        x, y, _ = (await leader.state()).pelvis_w_m
        await follower.say("a person is walking.", target=(x - 0.8, y))
        await asyncio.sleep(FOLLOW_EVERY_S)


async def main(url: str | None, seconds: float = 15.0) -> None:
    """Walk for some seconds and say where both are."""
    async with (
        AsyncClient(url) as client,
        await client.character() as leader,
        await client.character(seed=1) as follower,
    ):
        await leader.say("a person walks forward", target=(4.0, 1.0))
        task = asyncio.create_task(follow(leader, follower))
        start = (await leader.state()).time_s
        async for state in leader.stream():
            if state.time_s > start + seconds:
                break
        task.cancel()
        for name, character in (("leader", leader), ("follower", follower)):
            x, y, _ = (await character.state()).pelvis_w_m
            sys.stdout.write(f"{name}: ({x:.2f}, {y:.2f})\n")


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1] if len(sys.argv) > 1 else None))
