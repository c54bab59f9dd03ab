"""The paper's studies as commands: Table II and Figs. 6 to 8 (section III), and the phantom's Figs. 10 and 11.

A simulation study is a function of what is given (`study`), and a name in `run`: `figures` holds those that are sweeps,
`table2` that of the network. `shapes`, `cases` and `subject` say on what they run, `algorithm` is Algorithm 1 for many
pairs at once, `claims` tries the paper's statements, `tables` and `pictures` show a study's JSON. Of the phantom
experiment, `rigs` reads recordings, `contest` runs every method on them, `phantom` sums up, `phantom_pages` shows.
"""

from tissuereg_paper.studies.run import SIMULATED, STUDIES, ContestInputs, reproduce

__all__ = ["SIMULATED", "STUDIES", "ContestInputs", "reproduce"]
