"""A rig, what was measured on it, and the effects that may have occurred."""
