"""What the frames before are worth, and how fast tracking is."""
