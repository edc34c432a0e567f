"""Load cycles, damage, life and health index. Pure."""
