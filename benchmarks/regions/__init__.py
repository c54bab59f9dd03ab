"""Whether regions hold, and are no wider than they must be, by family of truth."""
