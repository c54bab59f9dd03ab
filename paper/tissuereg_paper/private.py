"""The private modules of `tissuereg` that this package uses, and why; a test holds the list against the imports.

Public are the names of ``tissuereg``, ``tissuereg.errors`` and ``tissuereg.phantom``.
"""

#: By room: why it is used, and which of its modules.
PRIVATE: dict[str, tuple[str, tuple[str, ...]]] = {
    "_core": ("Algorithm 1 for many pairs at once is made of the compiled update that registration takes", ("_core",)),
    "_base": (
        "arguments are checked, and arrays typed, by the rules of the package",
        ("_base.arguments", "_base.arrays", "_base.clock"),
    ),
    "body": (
        "a method sees the markers, and is scored at points, by the interpolation that registration uses",
        ("body.mesh", "body.observe"),
    ),
    "io": (
        "files are read with the same checks and errors, and written whole; the test split is that of a data set",
        ("io.atomic", "io.datasets", "io.fields", "io.json"),
    ),
    "simulation": (
        "held-out shapes are solved anew from the recipe of the shipped model's data",
        ("phantom.event", "simulation.chunks", "simulation.recipe"),
    ),
    "registration": (
        "rivals that share a part with registration (elastic body, supports, linear prior) share its code",
        (
            "registration.contacts.body",
            "registration.contacts.elastic",
            "registration.contacts.patches",
            "registration.contacts.places",
            "registration.contacts.supports",
            "registration.linear_prior",
        ),
    ),
    "registration.learned": (
        "models are loaded, sampled and assimilated as registration does, where a study varies one of these steps",
        (
            "registration.learned.draws",
            "registration.learned.card",
            "registration.learned.digits",
            "registration.learned.model",
            "registration.learned.network",
            "registration.learned.pca",
            "registration.learned.points",
            "registration.learned.registration",
            "registration.learned.repair",
            "registration.learned.variants",
        ),
    ),
    "cli": (
        "the command has the output, errors and exit codes of `tissuereg`",
        ("cli", "cli.common", "cli.options", "cli.progress"),
    ),
}
