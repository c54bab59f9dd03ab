"""The HTML page of a diagnosis: one self-contained file with text, charts and a body to turn."""

#: File of the extended model, in the folder of an answer and its page.
EXTENDED_FILE = "experiment.extended.toml"
