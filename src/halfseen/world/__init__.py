"""The decision process: state, actions, transition, seeing, reward → paths."""

from halfseen.world.scene import Scene

__all__ = ["Scene"]
