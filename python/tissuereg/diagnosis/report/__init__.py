"""The HTML page of a diagnosis: one self-contained file with text, charts and a body to turn."""

#: File of the extended model, in the folder of an answer and its page.
EXTENDED_FILE = "experiment.extended.toml"

#: CSS of the pages.
STYLE = """
.verdict { font-size: 1.2rem; } .finding { border-left: 4px solid #1f5fa8; padding-left: 1rem; margin: 1rem 0; }
.finding p { margin: .4rem 0; } h3 { margin: 1.2rem 0 .3rem; } code { font-size: .85em; color: #555; }
svg { display: block; font-family: system-ui, sans-serif; margin: .4rem 0; }
.key span { display: inline-block; width: 1.4em; height: .7em; margin: 0 .3em 0 1em; }
pre { background: #f4f6f8; padding: .8rem; overflow: auto; max-height: 24rem; font-size: 13px; }
summary { cursor: pointer; }
"""
