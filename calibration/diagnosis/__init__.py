"""What physics a recording shows that the model leaves out.

diagnose    the steps in their order; result: everything found
mismatch    the base model, and the test of it
steps       a file a step, and what several of them need
sizes       how large effects are, and which would be seen
next_test   which test would tell explanations apart
f_overall   of the base model, and over what the verdict leaves open
document    the result as diagnosis/1
changes     what changed between two recordings; changes_document as comparison/1
oracle      what a set that somebody knows predicts of unseen readings
live_check  a first look at a sweep that is not over
"""

from calibration.data.joined import together
from calibration.diagnosis.diagnose import diagnose
from calibration.diagnosis.document import as_json
from calibration.diagnosis.oracle import held_out_gain
from calibration.diagnosis.result import Diagnosis

__all__ = ["Diagnosis", "as_json", "diagnose", "held_out_gain", "together"]
