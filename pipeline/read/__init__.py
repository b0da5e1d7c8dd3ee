"""USD stage to Scene."""

from plait.pipeline.read.shot import read_shot

__all__ = ["read_shot"]
