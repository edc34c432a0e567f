"""Spectrum, noise coefficients, and the angle that is heard. Pure."""
