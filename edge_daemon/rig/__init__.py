"""A simulated drive: integrates its own equations and speaks the real protocols; knows no other stage."""
