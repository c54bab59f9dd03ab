"""The paper's simulation studies as commands: Table II and Figs. 6 to 8 (section III).

A study is a function of what is given (`study`), and a name in `run`: `figures` holds those that are sweeps, `table2`
that of the network. `shapes`, `cases` and `subject` say on what they run, `algorithm` is Algorithm 1 for many pairs at
once, `claims` tries the paper's statements, `tables` and `pictures` show a study's JSON.
"""

from tissuereg.studies.run import STUDIES, reproduce

__all__ = ["STUDIES", "reproduce"]
