"""VIR: soft-shadow passes, one per light."""

__version__ = "0.1.0"
