"""The catalogue of physics: each effect is a declaration and one function. Pure."""
