"""Skeletons, clips, rotations, kinematics, features, resampling and motion metrics (numpy only)."""
