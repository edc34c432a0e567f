"""A recording made ready for a balance: channels aligned, both sides filtered alike, reversals, noise floors. Pure."""
