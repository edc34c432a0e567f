"""The torsional stiffness, measured in more than one way and at more than one twist."""
