"""The flexspline as a drawing: finite elements on its section, contact, stresses, and what to change. Pure.

An extra of its own (`pip install edge-daemon[design]`); the daemon never loads it.
"""
