"""The humanoid, the scene, the physics character and its log (MuJoCo)."""
