"""Live readings of a device: where they come from, on which clock, and how they reach the disk."""
