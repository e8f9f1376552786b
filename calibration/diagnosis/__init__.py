"""What physics a recording shows that the model leaves out, a file a step.

blocks      the parts of a recording as arrays
problem     every nuisance, and what the instruments would read
linear      readings as one vector, and its whitening
mode        the most probable point of a model, and its evidence
signatures  what each effect, and a force of any shape, would do
detect, locate, name, confirm, verdict, discover, next_test: the steps
diagnose    all of them; document: the result as diagnosis/1
"""

from calibration.diagnosis.diagnose import Diagnosis, diagnose
from calibration.diagnosis.document import as_json

__all__ = ["Diagnosis", "as_json", "diagnose"]
