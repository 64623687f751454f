"""Recorded motion: retargeting, grounding, made motion, labels and the training corpus."""
