"""The paper's simulation studies as commands: Table II and Figs. 6 to 8 (section III).

A study returns rows and an `Agreement`: `figures` holds those that are sweeps, `table2` that of the network, and `run`
knows their names. `shapes`, `cases` and `subject` say on what they run, `algorithm` is Algorithm 1 for many pairs at
once, `tables` and `pictures` show a study's JSON.
"""

from tissuereg.studies.run import STUDIES, reproduce

__all__ = ["STUDIES", "reproduce"]
