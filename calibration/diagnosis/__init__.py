"""What physics a recording shows that the model leaves out.

The recording: `blocks`, `standing`, `gauge` (its parts as arrays), `problem` and `in_time` (what the instruments would
read), `linear` and `noise` (readings as one vector, and its whitening).
A model at its most probable point: `function`, `descent`, `mode`.
What may be missing: `signatures` (of each effect), `forces`, `further_forces` and `coordinates` (of any shape).
The steps: `base`, `detect`, `locate` (`balances`), `name` and `search` (`side_by_side`), `confirm`, `verdict`
(`misread`, `abrupt`), `discover` and `correction` (`terms`, `straight`), `next_test` (`planned`, `quantities`,
`information`).
What is said of sizes: `f_overall` (`faint`), `sizes`, `resolves`.
`diagnose` takes all steps, `document` is the result as diagnosis/1, `check` looks at a sweep that is not over,
`together` makes one recording of several, `unseen` predicts a run that no fit has seen (`carried`: what a fit leaves
for another recording), `threads` simulates side by side.
"""

from calibration.data.joined import together
from calibration.diagnosis.diagnose import Diagnosis, diagnose, held_out_gain
from calibration.diagnosis.document import as_json

__all__ = ["Diagnosis", "as_json", "diagnose", "held_out_gain", "together"]
