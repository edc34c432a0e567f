"""The one integrator of a twist with its laws, compiled, with tangents: fits and the live prediction call it. Pure."""
