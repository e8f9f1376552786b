"""What physics a recording shows that the model leaves out.

not_described whether the base model describes a recording at all
steps        base, detect, locate, search and name, confirm, discover, verdict, and what each needs
sizes        how large effects are, and which would be seen
linear_model what each effect, and a force of any shape, would do to the readings
next_test    which test would tell explanations apart
mismatch     the base model, and the test of it
diagnose     the steps in their order; result: everything found
f_overall    of the base model, and over what the verdict leaves open
document     the result as diagnosis/1
live_check   a first look at a sweep that is not over
other_rigs   the same for rotors, axes and displacement machines
"""

from calibration.data.joined import together
from calibration.diagnosis.diagnose import diagnose, held_out_gain
from calibration.diagnosis.document import as_json
from calibration.diagnosis.result import Diagnosis

__all__ = ["Diagnosis", "as_json", "diagnose", "held_out_gain", "together"]
