"""The configuration: settings as types, the file read, contradictions in it, a word on every key."""
