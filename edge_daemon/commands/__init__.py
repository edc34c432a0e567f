"""What a person types: one file per family of commands, each imported when it runs."""
