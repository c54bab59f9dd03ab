"""Files in and out: each format one module, units converted here and nowhere else.

Readers import their libraries on first use only, so that importing tissuereg stays quick. Writers leave a whole file or
none.
"""
