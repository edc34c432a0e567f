"""Commands over many gateways."""

from edge_daemon.fleet.telling import collect, compare, learn, status

__all__ = ["collect", "compare", "learn", "status"]
