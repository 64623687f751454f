"""The planner service: what to do next, from what has happened, words and targets."""
