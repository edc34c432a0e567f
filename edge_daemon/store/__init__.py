"""The ring buffer on disk."""
