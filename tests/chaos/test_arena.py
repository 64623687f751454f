"""What is kept of an episode that ended with something wrong."""

from __future__ import annotations

import httpx

from tests.chaos.arena import Arena, Ended, wrong


def test_events_of_what_went_wrong_are_kept() -> None:
    def answer(request: httpx.Request) -> httpx.Response:
        if request.url.path == "/v1/episodes/lame/events":
            return httpx.Response(200, text='id: 1\nevent: fell\ndata: {"seq": 1, "type": "fell"}\n\n')
        return httpx.Response(404)

    with httpx.Client(transport=httpx.MockTransport(answer), base_url="http://arena") as http:
        arena = Arena(http)
        for name, reason in (("lame", None), ("well", "cancelled")):
            arena.running[name] = {"pacing": "lockstep"}
            arena._over(name, {"status": "failed", "reason": reason})
        arena.check()
    trouble = "it ended without a reason"
    assert wrong(arena.ended) == [{"id": "lame", "trouble": trouble, "events": [{"seq": 1, "type": "fell"}]}]
    assert arena.ended[1] == Ended("well", "lockstep", "failed", "cancelled")
