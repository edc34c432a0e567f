"""Remaining life, and what failed gears teach. Pure."""
