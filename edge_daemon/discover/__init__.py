"""Laws outside the catalogue: formulas proposed for what a model leaves."""
