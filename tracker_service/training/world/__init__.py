"""Tracking learnt through a model of the body: a network of the simulator's transitions, and a policy that is trained
by backpropagation through imagined ticks of it (SuperTrack 2021; SuperMimic 2026; REFERENCE 7)."""
