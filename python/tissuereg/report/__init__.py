"""Output of a registration for people: a picture, an HTML page and files."""
