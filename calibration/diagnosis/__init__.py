"""What physics a recording shows that the model leaves out, a file a step.

blocks      the parts of a recording as arrays
problem     every nuisance, and what the instruments would read
linear      readings as one vector, and its whitening
mode        the most probable point of a model, and its evidence
signatures  what each effect, and a force of any shape, would do
detect, locate, name, confirm, verdict, discover, next_test: the steps
together    several recordings as one; unseen: a run that no fit has seen
diagnose    all of them; document: the result as diagnosis/1
"""

from calibration.diagnosis.diagnose import Diagnosis, diagnose, held_out_gain
from calibration.diagnosis.document import as_json
from calibration.diagnosis.together import together

__all__ = ["Diagnosis", "as_json", "diagnose", "held_out_gain", "together"]
