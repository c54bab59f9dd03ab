"""What markers inside the body are worth."""
