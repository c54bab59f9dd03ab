"""Output of a registration for people: picture, page and files."""
