"""Into the image world: grid transforms, and whatever a registered body moves."""
