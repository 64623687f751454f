"""motionloop: text- and target-driven physical characters."""

from __future__ import annotations

from orchestrator.client import MotionLoopClient, ServerProblem

__all__ = ["MotionLoopClient", "ServerProblem"]
