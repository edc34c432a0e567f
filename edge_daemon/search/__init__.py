"""Hypotheses of what a model lacks: fitted to recordings, searched, ordered, and how far each is believed. Pure."""
