"""Two or three causes at once, solved together."""

from blind.generator.effects import CATALOGUE, Effect


def _find(id_, variant):
    return next(e for e in CATALOGUE if e.id == id_ and e.variant == variant)


def _joint(*parts):
    effects = [_find(*part) for part in parts]

    def build(rig, rng, size):
        settings, parameters, contrasts = {}, {}, []
        for effect in effects:
            level = effect.sizes[0] + size * (effect.sizes[1] - effect.sizes[0])
            more, summary = effect.build(rig, rng, level)
            parameters[effect.id] = summary
            if "contrast" in more:
                contrasts.append(more.pop("contrast"))
            settings |= more
        if contrasts:
            settings["contrast"] = lambda points: _product(contrasts, points)
        return settings, parameters

    name = "+".join(e.id for e in effects)
    return Effect(name, "", all(e.own_form for e in effects), (0.6,), build, any(e.timed for e in effects))


def _product(factors, points):
    value = 1.0
    for factor in factors:
        value = value * factor(points)
    return value


PAIRS = (
    _joint(("inclusion", "ball"), ("relaxation", "one")),
    _joint(("inclusion", "ellipsoid"), ("gravity", "weight")),
    _joint(("layer", "sharp"), ("actuator_direction", "push_x")),
    _joint(("stiffening", "fung"), ("sliding", "springs")),
    _joint(("poisson", "lower"), ("inclusion", "ball")),
    _joint(("fibre", "one family"), ("detachment", "clean")),
    _joint(("gravity", "weight"), ("relaxation", "three")),
    _joint(("fibre", "one family"), ("relaxation", "one")),
    _joint(("actuator_direction", "push_z"), ("inclusion", "ball")),
    _joint(("layer", "graded"), ("relaxation", "one")),
    _joint(("inclusion", "ball"), ("gravity", "weight"), ("relaxation", "one")),
    _joint(("fibre", "dispersed"), ("inclusion", "ball"), ("gravity", "weight")),
)
