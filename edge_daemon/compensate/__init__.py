"""What to command so that the output is where it should be: tables, offsets, shaped commands. Pure."""
