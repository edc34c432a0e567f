"""A simulated drive that speaks the real protocols. It integrates its own equations and knows no other stage."""
