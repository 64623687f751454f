"""PPO: environment, storage, update, trainer and evaluation (the one place of this service that imports torch)."""
