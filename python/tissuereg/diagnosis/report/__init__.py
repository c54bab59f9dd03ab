"""The HTML page of a diagnosis: one self-contained file with text, charts and a body to turn."""
