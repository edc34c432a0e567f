"""Test profiles, and the guarded runner that commands a drive."""
