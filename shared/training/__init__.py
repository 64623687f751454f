"""What the trainings of planner and tracker have in common; the one place in `shared` that imports torch."""
