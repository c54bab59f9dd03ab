"""Diagnosis of material tests: which causes explain the difference between measured stress curves and a believed law.

The steps are in `verdict`, what all fits share in `bench`; rounds of the search, evidence and records of the answer
are those of bodies. ``docs/material.md`` describes the method.
"""

from tissuereg.diagnosis.material.answer import MaterialDiagnosis
from tissuereg.diagnosis.material.model import predicted_stresses
from tissuereg.diagnosis.material.verdict import diagnose_material

__all__ = ["MaterialDiagnosis", "diagnose_material", "predicted_stresses"]
