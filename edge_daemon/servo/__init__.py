"""A simulated servo drive that obeys a master: its own position loop and CiA 402 face, on the gear of the rig."""
