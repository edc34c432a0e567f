"""What two encoders say of each other: ratio and skew, zeros that move, readings that no gear could make. Pure."""
