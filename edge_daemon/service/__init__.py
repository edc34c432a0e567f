"""The daemon: the only room that knows all stages, and wires them."""
