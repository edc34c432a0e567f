"""Remaining life, what failed gears teach, trends and health. Pure."""
