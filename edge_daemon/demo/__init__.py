"""The product shown on simulated drives, through the buses and drivers of real ones."""
