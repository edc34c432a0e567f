"""Many gateways seen from one place: what they publish is collected, kept as Parquet, watched and learned from."""
