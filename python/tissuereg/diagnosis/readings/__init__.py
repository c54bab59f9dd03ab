"""Detection of misread recordings: other units, axes and signs of markers, commands and forces.

`suspect_recording` runs before the bank of causes is made. A reading is one interpretation of the recording, such as
"forces.csv is in N". All readings (`proposals`) are compared by one likelihood (`weigh`): that of the markers' motion
and of the forces under the linear response of the believed model to the commands.
"""

from tissuereg.diagnosis.readings.judge import RecordingSuspicion, suspect_recording

__all__ = ["RecordingSuspicion", "suspect_recording"]
