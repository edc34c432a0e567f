"""What is wrong with a drive now: alarms, the state they add up to, what drifted since commissioning. Pure."""
