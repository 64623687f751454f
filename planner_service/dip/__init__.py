"""DiP, the diffusion planner: network, diffusion, conditions and the plug-in (after CLoSD, section 4.1)."""
