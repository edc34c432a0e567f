"""The simulated gear: what its laws do, and the rule that steps them."""
