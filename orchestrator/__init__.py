"""The orchestrator: drives tasks through the planner-tracker loop and offers it over HTTP."""
