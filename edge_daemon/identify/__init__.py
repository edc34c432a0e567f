"""A model fitted to recordings: amplitudes, shapes, and their standard deviations. Pure."""
