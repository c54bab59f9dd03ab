"""Arguments of `register` and `Registrar` from a flat list of beliefs and settings, as tests vary them one by one."""

from dataclasses import fields, replace

import tissuereg as tr

BELIEFS = ("material", "element", "held", "stiffness", "held_nodes")
SETTINGS = tuple(one.name for one in fields(tr.RegisterSettings))


def through(mesh, **options):
    """Return a body, and the other arguments with their settings."""
    beliefs = {name: options.pop(name) for name in BELIEFS if name in options}
    base = options.pop("settings", None) or tr.RegisterSettings()
    settings = {name: options.pop(name) for name in SETTINGS if name in options}
    return tr.Body(mesh, **beliefs), {**options, "settings": replace(base, **settings)}


def registered(mesh, *given, **options):
    """Register with a flat list of beliefs and settings."""
    body, rest = through(mesh, **options)
    return tr.register(body, *given, **rest)


def registrar(mesh, *given, **options):
    """Make a registrar with a flat list of beliefs and settings."""
    body, rest = through(mesh, **options)
    return tr.Registrar(body, *given, **rest)
