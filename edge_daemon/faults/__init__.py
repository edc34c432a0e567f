"""Faults with names: what each does to which condition, and which of them the drifts of a gear point to."""
