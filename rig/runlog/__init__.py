"""The run log: a run is a folder that is only ever appended to, readable at any moment and after any end.

folder       the files of a run, the name it gets, and the lock that says a program writes it
schema       start.json, end.json and the lines of the two JSONL files, key by key
rows         one reading to one CSV row and back, one exchange to one wire line and back
start        the start record of a bench
writer       the program that takes the data
lines        the whole lines of a file that may end in a torn one
plateaus     plateaus.csv
samples      samples.csv, read back
reader       a run as it stands on disk
verify       whether a sealed run is as it was sealed; repair of a killed one
phases       the stretches of a run: zero phases and captures
listing      what `spinbench runs` shows
tail         a run followed while it is written, its series in bins of bounded memory

docs/runs.md describes the format run/1.
"""

from rig.runlog.folder import RunError
from rig.runlog.plateaus import Mean, PlateauRow, columns_of
from rig.runlog.reader import Run, read_run
from rig.runlog.schema import AmbientRecord, EndRecord, StartRecord
from rig.runlog.start import Circumstances, start_record
from rig.runlog.verify import repair, verify
from rig.runlog.writer import RunWriter

__all__ = [
    "AmbientRecord",
    "Circumstances",
    "EndRecord",
    "Mean",
    "PlateauRow",
    "Run",
    "RunError",
    "RunWriter",
    "StartRecord",
    "columns_of",
    "read_run",
    "repair",
    "start_record",
    "verify",
]
