"""Training, export and kinematic evaluation of DiP."""
