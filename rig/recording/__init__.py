"""recording/1: the meeting place of the bench and the calibration.

A recording is a folder with `recording.toml` and CSV files, written by the tool's own runs or by hand. Reading is
strict: whatever is wrong is reported at once with file, row and column, nothing is guessed and nothing on disk changes.
docs/recording.md tells a person how to write one.

    contents    what a recording holds, as the calibration sees it
    columns     the columns known by name: unit, limits, and the figures taken for an instrument that states none
    units       units that others write: spellings, factors, and what to do with the numbers
    schema      recording.toml, key by key, the inline motors included
    header      the names of columns: of each kind of file, and what one that others write says
    table       the rows of a CSV file, in bounded memory: its lines, and the cells of a column
    origin      when it was taken, and of which run it is
    mistakes    so that one error names them all
    safe_text   what came from outside, fit for a spreadsheet or for JSON
    files       a file is written whole or not at all; JSON
    folder      which files may be opened
    read, write
"""

from rig.recording.contents import (
    DOWN_TO,
    LEAST_IN_A_RUN,
    UP_TO,
    Ambient,
    Channel,
    Column,
    Recording,
    RecordingError,
    RecordingFile,
    SupplyFigures,
    captured_s,
)
from rig.recording.read import read_recording
from rig.recording.write import write_recording

__all__ = [
    "DOWN_TO",
    "LEAST_IN_A_RUN",
    "UP_TO",
    "Ambient",
    "Channel",
    "Column",
    "Recording",
    "RecordingError",
    "RecordingFile",
    "SupplyFigures",
    "captured_s",
    "read_recording",
    "write_recording",
]
