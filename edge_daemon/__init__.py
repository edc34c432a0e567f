"""Knows the state of a strain wave gear while it works."""

__version__ = "0.2.0"
