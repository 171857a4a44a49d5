"""VIR: shadow and reflection passes from one point cloud a frame."""

__version__ = "0.1.0"
