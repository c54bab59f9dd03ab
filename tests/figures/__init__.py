"""A small draw for each figure that the documents state."""
