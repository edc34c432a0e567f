"""Blocks become estimates with a standard deviation and a status. Pure."""
