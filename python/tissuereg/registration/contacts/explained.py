"""What explains the motion that was measured: loads, the tracker's frame, the body's stiffness, or none of them."""

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.registration.contacts.fit import ContactFit
from tissuereg.registration.contacts.settings import ReportSettings


def explained(fit: ContactFit) -> dict[str, float]:
    """Return the root mean square motion of the nodes, mm, by each part of a fit.

    ``loads``: the equilibrium under the load that was found; ``tracker``: its rigid motion to the tracker's frame;
    ``stiffness``: changes of the stiffness across the body; ``unexplained``: what no load on the body explains.
    """
    state, nodes = fit.state, fit.columns.body.mesh.nodes
    moved = nodes + state.moved[: len(nodes)]
    parts = {
        "loads": state.displacement[: len(nodes)],
        "tracker": state.frame.apply(moved) - moved,
        "stiffness": np.zeros((1, 3)),
        "unexplained": np.zeros((1, 3)),
    }
    parts |= fit.columns.beside(state.coefficients, fit.tangent.by_stiffness)
    return {name: _rms(part) for name, part in parts.items()}


def reasons(fit: ContactFit, settings: ReportSettings) -> list[str]:
    """Return the reasons not to trust the result that contradict what is believed of the body, in sentences.

    They are rare where the belief is right; how rare, the benches `loadfree` and `regions` count.
    """
    columns, found = fit.columns, list[str]()
    if columns.unexplained is not None:
        share = float(np.sqrt(np.median(columns.rest_sizes(fit.samples[1])))) / columns.unexplained.motion
        if share > settings.most_unexplained:
            part = explained(fit)["unexplained"]
            found.append(
                f"unexplained: the markers are met only by {part:.2g} mm rms of motion that no load on this body "
                "makes, or their noise is several times larger than stated"
            )
    slopes = columns.slopes(fit.state.coefficients)
    if len(slopes) and np.abs(slopes).max() > settings.most_slope:
        times = float(np.exp(2.0 * np.abs(slopes).max()))
        found.append(
            f"stiffness: it is not as believed; the markers speak for a body {times:.0f} times as stiff at one end as "
            "at the other"
        )
    return found


def _rms(moved: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.sum(moved**2, axis=-1))))


__all__ = ["explained", "reasons"]
