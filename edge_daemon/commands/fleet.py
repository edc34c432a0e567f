"""Commands over many gateways."""

from edge_daemon.fleet.telling import collect, compare, learn, share, status

__all__ = ["collect", "compare", "learn", "share", "status"]
