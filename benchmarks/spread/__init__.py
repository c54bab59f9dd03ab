"""The spread of the trained model, on shapes that it never saw."""
