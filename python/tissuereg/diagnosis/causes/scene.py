"""What a set of measured stress curves can show."""

from dataclasses import dataclass

from tissuereg.diagnosis.settings import DEFAULT, MaterialSettings


@dataclass(frozen=True)
class Scene:
    """Tested modes and ranges of a set of curves, which set the priors and decide what causes can be observed.

    `modes`: tested modes; `poisson`: believed Poisson's ratio; `invariant`: largest ``I1 - 3``, with I1 the first
    invariant of the right Cauchy-Green tensor at preserved volume; `pulled`, `pushed`: whether a bar was stretched and
    compressed, each by more than 1 %; `timed`: whether times or rates are known; `paced`: whether effects of time can
    be distinguished from those of strain (holds, unloading, or two rates that differ by a fifth); `unloaded`: whether
    the strain falls below nine tenths of its largest so far; `shortest_s`, `longest_s`: range of time constants that
    the curves can resolve, s; `peak`: largest stress, kPa; `peak_energy`: half the largest stress times its strain,
    kPa; `fastest`: largest rate of strain, 1/s; 0 where times are not known; `settings`: priors of the causes.
    """

    modes: tuple[str, ...]
    poisson: float
    invariant: float
    pulled: bool
    pushed: bool
    timed: bool
    paced: bool
    unloaded: bool
    shortest_s: float
    longest_s: float
    peak: float
    peak_energy: float
    fastest: float
    settings: MaterialSettings = DEFAULT.material

    @property
    def two_sided(self) -> bool:
        """Whether tension and compression were both tested."""
        return self.pulled and self.pushed
