"""The swarm, its forces and the dynamics that move it; `world` is the engine."""
